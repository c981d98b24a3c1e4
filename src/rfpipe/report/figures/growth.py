"""Patterns against resolution, for the box and the bottle [thesis Fig. 3.8]."""

from __future__ import annotations

from itertools import takewhile
from typing import TYPE_CHECKING, Any

from rfpipe.report.blocks import Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import draw_method, new_figure
from rfpipe.report.figures.fits import line_fit
from rfpipe.report.inputs import Study
from rfpipe.report.text import fixed, number, percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["growth_section"]


def growth_section(study: Study) -> Section:
    """Fig. 3.8."""
    import pandas as pd

    numbers = pd.DataFrame(study.rows).drop(columns="by_level")
    fits = [
        {"scene": scene, **line_fit(own)} for scene, own in numbers.groupby("scene", sort=False)
    ]
    caption = (
        "Patterns of dual photography against the projector's resolution, for the box of Fig. 3.4 "
        "and the bottle of Fig. 3.6 before the run's camera. Left, the number of pixels on a "
        "logarithmic scale: growth as O(log pq) is a straight line. Dashed: the line fitted to all "
        "sizes; its slope is patterns a level. Right, both logarithmic, with brute force. "
        + " ".join(_where_they_go(row) for row in _finest(study.rows))
    )
    figure = Illustration(
        "Fig. 3.8", caption, "fig_3_8_physical", _growth_figure(numbers, fits), "Fig. 3.8"
    )
    return Section(
        "growth",
        "Patterns against resolution, box and bottle (Fig. 3.8)",
        [
            figure,
            Tabulation("Patterns by resolution", "As measured.", _growth_table(numbers)),
            Tabulation("Lines fitted to them", _FITS, _fits_table(fits), is_folded=False),
            Tabulation("Where the patterns go", _LEVELS, _levels_table(study.rows)),
        ],
        (),
        [study.source],
    )


_FITS = (
    "Slope: patterns that a further level (twice the pixels along a side) takes, fitted to all "
    "sizes; share of the variance that the line explains; and the exponent of pixels in a power "
    "law fitted to the same numbers: 0 is logarithmic growth, 1 is brute force."
)


_LEVELS = (
    "At the finest projector, by level: blocks of the level, patterns that light them, and how "
    "many of the blocks above a camera pixel sees that have to be subdivided for it, in the mean. "
    "All blocks that one pixel sees conflict with each other, so that a level takes four "
    "patterns for each of them at least."
)


def _finest(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the row of each scene's finest projector."""
    return list({row["scene"]: row for row in sorted(rows, key=lambda row: row["rays"])}.values())


def _where_they_go(row: dict[str, Any]) -> str:
    """Say which levels take the patterns, and why."""
    alone = list(takewhile(lambda level: level["patterns"] >= level["blocks"], row["by_level"]))
    shared = row["by_level"][len(alone) :]
    told = (
        f"The {row['scene']} at {row['side']} x {row['side']}: down to blocks of "
        f"{row['side'] >> alone[-1]['level']} pixels a side each block is lit alone, since light "
        "goes from each to all parts of the scene that the camera sees: coarser projectors show "
        "brute force, which grows with the pixels."
    )
    told += "".join(
        f" Level {level['level']} lights its {number(level['blocks'])} blocks in "
        f"{number(level['patterns'])} patterns; a camera pixel tells {level['told_apart']:.0f} "
        "blocks above apart in the mean, which can't be lit together."
        for level in shared
    )
    peak = max(row["by_level"], key=lambda level: level["patterns"])
    if peak["level"] < row["by_level"][-1]["level"]:
        told += (
            f" Beyond level {peak['level']} more and more responses are below the threshold and "
            "stored, so that fewer blocks are left to tell apart."
        )
    return told


def _levels_table(rows: list[dict[str, Any]]) -> Table:
    return table_of(
        [{"scene": row["scene"], **level} for row in _finest(rows) for level in row["by_level"]],
        [("scene", "scene", str)],
        [
            ("level", "level", str),
            ("blocks", "blocks", number),
            ("patterns", "patterns", number),
            ("blocks above, a camera pixel", "told_apart", fixed(1)),
        ],
        csv="growth_levels.csv",
    )


def _growth_figure(numbers: Any, fits: list[dict[str, Any]]) -> Figure:
    figure, axes = new_figure(1, 2, (8.6, 3.4))
    colours = dict(zip([fit["scene"] for fit in fits], ("#c4611a", "#3a6fb0"), strict=False))
    sides = numbers.drop_duplicates("rays").sort_values("rays")
    for axis in axes[0]:
        for fit in fits:
            own = numbers[numbers["scene"] == fit["scene"]]
            colour = colours[fit["scene"]]
            axis.plot(own["rays"], own["patterns"], "o-", color=colour, label=fit["scene"])
            if axis is axes[0, 0]:
                fitted = fit["base"] + fit["slope"] * own["levels"]
                axis.plot(own["rays"], fitted, "--", color=colour, linewidth=0.9)
        axis.set_xscale("log", base=2)
        axis.set_xticks(sides["rays"], [f"{side}²" for side in sides["side"]])
        axis.set_xlabel("projector pixels", fontsize=8.5)
        axis.set_ylabel("patterns", fontsize=8.5)
        axis.grid(True, linewidth=0.4, color="#dddddd")
    draw_method(axes[0, 1], sides["rays"], sides["rays"], "brute_force")
    axes[0, 1].set_yscale("log")
    for axis in axes[0]:
        axis.legend(fontsize=8, frameon=False)
    return figure


def _growth_table(numbers: Any) -> Table:
    patterns = numbers.pivot(index="scene", columns="side", values="patterns")
    return table_of(
        patterns.reset_index(),
        [("scene", "scene", str)],
        [(f"{side} x {side}", side, number) for side in patterns.columns],
        csv="growth.csv",
        numbers=numbers,
    )


def _fits_table(fits: list[dict[str, Any]]) -> Table:
    return table_of(
        fits,
        [("scene", "scene", str)],
        [
            ("patterns a level", "slope", number),
            ("variance explained, %", "explained", percent),
            ("exponent of pixels", "exponent", lambda value: f"{value:.2f}"),
        ],
        csv="growth_fits.csv",
    )
