"""Write the JSON schema of a report's numbers: ``python -m rfpipe.report [FOLDER]``."""

import json
import sys
from pathlib import Path

from rfpipe.report.entries import SCHEMA_NAME, results_schema


def main() -> None:
    """Write the schema into a folder, ``docs`` when none is given."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs")
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(results_schema(), indent=2) + "\n"
    (folder / SCHEMA_NAME).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
