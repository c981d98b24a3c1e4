"""Empty, stored and subdivided nodes of each level, as in Fig. 5.10."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

from rfpipe.report.drawing import ABREAST, new_figure, shared_legend
from rfpipe.report.inputs import RelitAcquisition, ReportInputs
from rfpipe.report.page import Column, Illustration, Section, table_of
from rfpipe.report.text import number
from rfpipe.stages.evaluate import is_used

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_TITLE_WIDTH = 26
"""Characters on a line of a panel's title."""

_KINDS = {
    "rank1": ("rank-1 leaves (dual: stored)", "#3a6fb0"),
    "scalar": ("scalar leaves", "#9dc0e6"),
    "empty": ("empty", "#b9b9b9"),
    "subdivided": ("subdivided at the next level", "#ffffff"),
}


def leaves_section(inputs: ReportInputs) -> Section | None:
    """Return the section of leaves at each level; None if no acquisition has leaves."""
    import pandas as pd

    levels = pd.DataFrame(
        [
            {"scene": run.scene, "method": run.method, **row}
            for run in inputs.runs
            for row in run.facts["levels"]
            if is_used(row)
        ]
    )
    runs = [run for run in inputs.runs if len(run.facts["levels"]) > 1]
    drawn = [run for run in runs if _is_hierarchy(run.rows_of(levels))]
    if not drawn:
        return None
    kinds = {"rank1": "rank-1 or stored"}
    counted = ("patterns", "nodes", "empty", "rank1", "scalar", "subdivided")
    columns: list[Column] = [(kinds.get(kind, kind), kind, number) for kind in counted]
    table = table_of(
        "Levels",
        "Patterns and nodes of each level.",
        levels,
        inputs.labels,
        [("level", "level", str), *columns],
        csv="levels.csv",
    )
    caption = (
        "Kinds of the nodes of each level, in per cent: leaves are stored, the remaining nodes are "
        "subdivided. With symmetric photography a node is a pair of blocks, with dual photography "
        "a block and a camera pixel."
    )
    figure = Illustration("Leaves", caption, "leaves", _figure(inputs, drawn, levels))
    return Section("leaves", "Leaves at each level", [figure, table])


def _is_hierarchy(levels: pd.DataFrame) -> bool:
    """Test whether there are nodes, each of exactly one kind."""
    return bool(
        levels["nodes"].any() and (levels[list(_KINDS)].sum(axis=1) == levels["nodes"]).all()
    )


def _figure(inputs: ReportInputs, runs: list[RelitAcquisition], table: pd.DataFrame) -> Figure:
    """Draw a panel for each run."""
    columns = min(ABREAST, len(runs))
    rows = -(-len(runs) // columns)
    figure, axes = new_figure(rows, columns, (max(2.45 * columns + 0.4, 6.6), 2.35 * rows + 0.6))
    names, colours = zip(*_KINDS.values(), strict=True)
    for axis in axes.flat[len(runs) :]:
        axis.set_axis_off()
    for axis, run in zip(axes.flat, runs, strict=False):
        levels = run.rows_of(table).query("nodes > 0").set_index("level")
        shares = 100 * levels[list(_KINDS)].div(levels["nodes"], axis=0).set_axis(names, axis=1)
        bars: dict[str, Any] = {
            "width": 0.82,
            "edgecolor": "#444444",
            "linewidth": 0.5,
            "legend": False,
        }
        shares.plot.bar(stacked=True, ax=axis, color=[*colours], rot=0, **bars)
        axis.set(ylim=(0, 100), yticks=[0, 50, 100], ylabel="nodes, %")
        title = textwrap.fill(inputs.title(run.method), _TITLE_WIDTH)
        axis.set_title(f"{run.scene}\n{title}", fontsize=8.5, pad=4)
    shared_legend(figure)
    return figure
