"""Every method on every scene: ``python -m benchmarks.methods``, or ``make benchmark``.

Runs what the table of acquisitions lacks, appends a row each, and makes the page of them all.
Tolerances tighter than all that they are compared with are left out.
"""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.methods.cases import (
    AUTO,
    CAMERAS,
    NAMES,
    SEEDS,
    SIDE,
    SMALL_SIDES,
    Case,
    Rows,
    appending,
    by_place,
    cases_of,
    is_needless,
    known_keys,
)
from benchmarks.methods.measure import measure
from benchmarks.methods.page import write_page
from benchmarks.methods.scenes import KINDS

_log = logging.getLogger("benchmark")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run missing cases, then write the page."""
    options = parsed(arguments)
    table = options.folder / "acquisitions.csv"
    cases, known = list(asked_cases(options)), known_keys(table)
    missing = [case for case in cases if case.key not in known]
    _log.info("at most %d acquisitions to do, %d rows in %s", len(missing), len(known), table)
    if not options.table_only:
        run(missing, table, by_place(table), options.cache, 60 * options.minutes)
    if table.exists():
        write_page(options.folder, table, cases)


def parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.methods", description=__doc__)
    parser.add_argument("--scenes", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--methods", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--lights", nargs="+", choices=CAMERAS, default=list(CAMERAS))
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    parser.add_argument("--settings", type=int, help="of each method, from the coarsest; all")
    parser.add_argument("--side", nargs="+",
                        help=f"pixels, or HxW; {SIDE}, and smaller ones of {AUTO}")  # fmt: skip
    parser.add_argument("--values", nargs="+", type=float, help="of the option")
    parser.add_argument("--channels", type=int, choices=(1, 3), default=1)
    parser.add_argument("--samples", type=int, default=16384, help="paths of light a pixel; 16384")
    parser.add_argument("--minutes", type=float, default=float("inf"),
                        help="begin no acquisition after so long")  # fmt: skip
    parser.add_argument("--folder", type=Path, default=Path("docs/benchmark"))
    parser.add_argument("--cache", type=Path, default=Path("results/recorded"),
                        help="folder of recorded matrices")  # fmt: skip
    parser.add_argument("--table-only", action="store_true", help="run nothing")
    return parser.parse_args(arguments)


def asked_cases(options: argparse.Namespace) -> list[Case]:
    """List the cases of the command line."""
    names = ("scenes", "methods", "lights", "seeds", "settings", "values", "channels", "samples")
    settings = {name: getattr(options, name) for name in names}
    if options.side:
        return [case for side in options.side for case in cases_of(**settings, side=side)]
    small = [case for side in SMALL_SIDES for case in cases_of(**settings, side=side)]
    estimated = [case for case in small if case.method == AUTO and case.light == "full"]
    return [*cases_of(**settings), *estimated]


def run(cases: Sequence[Case], table: Path, rows: Rows, cache: Path, seconds: float) -> None:
    """Run cases in turn; append a row each, to the table and to the rows of its place."""
    for case in {case.method: case for case in cases}.values():
        measure(replace(case, scene="wedge_iv", side="8", seed=0), cache)  # load compiled code
    began = time.monotonic()
    with appending(table) as append:
        for number, case in enumerate(cases, start=1):
            if is_needless(case, rows[case.place]):
                continue
            if time.monotonic() - began > seconds:
                _log.info("time is up: %d of %d done", number - 1, len(cases))
                return
            row = measure(case, cache)
            append(row)
            outcome = row.get("why", "")
            if row["status"] == "done":
                rows[case.place].append(row)
                outcome = f"{row['pictures']} pictures, mean error {row['error_mean']:.3g}"
            _log.info("%d of %d: %s: %s", number, len(cases), case, outcome)


if __name__ == "__main__":
    logging.basicConfig(format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    _log.setLevel(logging.INFO)
    logging.getLogger("rfpipe").setLevel(logging.ERROR)
    main()
