"""The tables of docs/measured.md, docs/cost.md and README: ``make measured``.

Acquires what docs/measured/acquisitions.csv lacks of the code as it is, hours from nothing, takes
the results of the default run and of `make thesis` from their folders, if they are there, and
those that `benchmarks.large` left, and writes each table between its markers, ``<!-- NAME -->`` and
``<!-- /NAME -->``.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks import cost
from benchmarks.methods.__main__ import run
from benchmarks.methods.cases import Case, by_place, cases_of, known_keys, newest
from benchmarks.methods.page import markdown
from rfpipe.store.files import write_atomically

FOLDER = Path("docs/measured")
PAGES = (Path("docs/measured.md"), Path("docs/cost.md"), Path("README.md"))
_TABLE = "acquisitions.csv"
THESIS = {  # Table 5.1: patterns and MB
    "planes_i": ("I, one textured plane", 809, 255),
    "planes_ii": ("II, two white planes", 1085, 371),
    "planes_iii": ("III, white and textured", 1081, 334),
    "planes_iv": ("IV, two textured", 841, 274),
    "sweets": ("translucent sweets, for Fig. 5.6", 2417, 337),
    "light_field": ("3 x 3 views, for Fig. 5.8", 3368, 1470),
}
_INDIRECT = "error of indirect light, %"
_PATTERNS = "patterns (thesis, which gives no errors)"
_ALIKE = 1.1  # largest ratio of two errors that count as equal
_SIDES = ("48", "96", "192")
_THESIS_SIDE = "310x350"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run missing acquisitions, then write the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measured", description=__doc__)
    parser.add_argument("--run", type=Path, default=Path("results/report/tables"),
                        help="tables of the default run")  # fmt: skip
    parser.add_argument("--thesis", type=Path, default=Path("thesis/results/report/tables"),
                        help="tables of `make thesis`")  # fmt: skip
    parser.add_argument("--cache", type=Path, default=Path("results/recorded"),
                        help="folder of recorded matrices")  # fmt: skip
    parser.add_argument("--minutes", type=float, default=float("inf"),
                        help="begin no acquisition after so long")  # fmt: skip
    parser.add_argument("--table-only", action="store_true", help="acquire nothing")
    options = parser.parse_args(arguments)
    table = FOLDER / _TABLE
    if not options.table_only:
        known = known_keys(table)
        missing = [case for case in all_cases() if case.key not in known]
        run(missing, table, by_place(table), options.cache, 60 * options.minutes)
    for tables, name in ((options.run, "default_run"), (options.thesis, "thesis_run")):
        if (tables / "results.csv").exists():
            write_atomically(FOLDER / f"{name}.csv", of_run(tables).encode())
    for page in PAGES:
        write_atomically(page, written(page.read_text("utf-8"), FOLDER).encode())


def all_cases() -> Iterator[Case]:
    """List all acquisitions, the largest ones last."""
    matt, physical = ["wedge_30", "wedge_aside"], ["red_wall_box", "two_blocks"]
    for side in _SIDES:
        scenes = matt + physical * (side != _SIDES[-1])
        yield from cases_of(scenes, ["auto"], ["full"], [1], values=[0.01], side=side)
    for method, values in (("near_far", [0.01, 0.005, 0.003]), ("symmetric", [1e-2, 3e-3, 1e-3])):
        scenes = ["wedge_ii", "wedge_iii", "wedge_iv"]
        yield from cases_of(scenes, [method], ["full"], [0], values=values, side=_THESIS_SIDE)


def of_run(tables: Path) -> str:
    """Select the columns shown of a run's tables, as CSV."""
    results = pd.read_csv(tables / "results.csv")
    columns = ["scene", "method", "patterns", "pictures", "megabytes", "mean_error",
               "estimated_error", "worst_error", "mean_indirect"]  # fmt: skip
    return str(results[columns].to_csv(index=False, float_format="%.4g", lineterminator="\n"))


def written(text: str, folder: Path) -> str:
    """Return a page with tables from the files in a folder."""
    rows = newest(folder / _TABLE)
    makers: dict[str, Callable[[], str]] = {
        "default run": lambda: _default(pd.read_csv(folder / "default_run.csv")),
        "methods": lambda: _methods(pd.read_csv(folder / "default_run.csv")),
        "sides": lambda: _of_sides(rows),
        "errors": lambda: _of_planes(rows),
        "thesis": lambda: _of_thesis(pd.read_csv(folder / "thesis_run.csv")),
        "beaten": lambda: _beaten(_thesis_run(folder)),
        "large": lambda: _large(_ends(folder / "large.csv")),
        "stages": lambda: _stages(pd.read_csv(folder / "large_stages.csv")),
        "cost by target": lambda: cost.by_target(folder.with_name("benchmark") / _TABLE),
        "cost by size": lambda: cost.by_size(folder),
        "thesis, two": lambda: _of_thesis(pd.read_csv(folder / "thesis_run.csv"), last=2),
    }
    for name, make in makers.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
        before, body, after = text.partition(begin)
        if body:
            text = f"{before}{begin}\n{make()}\n{end}{after.partition(end)[2]}"
    return text


def _percent(value: Any) -> str:
    """Format a fraction in per cent with two digits; a word without indirect light."""
    return f"{100 * value:#.2g}".rstrip(".") if value > 0 else "none" if value == 0 else ""


def _default(rows: pd.DataFrame) -> str:
    head = ["scene", "method", "patterns", "pictures on the rig", "MB stored", "mean error, %",
            "estimated, %", "largest, %", _INDIRECT]  # fmt: skip
    return markdown(
        head,
        (
            [row.scene, f"`{row.method}`", str(row.patterns), str(row.pictures),
             f"{row.megabytes:.2f}",
             *map(_percent, (row.mean_error, row.estimated_error, row.worst_error,
                             row.mean_indirect))]
            for row in rows.itertuples()
        ),
    )  # fmt: skip


def _methods(rows: pd.DataFrame) -> str:
    """Return the methods on the default run's scene IV."""
    scene_rows = rows[rows["scene"] == "planes_iv"]
    return markdown(
        ["method", "patterns", "pictures on the rig", "mean error, %", _INDIRECT],
        ([f"`{row.method}`", str(row.patterns), str(row.pictures), _percent(row.mean_error),
          _percent(row.mean_indirect)] for row in scene_rows.itertuples()),
    )  # fmt: skip


def _of_sides(rows: pd.DataFrame) -> str:
    """Return the cost of `auto` for 1 % against the number of pixels."""
    chosen = rows[(rows["method"] == "auto") & rows["side"].isin(_SIDES)]
    lines = []
    for scene, scene_rows in chosen.groupby("scene", sort=False):
        at = scene_rows.set_index("side")
        cells = [
            f"{at.pictures[side]} ({at.patterns[side]}): {_percent(at.error_mean[side])}, "
            f"{at.processing_s[side]:.0f} s, {at.memory_gb[side]:.1f} GB"
            if side in at.index else ""
            for side in _SIDES
        ]  # fmt: skip
        lines.append([f"`{scene}`", *cells])
    return markdown(["scene", *(f"{side} x {side}" for side in _SIDES)], lines)


def _of_planes(rows: pd.DataFrame) -> str:
    """Return speed against error at the thesis' size."""
    chosen = rows[(rows["side"] == _THESIS_SIDE) & (rows["status"] == "done")]
    lines = [
        [THESIS[str(scene).replace("wedge", "planes")][0], f"`{method}`",
         *(f"{row.pictures} ({row.patterns}): {_percent(row.error_mean)}, "
           f"{_percent(row.indirect_mean)}"
           for row in scene_rows.sort_values("patterns").itertuples())]
        for (scene, method), scene_rows in chosen.groupby(["scene", "method"])
    ]  # fmt: skip
    head = ["scene", "method", "coarse", "finer", "finest"]
    return markdown(head, ([*line, *[""] * (len(head) - len(line))] for line in lines))


def _thesis_run(folder: Path) -> pd.DataFrame:
    """Return the acquisitions of Table 5.1: the run of `make thesis`, and the sweets."""
    acquisitions = pd.concat([pd.read_csv(folder / "thesis_run.csv"), _ends(folder / "large.csv")])
    return acquisitions[acquisitions["scene"].isin(THESIS) & (acquisitions["method"] != "dual")]


def _of_thesis(rows: pd.DataFrame, last: int | None = None) -> str:
    """Return acquisitions of all scenes of `make thesis`, or of the last ones, beside Table 5.1."""
    scenes = list(rows["scene"].unique())[-last if last else None :]
    lines = []
    for row in rows[rows["scene"].isin(scenes)].itertuples():
        title, patterns, megabytes = THESIS[str(row.scene)]
        lines.append(
            [title, f"`{row.method}`", f"{row.patterns:,} ({patterns:,})", f"{row.pictures:,}",
             f"{row.megabytes:.1f} ({megabytes:,})",
             *map(_percent, (row.mean_error, row.worst_error, row.mean_indirect))]
        )  # fmt: skip
    head = ["scene", "method", _PATTERNS, "pictures on the rig", "MB stored (thesis)",
            "mean error, %", "largest, %", _INDIRECT]  # fmt: skip
    return markdown(head, lines)


def _ends(path: Path) -> pd.DataFrame:
    """Return the acquisitions after their last levels."""
    rows = pd.read_csv(path)
    return rows.groupby(["scene", "method"], sort=False).tail(1)


def _beaten(rows: pd.DataFrame) -> str:
    """Return the thesis' Table 5.1, its method here, and the fewest patterns for its error."""
    lines = []
    for scene, (title, patterns, megabytes) in THESIS.items():
        scene_rows = rows[rows["scene"] == scene].sort_values("patterns")
        if scene_rows.empty:  # a run without this scene
            continue
        of_thesis = scene_rows["method"] == "symmetric"
        theirs, ours = scene_rows[of_thesis].iloc[0], scene_rows[~of_thesis]
        alike = ours[ours["mean_error"] <= _ALIKE * theirs.mean_error]
        best = alike.iloc[0] if len(alike) else ours.sort_values("mean_error").iloc[0]
        lines.append(
            [title, f"{patterns:,}, {megabytes:,} MB",
             *(f"{row.patterns} ({row.pictures}), {row.megabytes:.3g} MB: "
               f"{_percent(row.mean_error)}, {_percent(row.mean_indirect)}"
               for row in (theirs, best)),
             f"{patterns / best.patterns:.0f}, {megabytes / best.megabytes:.0f}"]
        )  # fmt: skip
    cell_format = "patterns (pictures on the rig), MB: error, error of indirect light, %"
    head = ["scene", "thesis, without errors: patterns, MB", f"`symmetric`: {cell_format}",
            f"`near_far` or `auto`: {cell_format}",
            "times fewer than the thesis: patterns, MB"]  # fmt: skip
    return markdown(head, lines)


def _large(rows: pd.DataFrame) -> str:
    """Return the physically based scenes at the size of a rig."""
    head = ["scene", "method", "patterns", "pictures on the rig", "MB stored", "estimated, %",
            "mean error, %", "largest, %", _INDIRECT, "verified, %"]  # fmt: skip
    return markdown(
        head,
        (
            [row.scene, f"`{row.method}`", str(row.patterns), str(row.pictures),
             f"{row.megabytes:.3g}",
             *map(_percent, (row.estimated_error, row.mean_error, row.worst_error,
                             row.mean_indirect, row.verified))]
            for row in rows.itertuples()
        ),
    )  # fmt: skip


def _stages(rows: pd.DataFrame) -> str:
    """Return processor minutes and peak memory of stages that took half a minute in any."""
    longest = rows.groupby("stage")["processor_s"].transform("max")
    rows = rows[longest >= 30].copy()
    rows["cell"] = [
        f"{row.processor_s / 60:.1f} min, {row.memory_gib:.1f} GiB" for row in rows.itertuples()
    ]
    stages = rows.pivot_table("cell", "stage", ["scene", "method"], "first", sort=False).fillna("")
    head = ["stage", *(f"{scene}, `{method}`" for scene, method in stages.columns)]
    return markdown(head, ([stage, *cells] for stage, *cells in stages.itertuples()))


if __name__ == "__main__":
    logging.basicConfig(format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    logging.getLogger("benchmark").setLevel(logging.INFO)
    logging.getLogger("rfpipe").setLevel(logging.ERROR)
    main()
