"""The section on what becomes of each level's nodes [Fig. 5.10]."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rfpipe.report import methods
from rfpipe.report.blocks import Block, Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import label_left, new_figure, parts
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import number

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_KINDS = {
    "rank1": ("rank-1 leaves (dual: stored)", "#3a6fb0"),
    "rank_k": ("rank-k leaves", "#7d5ba6"),
    "scalar": ("scalar leaves", "#9dc0e6"),
    "empty": ("empty", "#b9b9b9"),
    "subdivided": ("subdivided at the next level", "#ffffff"),
}


def leaves_section(inputs: Inputs) -> Section | None:
    """Leaves a level, in per cent of the nodes, and their numbers."""
    import pandas as pd

    runs = [run for run in inputs.runs if len(run.facts["levels"]) > 1]
    if not runs:
        return None
    levels = pd.DataFrame(
        [
            {"scene": run.scene, "method": run.method, "rank_k": 0, **row}
            for run in inputs.runs
            for row in run.facts["levels"]
        ]
    )
    drawn = [run for run in runs if _is_hierarchy(run.own(levels))]
    groups = [
        [run for run in drawn if run.method == method and run.settings.is_light_field == is_field]
        for method in inputs.methods
        for is_field in (False, True)
    ]
    rows = [part for group in groups for part, _ in parts(group)]
    caption = (
        "What becomes of the parts of T that are measured at each level, its nodes, in per cent "
        "of them: a leaf is stored as it is, the others are subdivided. With symmetric "
        "photography a node is a pair of blocks; empty ones are the sparse part of T, rank-1 ones "
        "the data-sparse part. With dual photography a node is a block as seen by one camera "
        "pixel, and a leaf a response that is stored at this level. The last level's leaves are "
        "scalars."
    )
    about = "Patterns and nodes of each level, added over the scenes of a method."
    blocks: list[Block] = [Tabulation("Levels", about, _table(inputs, levels))]
    if rows:
        blocks.insert(0, Illustration("Fig. 5.10", caption, "fig_5_10", _figure(rows, levels)))
    return Section("leaves", "Leaves at each level (Fig. 5.10)", blocks)


def _is_hierarchy(levels: pd.DataFrame) -> bool:
    """Tell whether each of a level's nodes became one thing."""
    return bool((levels[list(_KINDS)].sum(axis=1) == levels["nodes"]).all())


def _figure(rows: list[list[Run]], table: pd.DataFrame) -> Figure:
    """Draw a row of panels for each method, a panel for each scene."""
    columns = max(len(runs) for runs in rows)
    width = max(2.45 * columns + 0.4, 6.6)  # of the legend
    figure, axes = new_figure(len(rows), columns, (width, 2.35 * len(rows) + 0.35))
    for panels, runs in zip(axes, rows, strict=True):
        for axis in panels[len(runs) :]:
            axis.set_axis_off()
        for axis, run in zip(panels, runs, strict=False):
            _stack_levels(axis, run.own(table))
            axis.set_title(f"{run.scene}\n{run.method_title}", fontsize=8.5, pad=4)
        label_left(panels[0], "nodes, %")
    for axis in axes[-1]:
        axis.set_xlabel("level", fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=8.5, frameon=False)
    return figure


def _stack_levels(axis: Axes, levels: pd.DataFrame) -> None:
    levels = levels[levels["nodes"] > 0]
    bottom = np.zeros(len(levels))
    for kind, (label, colour) in _KINDS.items():
        share = 100 * (levels[kind] / levels["nodes"]).to_numpy()
        axis.bar(
            levels["level"], share, 0.82, bottom=bottom, color=colour, edgecolor="#444444",
            linewidth=0.5, label=label,
        )  # fmt: skip
        bottom += share
    axis.set(xticks=levels["level"], ylim=(0, 100), yticks=[0, 50, 100])


def _table(inputs: Inputs, levels: pd.DataFrame) -> Table:
    """Return the sums over scenes; the CSV file has each run's own levels."""
    # the second level of a light field has whole views
    fields = levels["scene"].isin([run.scene for run in inputs.light_fields])
    kinds = ["patterns", "nodes", "empty", "rank1", "rank_k", "scalar", "subdivided"]
    sums = levels.groupby([fields, "method", "level"], sort=False)[kinds].sum().reset_index()
    suffix = sums["scene"].map({True: ", light fields", False: ""})
    names = {"rank1": "rank-1 or stored", "rank_k": "rank-k"}
    return table_of(
        sums.assign(method=sums["method"].map(methods.title) + suffix),
        [("method", "method", str)],
        [("level", "level", str), *((names.get(kind, kind), kind, number) for kind in kinds)],
        csv="levels.csv",
        numbers=levels,
    )
