"""The sections on errors: by relighting pattern, and against the patterns shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rfpipe.report import methods
from rfpipe.report.blocks import Illustration, Section, Tabulation, table_of
from rfpipe.report.drawing import (
    draw_method,
    label_left,
    logarithmic,
    logarithmic_limits,
    new_figure,
    number_axis,
    parts,
    shared_legend,
)
from rfpipe.report.inputs import Inputs
from rfpipe.report.text import fixed, number, percent, wishes, words

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def errors_section(inputs: Inputs) -> Section:
    """The errors of each run under each relighting pattern."""
    about = (
        f"Asked for were {wishes(inputs.config)}. Errors are relative RMS against the scene's "
        "exact light transport: in total, and on the pixels that the pattern leaves dark, which "
        "show indirect light alone."
    )
    detail = (
        "Relighting patterns: bars, noise, a binary picture, a small spot, and the crease, a strip "
        "along which surfaces meet, where there is one. Noise lights every pixel, so that none is "
        "unlit; a scene without indirect light has nothing to compare there either."
    )
    if not all(run.is_coaxial for run in inputs.runs):
        detail += " Nor is any pixel known to be unlit that a camera sees from aside."
    if inputs.light_fields:
        detail += (
            " In a light field each view's projector shows the pattern; unlit pixels may get light "
            "from other views."
        )
    names = list(dict.fromkeys(inputs.errors["pattern"]))
    kinds = ["rms_total", "rms_unlit"]
    table = inputs.errors.pivot(index=["scene", "method"], columns="pattern", values=kinds)
    errors = table.to_dict("index")
    shown = table_of(
        [
            {"scene": run.scene, "method": run.method, **errors[run.scene, run.method]}
            for run in inputs.runs
        ],
        inputs.labels,
        [(words(name), (kind, name), percent) for kind in kinds for name in names],
        [
            ("", 2),
            ("relative RMS error in total, %", len(names)),
            ("on the unlit pixels, %", len(names)),
        ],
        csv="errors.csv",
        is_written=True,
    )
    title = "Errors by pattern"
    return Section("errors", title, [Tabulation(title, detail, shown)], [about])


def speed_section(inputs: Inputs) -> Section | None:
    """Speed against error, level by level."""
    table = inputs.speed_error
    if not len(table):
        return None
    caption = (
        "Relative RMS error of the scene relit with the first relighting pattern, as if the "
        "acquisition had stopped after each level, against the patterns shown by then and, above, "
        f"the minutes that they take at {inputs.config.capture.seconds_per_pattern:g} s a pattern. "
        "Methods that fit all their pictures together have their last level alone. Dotted: the "
        "patterns of brute force."
    )
    name, known = "Speed against error", set(table["scene"])
    curves = []
    for scenes, suffix in parts([scene for scene in inputs.scenes if scene in known]):
        drawn = table[table["scene"].isin(scenes)]
        figure, alt = _figure(inputs, drawn, scenes), _in_words(drawn)
        curves.append(Illustration(name, caption, f"speed_error{suffix}", figure, alt=alt))
    shown = table_of(
        table,
        inputs.labels,
        [
            ("level", "level", str),
            ("patterns", "patterns", number),
            ("capture, min", "capture_s", fixed(1, 1 / 60)),
            ("error, %", "error", percent),
        ],
        csv="speed_error.csv",
        is_written=True,
    )
    return Section(
        "speed", name, [*curves, Tabulation("Error after each level", "As in the plot.", shown)]
    )


def _figure(inputs: Inputs, table: pd.DataFrame, scenes: Sequence[str]) -> Figure:
    """Draw the errors against the patterns, level by level, a panel for each scene."""
    figure, axes = new_figure(1, len(scenes), (2.55 * len(scenes) + 0.5, 3.2), sharey="row")
    for axis, scene in zip(axes[0], scenes, strict=True):
        logarithmic(axis)
        for method, levels in table[table["scene"] == scene].groupby("method", sort=False):
            draw_method(axis, levels["patterns"], 100 * levels["error"], str(method))
        axis.axvline(
            inputs.of_scene(scene)[0].rays, color="#5c5c5c", linewidth=0.9, linestyle=":",
            label="patterns of brute force",
        )  # fmt: skip
        axis.set_title(scene, fontsize=9.5, pad=8)
        axis.set_xlabel("patterns", fontsize=8)
        _number_minutes(axis, inputs.config.capture.seconds_per_pattern / 60)
    label_left(axes[0, 0], "error, %")
    axes[0, 0].set_ylim(*logarithmic_limits(100 * table["error"]))
    shared_legend(figure)
    return figure


def _number_minutes(axis: Axes, minutes: float) -> None:
    """Number the time above a panel, at so many minutes a pattern."""
    functions = (lambda patterns: patterns * minutes, lambda time: time / minutes)
    above = axis.secondary_xaxis("top", functions)
    number_axis(above.xaxis)
    above.tick_params(labelsize=8, width=0.6, length=3)
    above.set_xlabel("capture, min", fontsize=8)


def _in_words(table: pd.DataFrame) -> str:
    """Say where each method's curve begins and ends."""
    ends = [
        f"{words(scene)}, {methods.listed([str(method)])}: "
        + ", ".join(
            f"{percent(row.error)} % after {number(row.patterns)} patterns"
            for row in (own.iloc[0], own.iloc[-1])
        )
        for (scene, method), own in table.groupby(["scene", "method"], sort=False)
    ]
    return f"Error against patterns. {'. '.join(ends)}."
