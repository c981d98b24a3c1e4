"""Chapter 2 and Appendix A of the thesis as checks."""

from __future__ import annotations

from typing import Any

from rfpipe.report.blocks import Illustration, Section, Tabulation, table_of
from rfpipe.report.figures.panels import compared, exposure
from rfpipe.report.inputs import Study
from rfpipe.report.light import Light

__all__ = ["laws_section"]


def laws_section(study: Study) -> Section:
    """Duality, symmetry, rank, texture and energy, with a picture of duality."""
    names = ("dual_by_transpose", "dual_by_exchange")
    white = exposure(*map(study.images.read, names))
    one, other = (
        Light("two_blocks", what, study.images.read(name), white)
        for name, what in zip(names, ("transposed", "exchanged"), strict=True)
    )
    caption = (
        "The dual picture of a box with two blocks, twice: by the transposed matrix, and by a "
        "matrix recorded with projector and camera exchanged, a second recording with other random "
        "numbers. Their difference is Monte-Carlo noise."
    )
    drawing = compared(
        [[("transposed matrix", one, ""), ("projector and camera exchanged", other, "")]],
        [(one, other)],
    )
    about = (
        "What chapter 2 and Appendix A of the thesis say of any light transport, measured on ours. "
        "Beside each number stands what it is to be compared with: for duality and symmetry the "
        "recordings' noise, for ranks the size of the block, for energy the bounce before."
    )
    table = table_of(
        study.rows,
        [("law", "law", str), ("measured", "what", str)],
        [("value", "value", _shown), ("compared with", "limit", _shown)],
        csv="laws.csv",
    )
    return Section(
        "laws",
        "The laws of light transport (chapter 2, Appendix A)",
        [
            Illustration("Duality", caption, "fig_2_2", drawing),
            Tabulation("Checks", about, table, is_folded=False),
        ],
        (),
        [study.source],
    )


def _shown(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:g}" if float(value).is_integer() else f"{value:.3g}"
