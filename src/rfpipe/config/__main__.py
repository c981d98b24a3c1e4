"""Write JSON schemas, settings of rigs and a list of settings: ``python -m rfpipe.config``."""

import json
import sys
from pathlib import Path

from rfpipe.config.files import (
    RIG_SCHEMA_NAME,
    SCHEMA_NAME,
    bench_yaml,
    json_schema,
    rig_json_schema,
    rig_yaml,
)
from rfpipe.config.listing import with_listing


def main() -> None:
    """Write what is made of the settings' models in the folder ``config``, or in another one."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "config")
    readme = folder / "README.md"
    for name, text in (
        (readme.name, with_listing(readme.read_text(encoding="utf-8"))),
        ("rig.yaml", rig_yaml()),
        ("bench.yaml", bench_yaml()),
        (SCHEMA_NAME, json.dumps(json_schema(), indent=2) + "\n"),
        (RIG_SCHEMA_NAME, json.dumps(rig_json_schema(), indent=2) + "\n"),
    ):
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
