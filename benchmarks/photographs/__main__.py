"""Measure fits to photographs that lie in a folder, beside simple methods.

``python -m benchmarks.photographs FOLDER`` reads Gray code from ``FOLDER/dvrk`` and lights one at a
time from ``FOLDER/psm``; tables are printed and written into ``results/bench``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks import harness
from benchmarks.photographs.domes import dome_tables
from benchmarks.photographs.full_size import size_row
from benchmarks.photographs.gray_code import held_out_rows, place_rows
from benchmarks.photographs.relightable import relightable_table

# Pairs of the code of 100 x 100 with the finest stripes of columns and of rows.
_FINEST = (6, 13)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the measurements whose data are present; name the missing ones."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.photographs", description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="holds dvrk, psm, or both")
    parser.add_argument("--full", action="store_true", help="all camera pixels of dvrk, too")
    parser.add_argument(
        "--size", action="store_true", help="46 simulated pictures of 1500 x 2048, too (minutes)"
    )
    options = parser.parse_args(arguments)
    if options.size:
        harness.write("photographs_size", [size_row()])
    if options.folder is None:
        print(f"{parser.format_usage().strip()}\nno FOLDER is given: no photographs are measured.")
        print("Give a folder that holds dvrk (Gray code, with truth.npz), psm (lights), or both")
        return
    dvrk, psm = (options.folder / name for name in ("dvrk", "psm"))
    if _is_there(psm):
        rows = (dict(row) for _, row in dome_tables(psm).iterrows())
        harness.write("photographs_domes", rows)
        table = relightable_table(psm, range(7))
        harness.write("photographs_relightable", (dict(row) for _, row in table.iterrows()))
    if _is_there(dvrk):
        harness.write("photographs_places", place_rows(dvrk, (4, 2, 1) if options.full else (4, 2)))
        harness.write("photographs_held_out", _held_out(dvrk))


def _held_out(folder: Path) -> Iterator[dict[str, Any]]:
    yield from held_out_rows(folder, 8)
    yield from held_out_rows(folder, 4, _FINEST)


def _is_there(folder: Path) -> bool:
    """Return whether a folder exists; print a line where it does not."""
    if not folder.is_dir():
        print(f"{folder} does not exist: its measurements are left out")
    return folder.is_dir()


if __name__ == "__main__":
    main()
