"""Tables 3.1 and 5.1 on physically based scenes: measured here, and extrapolated from it."""

from __future__ import annotations

from typing import Any

from rfpipe.report.blocks import Section, Tabulation, table_of
from rfpipe.report.figures.fits import line_fit, patterns_at
from rfpipe.report.inputs import Inputs
from rfpipe.report.text import fixed, number, percent
from rfpipe.report.thesis import TABLE_3_1, TABLE_5_1

__all__ = ["cost_rows", "costs_section"]

_FLOAT_BYTES = 4
_COLOURS = 3
_DUAL_RATE = 25 * 60 * 24  # patterns a day in the thesis' chapter 3
_HDR_SECONDS = 2.0  # a pattern, in chapter 5
_BYTES_A_TERABYTE = 1e12
_THESIS_RAYS = {
    "Fig. 3.4, box": 512 * 512,
    "Fig. 3.7, top": 298_800,
    "Fig. 3.7, bottom": 298_800,
    "Fig. 3.6, bottle": 578 * 680,
    "Fig. 3.9, 80 positions": 80 * 162_900,
    "Fig. 5.6, gummy bears": 91_176,
}
"""Projector pixels of the thesis: of Table 3.1 what its days of a brute-force scan come to."""

_FITTED_ON = {"Fig. 3.6, bottle": "bottle"}


def cost_rows(inputs: Inputs) -> list[dict[str, Any]]:
    """Return a row for each acquisition of a scene that the thesis has in Table 3.1 or 5.1.

    Returns
    -------
    list of dict
        What the studies measured, and: ``brute_force_days``, ``dense_terabytes`` and ``minutes``
        at this size, at the thesis' seconds a pattern; ``extrapolated`` and
        ``extrapolated_power``: patterns at the thesis' size by either curve of Fig. 3.8, None
        where none was fitted; ``thesis_patterns``, ``thesis_megabytes``, ``thesis_minutes``.
    """
    import pandas as pd

    growth = inputs.studies.get("growth")
    fits = {}
    if growth is not None:
        numbers = pd.DataFrame(growth.rows)
        fits = {str(scene): line_fit(own) for scene, own in numbers.groupby("scene")}
    found = []
    for study in inputs.studies.values():
        for row in study.rows:
            if not row.get("table"):
                continue
            figure = row["figure"]
            is_dual = row["table"] == "3.1"
            theirs: Any = (TABLE_3_1 if is_dual else TABLE_5_1)[figure]
            positions = row.get("positions", 1)
            scan = row["rays"] * positions
            seconds = 24 * 3600 / _DUAL_RATE if is_dual else _HDR_SECONDS
            fit = fits.get(_FITTED_ON.get(figure, "box")) if is_dual else None
            line = power = None
            if fit is not None:
                own = row["patterns"] / positions
                at = _THESIS_RAYS[figure] // (80 if positions > 1 else 1)
                line, power = (
                    positions * value for value in patterns_at(fit, at, (row["rays"], own))
                )
            dense = row["rays"] * row["camera_rays"] * positions * _COLOURS * _FLOAT_BYTES
            found.append(
                {
                    **row,
                    "scan": scan,
                    "brute_force_days": scan * seconds / 86_400,
                    "dense_terabytes": dense / _BYTES_A_TERABYTE,
                    "minutes": (row["patterns"] * seconds + row["processing_s"]) / 60,
                    "extrapolated": line,
                    "extrapolated_power": power,
                    "thesis_patterns": theirs.patterns,
                    "thesis_megabytes": theirs.megabytes,
                    "thesis_minutes": theirs.minutes,
                    "thesis_scan": _THESIS_RAYS[figure],
                }
            )
    return sorted(found, key=lambda row: (row["table"], row["figure"]))


def costs_section(inputs: Inputs) -> Section:
    """Tables 3.1 and 5.1 of the physically based scenes, and their extrapolation."""
    rows = cost_rows(inputs)
    measured = table_of(
        rows,
        [("table", "table", str), ("thesis' figure", "figure", str), ("our scene", "world", str)],
        [
            ("patterns", "patterns", number),
            ("brute force", "scan", number),
            ("of it, days", "brute_force_days", fixed(2)),
            ("dense T, GB", "dense_terabytes", fixed(2, 1000)),
            ("stored, MB", "megabytes", fixed(1)),
            ("time, min", "minutes", fixed(1)),
            ("error, %", "error", percent),
        ],
        [("", 3), ("measured at this size", 7)],
        csv="tables_3_1_and_5_1.csv",
    )
    theirs = table_of(
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
        csv="tables_3_1_and_5_1_extrapolated.csv",
    )
    about = (
        "What was shown, stored and found at the size of this run. Brute force is computed as the "
        "thesis does: a pattern a projector pixel (and a camera position), 25 patterns a minute in "
        "Table 3.1 and 2 s a pattern in Table 5.1; dense T is three 32-bit floats an entry. The "
        "time is that of the patterns at this rate with the processing as it took here."
    )
    further = (
        "Patterns at the thesis' resolution, extrapolated from ours by the two curves fitted in "
        "Fig. 3.8, beside what the thesis measured. Nothing on the left was measured. The line "
        "grows with the number of levels as the thesis claims; the power law with the pixels as "
        "found between our sizes. Table 5.1 has no such fit."
    )
    sources = [study.source for study in inputs.studies.values()]
    return Section(
        "costs_physical",
        "Tables 3.1 and 5.1 on physically based scenes",
        [
            Tabulation("Measured", about, measured, is_folded=False),
            Tabulation("Extrapolated, beside the thesis", further, theirs, is_folded=False),
        ],
        (),
        sources,
    )
