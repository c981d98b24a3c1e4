"""Write the default settings and their JSON schemas: ``python -m rfpipe.config [FOLDER]``."""

import json
import sys
from pathlib import Path

from rfpipe.config.files import (
    RIG_SCHEMA_NAME,
    SCHEMA_NAME,
    bench_yaml,
    default_yaml,
    json_schema,
    rig_json_schema,
    rig_yaml,
)


def main() -> None:
    """Write the settings files and schemas into a folder, ``config`` when none is given."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "config")
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in (
        ("config.yaml", default_yaml()),
        ("rig.yaml", rig_yaml()),
        ("bench.yaml", bench_yaml()),
        (SCHEMA_NAME, json.dumps(json_schema(), indent=2) + "\n"),
        (RIG_SCHEMA_NAME, json.dumps(rig_json_schema(), indent=2) + "\n"),
    ):
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
