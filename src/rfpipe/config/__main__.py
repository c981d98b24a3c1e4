"""Write the default settings and their JSON schema: ``python -m rfpipe.config [FOLDER]``."""

import json
import sys
from pathlib import Path

from rfpipe.config.files import SCHEMA_NAME, default_yaml, json_schema


def main() -> None:
    """Write config.yaml and config.schema.json into a folder, ``config`` when none is given."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "config")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(default_yaml(), encoding="utf-8")
    schema = json.dumps(json_schema(), indent=2) + "\n"
    (folder / SCHEMA_NAME).write_text(schema, encoding="utf-8")


if __name__ == "__main__":
    main()
