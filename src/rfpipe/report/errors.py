"""Errors: against the patterns shown, as methods estimated them, and by relighting pattern."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rfpipe.report.drawing import scene_curves
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.page import Block, Column, Illustration, Section, table_of
from rfpipe.report.text import ERROR, fixed, percent, words
from rfpipe.transport.base import HISTORY_COLUMNS, estimates

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GREY = "#5c5c5c"


def speed_section(inputs: Inputs) -> Section | None:
    """Error against patterns, level by level, true and as methods estimated it; and by pattern."""
    table, steps = inputs.speed_error, histories(inputs.runs)
    names = {*table["scene"], *steps["scene"]}
    if not names:
        return None
    scenes = [scene for scene in inputs.scenes if scene in names]
    caption = (
        "Mean error of relit pictures, as if the acquisition had stopped after each level, against "
        "the patterns shown by then. Methods that fit all their pictures together have their last "
        "level alone. Dotted: the mean error that a method itself estimated while it ran. Numbers: "
        "tables/speed_error.csv."
    )
    figure = speed_figure(inputs, scenes, table, steps)
    name = "Speed against error"
    blocks: list[Block] = [Illustration(name, caption, "speed_error", figure)]
    if len(inputs.errors):
        about = (
            f"{ERROR}; means of shapes, bars and spots, and single patterns. Indirect: on pixels "
            "that a pattern leaves dark, of the light there, where those are known."
        )
        columns: list[Column] = [
            ("error, %", "error", percent),
            ("indirect, %", "indirect_error", percent),
            ("CIEDE2000", "ciede2000", fixed(2)),
        ]
        labels = [*inputs.labels, ("pattern", "pattern", words)]
        tabled = table_of("Errors by pattern", about, inputs.errors, labels, columns)
        blocks.append(replace(tabled, csv="errors.csv", numbers=None))
    return Section("speed", name, blocks)


def speed_figure(
    inputs: Inputs, scenes: Sequence[str], table: pd.DataFrame, steps: pd.DataFrame
) -> Figure:
    """Draw true errors of the speed table, and the estimates of `histories`."""

    def draw_scene(axis: Axes, scene: str) -> None:
        for method, rows in table[table["scene"] == scene].groupby("method", sort=False):
            axis.plot(rows["patterns"], 100 * rows["error"], **inputs.style(str(method)))
        for method, rows in steps[steps["scene"] == scene].groupby("method", sort=False):
            estimated = {**inputs.style(str(method)), "linestyle": ":"}
            axis.plot(rows["patterns"], 100 * rows["estimated_error"], **estimated)
        brute: dict[str, Any] = {"color": _GREY, "linewidth": 0.9, "linestyle": ":"}
        rays = inputs.of_scene(scene)[0].rays
        axis.axvline(rays, label="patterns of brute force", **brute)

    return scene_curves(scenes, draw_scene)


def histories(runs: Sequence[Run]) -> pd.DataFrame:
    """Return the estimates of all runs: ``scene``, ``method`` and `HISTORY_COLUMNS`."""
    import pandas as pd

    rows = [
        {"scene": run.scene, "method": run.method, **step}
        for run in runs
        for step in estimates(run.facts["levels"])
    ]
    return pd.DataFrame(rows, columns=["scene", "method", *HISTORY_COLUMNS])
