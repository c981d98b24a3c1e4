"""The picture of what the camera sees: the scene, what is saturated or too dark, rays, focus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.calibration.base import Findings
from rfpipe.calibration.sight_picture import YELLOW, sight_picture
from rfpipe.report.drawing import new_figure, panel_ratio, show_image
from rfpipe.rigs.layout import ProjectorLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["SCENE_CAPTION", "scene_figure"]

SCENE_CAPTION = (
    "Left: the scene in the projector's white, black taken off; red where it is saturated even at "
    "the shortest exposure, blue where it stays within the noise even at the longest. Yellow: the "
    "projector's outline; thin lines: some of the rays' borders. Middle: the all-off picture at "
    "the longest exposure. Right: the contrast that fine stripes keep, 100 % where nothing blurs "
    "them; grey: not lit."
)

_CYAN = "#59e0e0"
_LINES = 8
"""Borders of rays that are drawn along an axis, about."""


def scene_figure(found: Mapping[str, Findings]) -> Figure:
    """Draw what the camera sees.

    Parameters
    ----------
    found : mapping of str to Findings
        Of the step "scene"; where there are "correspondence" and "rays", rays are drawn, too.
    """
    arrays = found["scene"].arrays
    white = arrays["white"]
    figure, (axes,) = new_figure(1, 3, (8.4, 8.4 / 3 * panel_ratio([white.shape]) + 0.4))
    left, middle, right = axes
    show_image(left, sight_picture(white, arrays["saturated"], arrays["dark"]))
    if arrays["lit"].any() and not arrays["lit"].all():
        outline = np.pad(arrays["lit"], 1).astype(float)
        at = [np.arange(extent) - 1.0 for extent in outline.shape]
        left.contour(at[1], at[0], outline, levels=[0.5], colors=[YELLOW], linewidths=1.2)
    _draw_rays(left, found)
    height, width = white.shape
    left.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    left.set_title("white less black, outline, rays", fontsize=8)
    black = show_image(middle, arrays["black"], cmap="magma")
    middle.set_title("all off, counts", fontsize=8)
    right.set_facecolor("#cccccc")
    focus = show_image(right, 100 * arrays["focus"], cmap="viridis", vmin=0, vmax=100)
    right.set_title("contrast of stripes, %", fontsize=8)
    for axis, shown in ((middle, black), (right, focus)):
        figure.colorbar(shown, ax=axis, shrink=0.8).ax.tick_params(labelsize=7)
    return figure


def _draw_rays(axis: Axes, found: Mapping[str, Findings]) -> None:
    """Draw borders of rays on the camera's picture, by where its pixels look."""
    maps, rays = found.get("correspondence"), found.get("rays")
    if rays is None or maps is None or "x" not in maps.arrays or not rays.arrays:
        return
    layout = ProjectorLayout.from_arrays(rays.arrays)
    if len(layout.shape) != 2:
        return
    valid = maps.arrays["valid"]
    if valid.sum() < _LINES**2:
        return
    for name, of_axis, extent in (("x", 0, layout.shape[1]), ("y", 1, layout.shape[0])):
        index = layout.ray_of_pixel % layout.shape[1] if name == "x" else (
            layout.ray_of_pixel // layout.shape[1]
        )  # fmt: skip
        index = np.where(layout.ray_of_pixel >= 0, index, -1).max(axis=of_axis)
        borders = np.flatnonzero(np.diff(index) != 0) + 1.0
        step = max(1, extent // _LINES)
        chosen = np.unique(np.append(borders[::step], borders[-1:]))
        where = np.where(valid, maps.arrays[name], np.nan)
        axis.contour(where, levels=chosen, colors=_CYAN, linewidths=0.5)
