"""Plots: leaves a level, speed against error, processing time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.report import methods
from rfpipe.report.drawing import (
    draw_method,
    label_left,
    logarithmic,
    logarithmic_limits,
    new_figure,
    number_axis,
    shared_legend,
)
from rfpipe.report.inputs import Inputs, Run

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "has_leaves_of_nodes",
    "leaves_figure",
    "speed_error_figure",
    "times_figure",
]

# Stages of an acquisition in order; all but the capture are processing.
_STAGES = ("schedule", "capture", "merge", "normalize", "refine", "assemble")
_KINDS = (
    ("rank1", "rank-1 leaves (dual: stored)", "#3a6fb0"),
    ("rank_k", "rank-k leaves", "#7d5ba6"),
    ("scalar", "scalar leaves", "#9dc0e6"),
    ("empty", "empty", "#b9b9b9"),
    ("subdivided", "subdivided at the next level", "#ffffff"),
)
_LEGEND_WIDTH = 6.6  # inches, of the kinds of leaves in one row
_STAGE_COLOURS = ("#8fb3d9", "#d9d9d9", "#3a6fb0", "#9aca8c", "#e0914a", "#7d5ba6")


def has_leaves_of_nodes(run: Run) -> bool:
    """Tell whether each of a level's nodes became one thing, as in a hierarchy of blocks."""
    return all(
        sum(int(row.get(key, 0)) for key, *_ in _KINDS) == row["nodes"]
        for row in run.facts["levels"]
    )


def leaves_figure(rows: Sequence[Sequence[Run]]) -> Figure:
    """Draw what became of each level's nodes, in per cent [Fig. 5.10].

    Parameters
    ----------
    rows : sequence of sequences of Run
        A row of panels for each method, a panel for each scene.
    """
    columns = max(len(runs) for runs in rows)
    width = max(2.45 * columns + 0.4, _LEGEND_WIDTH)
    figure, axes = new_figure(len(rows), columns, (width, 2.35 * len(rows) + 0.35))
    for panels, runs in zip(axes, rows, strict=True):
        for axis in panels[len(runs) :]:
            axis.set_axis_off()
        for axis, run in zip(panels, runs, strict=False):
            _stack_levels(axis, run)
            axis.set_title(f"{run.title}\n{run.method_title}", fontsize=8.5, pad=4)
        label_left(panels[0], "nodes, %")
    for axis in axes[-1]:
        axis.set_xlabel("level", fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=8.5, frameon=False)
    return figure


def _stack_levels(axis: Axes, run: Run) -> None:
    levels = [row for row in run.facts["levels"] if row["nodes"]]
    x = [row["level"] for row in levels]
    nodes = np.array([row["nodes"] for row in levels], float)
    bottom = np.zeros(len(levels))
    for key, label, colour in _KINDS:
        share = 100 * np.array([row.get(key, 0) for row in levels], float) / nodes
        axis.bar(x, share, 0.82, bottom=bottom, color=colour, edgecolor="#444444", linewidth=0.5,
                 label=label)  # fmt: skip
        bottom += share
    axis.set(xticks=x, ylim=(0, 100), yticks=[0, 50, 100])


def speed_error_figure(inputs: Inputs, scenes: Sequence[str]) -> Figure:
    """Draw the errors against the patterns, level by level, a panel for each scene."""
    figure, axes = new_figure(1, len(scenes), (2.55 * len(scenes) + 0.5, 3.2), sharey="row")
    table = inputs.speed_error
    for axis, scene in zip(axes[0], scenes, strict=True):
        run = inputs.of_scene(scene)[0]
        logarithmic(axis)
        for method, levels in table[table["scene"] == scene].groupby("method", sort=False):
            draw_method(axis, levels["patterns"], 100 * levels["error"], str(method))
        axis.axvline(run.rays, color="#5c5c5c", linewidth=0.9, linestyle=":",
                     label="patterns of brute force")  # fmt: skip
        axis.set_title(run.title, fontsize=9.5, pad=8)
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


def times_figure(times: pd.DataFrame, capture_named: str) -> Figure:
    """Draw the seconds of each acquisition, stacked by stage.

    Parameters
    ----------
    times : DataFrame
        As `Inputs.times`, not empty.
    capture_named : str
        What captures are called.
    """
    totals: Any = times.pivot_table(
        index=["scene", "method"], columns="stage", values="seconds", aggfunc="sum", sort=False
    ).fillna(0.0)
    figure, axes = new_figure(1, 1, (8.6, 0.36 * len(totals) + 1.2))
    axis = axes[0, 0]
    left = np.zeros(len(totals))
    y = np.arange(len(totals))
    for stage, colour in zip(_STAGES, _STAGE_COLOURS, strict=True):
        if stage in totals:
            seconds = totals[stage].to_numpy()
            hatch = "////" if stage == "capture" else None
            name = capture_named if stage == "capture" else stage
            axis.barh(y, seconds, 0.7, left=left, color=colour, label=name, hatch=hatch,
                      edgecolor="white", linewidth=0.4)  # fmt: skip
            left += seconds
    axis.set_yticks(y, [f"{scene}, {methods.title(method)}" for scene, method in totals.index])
    axis.invert_yaxis()
    axis.set_xlabel("seconds, all levels", fontsize=8.5)
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=len(_STAGES), fontsize=8.5, frameon=False)
    return figure
