"""Measure what jobs take, for the table that predictions begin with: src/rfpipe/costs/measured.csv.

Usage: ``python benchmarks/measure_costs.py FOLDER [--only NAME ...]``. Runs the workflow in the
folder over scenes of many sizes by each method, jobs of one thread side by side, and writes a row
for each job from what Snakemake's ``benchmark:`` measured. It goes on where it stopped, an hour or
two on two cores; ``--table-only`` writes the table of what is there. No part of `make bench`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from rfpipe.config import parse_config
from rfpipe.costs.records import records_in, write_records

ROOT = Path(__file__).parents[1]
OUTPUT = ROOT / "src" / "rfpipe" / "costs" / "measured.csv"

COAXIAL = ("near_far", "symmetric", "dual")
ANY = (*COAXIAL, "footprints")
SMALL = (*ANY, "hadamard", "brute_force")

# height, width, channels, methods
SIZES = (
    (12, 16, 3, SMALL),
    (18, 24, 3, SMALL),
    (24, 28, 1, SMALL),
    (32, 36, 3, SMALL),
    (48, 56, 1, SMALL),
    (62, 70, 1, ANY),
    (62, 70, 3, ANY),
    (96, 108, 3, COAXIAL),
    (155, 175, 3, ("near_far", "symmetric")),
)
SURFACES = ["texture", "texture"]
# views, height, width: arrays of pairs
FIELDS = ((2, 2, 12, 16), (3, 3, 16, 20), (3, 3, 32, 40))


def scenes() -> dict[str, Any]:
    """Return the settings of all scenes, the smallest first."""
    found: dict[str, Any] = {}
    for height, width, channels, methods in SIZES:
        found[f"iv_{height}x{width}x{channels}"] = {
            "kind": "wedge", "surfaces": SURFACES, "shape": [height, width],
            "channels": channels, "sweep": False, "methods": {name: {} for name in methods},
        }  # fmt: skip
    for rows, columns, height, width in FIELDS:
        found[f"field_{rows}x{columns}x{height}x{width}"] = {
            "kind": "room", "surfaces": ["texture", "white", "white"], "shape": [height, width],
            "views": [rows, columns], "sweep": False,
            "methods": {"symmetric": {}, "footprints": {}},
        }  # fmt: skip
    return found


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--only", nargs="*", help="names of scenes")
    arguments.add_argument("--table-only", action="store_true")
    asked = arguments.parse_args()
    if not asked.table_only:
        _run(asked.folder, asked.only)
    known = parse_config(_settings(scenes()), "the scenes of all sizes").scenes
    records = records_in(asked.folder / "results", known)
    write_records(records, OUTPUT)
    print(f"{OUTPUT}: {len(records)} jobs")


def _settings(chosen: dict[str, Any]) -> dict[str, Any]:
    return {
        "scenes": chosen,
        "methods": {method: {} for method in SMALL},
        "verification": {"pictures": 2},
        "capture": {"keep_raw": False},
        "resources": {"jobs": "acquisition"},
    }


def _run(folder: Path, only: list[str] | None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    chosen = {name: scene for name, scene in scenes().items() if not only or name in only}
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump(_settings(chosen), sort_keys=False), encoding="utf-8")
    targets = [
        f"results/{scene}/{method}/{job}.json"
        for scene, about in chosen.items()
        for method in about["methods"]
        for job in ("transport", "relight", "verification")
    ]
    command = [
        str(Path(sys.executable).with_name("snakemake")), "--snakefile", str(ROOT / "Snakefile"),
        "--directory", str(folder), "--configfile", str(config), "--keep-going", "--cores", "2",
    ]  # fmt: skip
    # what fails, such as a method that takes no such size, is left out of the table
    subprocess.run([*command, *targets], check=False)


if __name__ == "__main__":
    main()
