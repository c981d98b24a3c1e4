"""Tables 3.1 and 5.1: measured here, and apart from it extrapolated to the thesis' size."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rfpipe.report import methods
from rfpipe.report.blocks import Section, Table, Tabulation, table_of
from rfpipe.report.figures.fits import line_fit, patterns_at
from rfpipe.report.inputs import Inputs
from rfpipe.report.tables import results
from rfpipe.report.text import fixed, number, percent, words
from rfpipe.report.thesis import TABLE_3_1, TABLE_5_1, numeral_of, row_of

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["cost_rows", "costs_section"]

_FLOAT_BYTES = 4
_COLOURS = 3
_DUAL_RATE = 25 * 60 * 24  # patterns a day in the thesis' chapter 3
_HDR_SECONDS = 2.0  # a pattern, in chapter 5
_BYTES_A_TERABYTE = 1e12
_THESIS_POSITIONS = {"Fig. 3.9, 80 positions": 80}
_THESIS_RAYS = {
    "Fig. 3.4, box": 512 * 512,
    "Fig. 3.7, top": 298_800,
    "Fig. 3.7, bottom": 298_800,
    "Fig. 3.6, bottle": 578 * 680,
    "Fig. 3.9, 80 positions": 80 * 162_900,
}
"""Projector pixels of the thesis: of Table 3.1 what its days of a brute-force scan come to."""

_ORDER = [*TABLE_3_1, *TABLE_5_1]

_NAMES = ("table", "figure", "world")
_MEASURED = (
    *_NAMES, "camera_rays", "rays", "positions", "scan", "brute_force_days", "dense_terabytes",
    "patterns", "processing_s", "minutes", "megabytes", "error", "noise",
)  # fmt: skip
_EXTRAPOLATED = (
    *_NAMES, "extrapolated", "extrapolated_power",
    "thesis_patterns", "thesis_scan", "thesis_megabytes", "thesis_minutes",
)  # fmt: skip
"""Columns of the tables' CSV files."""

_FITTED_ON = {"Fig. 3.6, bottle": "bottle"}


def cost_rows(inputs: Inputs) -> list[dict[str, Any]]:
    """Return a row for each acquisition of a scene that the thesis has in Table 3.1 or 5.1.

    Returns
    -------
    list of dict
        What was measured: ``table``, ``figure``, ``world``, ``rays``, ``camera_rays``,
        ``patterns``, ``megabytes``, ``processing_s``, ``error``; and ``scan``: patterns of brute
        force, ``brute_force_days``, ``dense_terabytes`` and ``minutes`` at this size, at the
        thesis' seconds a pattern. ``extrapolated`` and ``extrapolated_power``: patterns at the
        thesis' size by either curve of Fig. 3.8, None where none was fitted. What the thesis has:
        ``thesis_patterns``, ``thesis_megabytes``, ``thesis_minutes``, ``thesis_scan``.
    """
    fits = _fits(inputs)
    measured = [row for study in inputs.studies.values() for row in study.rows if row.get("table")]
    found = [_cost_row(row, fits) for row in [*measured, *_planes(inputs)]]
    return sorted(found, key=lambda row: (row["table"], _ORDER.index(row["figure"])))


def _fits(inputs: Inputs) -> dict[str, dict[str, float]]:
    """Return the curves of Fig. 3.8 by their scenes."""
    import pandas as pd

    growth = inputs.studies.get("growth")
    if growth is None:
        return {}
    numbers = pd.DataFrame(growth.rows)
    return {str(scene): line_fit(own) for scene, own in numbers.groupby("scene")}


def _planes(inputs: Inputs) -> list[dict[str, Any]]:
    """Return the rows of scenes I to IV of Fig. 2.1, which are acquisitions of the run."""
    scenes = inputs.config.scenes
    chosen = methods.of_table("5.1", inputs.methods)
    found = []
    for row in results(inputs).to_dict("records") if inputs.runs else ():
        figure = row_of(scenes[row["scene"]])
        if row["method"] in chosen and figure and numeral_of(scenes[row["scene"]]):
            more = {"table": "5.1", "figure": figure, "world": row["title"]}
            more |= {"camera_rays": row["rays"], "error": row["mean_error"]}
            found.append({str(key): value for key, value in row.items()} | more)
    return found


def _cost_row(row: dict[str, Any], fits: dict[str, dict[str, float]]) -> dict[str, Any]:
    """Set what brute force would cost, and the thesis' numbers, beside a measured row."""
    figure = row["figure"]
    is_dual = row["table"] == "3.1"
    theirs: Any = (TABLE_3_1 if is_dual else TABLE_5_1)[figure]
    positions, at_thesis = row.get("positions", 1), _THESIS_POSITIONS.get(figure, 1)
    scan = row["rays"] * positions
    seconds = 24 * 3600 / _DUAL_RATE if is_dual else _HDR_SECONDS
    fit = fits.get(_FITTED_ON.get(figure, "box")) if is_dual else None
    line = power = None
    if fit is not None:
        own = row["patterns"] / positions
        at = _THESIS_RAYS[figure] // at_thesis
        line, power = (at_thesis * value for value in patterns_at(fit, at, (row["rays"], own)))
    dense = row["rays"] * row["camera_rays"] * positions * _COLOURS * _FLOAT_BYTES
    return {
        **row,
        "ours": words(row["world"]) + (f", {positions} positions" if at_thesis > 1 else ""),
        "scan": scan,
        "brute_force_days": scan * seconds / 86_400,
        "dense_terabytes": dense / _BYTES_A_TERABYTE,
        "minutes": (row["patterns"] * seconds + row["processing_s"]) / 60,
        "extrapolated": line,
        "extrapolated_power": power,
        "thesis_patterns": theirs.patterns,
        "thesis_megabytes": theirs.megabytes,
        "thesis_minutes": theirs.minutes,
        "thesis_scan": theirs.brute_force_patterns if not is_dual else _THESIS_RAYS[figure],
    }


def costs_section(inputs: Inputs) -> Section:
    """Tables 3.1 and 5.1, and their extrapolation."""
    rows = cost_rows(inputs)
    blocks = []
    for table_number, name, rate in (
        ("3.1", "dual photography", "25 patterns a minute"),
        ("5.1", "symmetric photography", "2 s a pattern"),
    ):
        about = (
            "What was shown, stored and found at the size of this run; nothing here is "
            "extrapolated. Brute force is computed as the thesis does: a pattern a projector pixel "
            f"(and a camera position), {rate}; dense T is three 32-bit floats an entry. The time "
            "is that of the patterns at this rate with the processing as it took here."
        )
        if table_number == "5.1":
            about += (
                " Error: of scenes I to IV the mean over the relighting patterns, of the others "
                "that of the pictures in their figures."
            )
        own = [row for row in rows if row["table"] == table_number]
        title = f"Table {table_number}, {name}, measured"
        table = _measured(own, f"table_{table_number.replace('.', '_')}.csv")
        if own:
            thesis = f"Table {table_number}"
            blocks.append(Tabulation(title, about, table, is_folded=False, thesis=thesis))
    further = (
        "Patterns at the thesis' resolution, extrapolated from ours by the two curves fitted in "
        "Fig. 3.8, beside what the thesis measured. Nothing on the left was measured. The line "
        "grows with the number of levels as the thesis claims; the power law with the pixels as "
        "found between our sizes. Fig. 3.9 is taken at the thesis' 80 positions, with as many "
        "patterns each as ours take on average. Table 5.1 has no such fit."
    )
    name = "Tables 3.1 and 5.1, extrapolated, beside the thesis"
    blocks.append(Tabulation(name, further, _beside_the_thesis(rows), is_folded=False))
    sources = [study.source for study in inputs.studies.values()]
    title = "Size, time and patterns (Tables 3.1 and 5.1)"
    return Section("costs", title, blocks, (), [*inputs.run_sources, *sources])


def _measured(rows: list[dict[str, Any]], csv: str) -> Table:
    return table_of(
        rows,
        [("thesis' figure", "figure", str), ("our scene", "ours", str)],
        [
            ("patterns", "scan", number),
            ("time, days", "brute_force_days", fixed(2)),
            ("dense T, GB", "dense_terabytes", fixed(2, 1000)),
            ("patterns", "patterns", number),
            ("time, min", "minutes", fixed(1)),
            ("size, MB", "megabytes", fixed(1)),
            ("error, %", "error", percent),
        ],
        [("", 2), ("brute force, computed at this size", 3), ("measured at this size", 4)],
        csv=csv,
        numbers=_numbers(rows, _MEASURED),
    )


def _beside_the_thesis(rows: list[dict[str, Any]]) -> Table:
    return table_of(
        rows,
        [("table", "table", str), ("thesis' figure", "figure", str)],
        [
            ("by the line", "extrapolated", number),
            ("by the power law", "extrapolated_power", number),
            ("patterns", "thesis_patterns", number),
            ("brute force", "thesis_scan", number),
            ("MB", "thesis_megabytes", number),
            ("min", "thesis_minutes", number),
        ],
        [("", 2), ("ours, extrapolated to the thesis' size", 2), ("the thesis, measured", 4)],
        csv="tables_extrapolated.csv",
        numbers=_numbers(rows, _EXTRAPOLATED),
    )


def _numbers(rows: list[dict[str, Any]], names: tuple[str, ...]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame([{name: row.get(name) for name in names} for row in rows])
