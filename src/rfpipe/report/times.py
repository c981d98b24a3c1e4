"""The section on where the processing time goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.report import glance, methods
from rfpipe.report.blocks import Block, Illustration, Section, Tabulation, table_of
from rfpipe.report.drawing import new_figure
from rfpipe.report.inputs import Inputs
from rfpipe.report.text import fixed, number

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

# Stages of an acquisition in order; all but the capture are processing.
_STAGES = {
    "schedule": "#8fb3d9", "capture": "#d9d9d9", "merge": "#3a6fb0", "normalize": "#9aca8c",
    "refine": "#e0914a", "assemble": "#7d5ba6",
}  # fmt: skip


def times_section(inputs: Inputs) -> Section:
    """Seconds of each stage, and of an HDR image."""
    blocks: list[Block] = []
    stages: Any = inputs.times.pivot_table(
        index=["scene", "method"], columns="stage", values="seconds", aggfunc="sum", sort=False
    ).fillna(0.0)
    if len(stages):
        caption = (
            "Wall-clock seconds of each stage, added over the levels of an acquisition. A stage's "
            "first level includes loading its code, some tenths of a second that dominate at this "
            "size; acquisitions may run side by side."
        )
        figure = _figure(stages, inputs.capture_named)
        blocks.append(Illustration("Time by stage", caption, "processing_time", figure))
    columns = ["scene", "method", "patterns", "capture_jobs_s", "processing_s"]
    costs = glance.results(inputs)[columns]
    costs = costs.assign(processing_s_per_image=costs["processing_s"] / costs["patterns"])
    table = table_of(
        costs.merge(stages, how="left", on=["scene", "method"]),
        inputs.labels,
        [
            ("HDR images", "patterns", number),
            (f"{inputs.capture_named}, s", "capture_jobs_s", fixed(1)),
            ("processing, s", "processing_s", fixed(1)),
            ("ms an image", "processing_s_per_image", fixed(1, 1000)),
        ],
        csv="processing.csv",
    )
    about = f"Processing is everything but the {inputs.capture_named}."
    blocks.append(Tabulation("Processing time", about, table))
    return Section("time", "Where the processing time goes", blocks)


def _figure(totals: pd.DataFrame, capture_named: str) -> Figure:
    """Draw the seconds of each acquisition, stacked by stage."""
    figure, axes = new_figure(1, 1, (8.6, 0.36 * len(totals) + 1.2))
    axis = axes[0, 0]
    left = np.zeros(len(totals))
    y = np.arange(len(totals))
    for stage, colour in _STAGES.items():
        if stage in totals:
            seconds = totals[stage].to_numpy()
            is_capture = stage == "capture"
            axis.barh(
                y, seconds, 0.7, left=left, color=colour, hatch="////" if is_capture else None,
                label=capture_named if is_capture else stage, edgecolor="white", linewidth=0.4,
            )  # fmt: skip
            left += seconds
    axis.set_yticks(
        y, [f"{scene}, {methods.title(method)}" for scene, method in totals.index.tolist()]
    )
    axis.invert_yaxis()
    axis.set_xlabel("seconds, all levels", fontsize=8.5)
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=len(_STAGES), fontsize=8.5, frameon=False)
    return figure
