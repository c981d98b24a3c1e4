"""Real scenes: relit pictures without a truth to compare them with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rfpipe.report.blocks import Illustration, Section
from rfpipe.report.drawing import label_below, label_left, new_figure, panel_ratio, show_radiance
from rfpipe.report.inputs import Inputs, Run
from rfpipe.stages.evaluating.metrics import relative_rms

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["captured_figure", "captured_section"]

_PANEL = 2.05  # inches
_PER_ROW = 4


def captured_section(inputs: Inputs) -> Section:
    """The scene under floodlight and under the relighting patterns, for each method."""
    caption = (
        "The scene under floodlight, as the rig captured it and as the acquired T gives it, with "
        "their relative RMS difference, and the scene relit with each of the relighting "
        "patterns. The captured floodlit image's maximum is shown as white. The difference tells "
        "whether the levels add up, not whether each pixel's light comes from the right place."
    )
    if inputs.light_fields:
        caption += " Of the views the middle one is shown."
    return Section(
        "captured",
        "The scene relit",
        [
            Illustration(
                f"{run.title}, {run.method_title.lower()}",
                caption,
                f"captured_{run.scene}_{run.method}",
                captured_figure(run),
            )
            for run in inputs.runs
        ],
    )


def captured_figure(run: Run) -> Figure:
    """Show the floodlit images and the relit ones."""
    floodlit, relit = run.read("floodlit_captured"), run.read("floodlit_relit")
    shown = {
        "floodlit, captured": run.read_shown("floodlit_captured"),
        "floodlit, relit": run.read_shown("floodlit_relit"),
        **dict(zip(run.facts["names"], run.read_shown("relit"), strict=True)),
    }
    rows = -(-len(shown) // _PER_ROW)
    ratio = panel_ratio([next(iter(shown.values())).shape])
    figure, axes = new_figure(rows, _PER_ROW, (_PANEL * _PER_ROW, (_PANEL * ratio + 0.42) * rows))
    for axis, (name, image) in zip(axes.flat, shown.items(), strict=False):
        show_radiance(axis, image, run.white)
        axis.set_title(name.replace("_", " "), fontsize=8.5, pad=3)
    label_below(axes.flat[1], f"difference {relative_rms(relit, floodlit):.1%}")
    label_left(axes.flat[0], f"patterns {run.patterns:,}")
    for unused in axes.flat[len(shown) :]:
        unused.set_axis_off()
    return figure
