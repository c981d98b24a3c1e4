"""Figures without matplotlib's global state: rows of pictures, maps of errors, and curves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.pictures.images import srgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNLIT_GAIN = 4
"""Factor on the radiance of pixels that a pattern leaves dark, to make it visible."""

ABREAST = 4
"""Number of panels in a row."""

_ERROR = "difference,\n% of white"
_WIDTH, _LINE = 2.2, 0.16  # inches of a panel, and of a line of text
_RATIOS = (0.25, 1.4)
_LEGEND_MARK, _LEGEND_SIGN, _LEGEND_ROW = 0.6, 0.062, 0.18  # inches of a mark, a letter and a row
_LEAST_LIMIT = 1e-3  # per cent of white, for pictures without errors
_STYLE: Any = {
    "font.size": 8, "axes.labelsize": 8, "xtick.labelsize": 8, "ytick.labelsize": 8,
    "axes.linewidth": 0.6,
}  # fmt: skip


@dataclass(frozen=True)
class Map:
    """Map of values (H, W) or sRGB (H, W, 3); maps with the same `scale` share a colour bar."""

    values: NDArray[Any]
    title: str = ""
    below: str = ""
    scale: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)

    def untitled(self) -> Map:
        """Return the map without its title."""
        return replace(self, title="")


@dataclass(frozen=True)
class Panel:
    """Picture of light.

    Attributes
    ----------
    image : ndarray of float, shape (H, W[, C])
        Radiance; C is 1 or 3.
    title, below : str
    white : float
        Radiance shown as white.
    gain : ndarray of float, shape (H, W), or float
        Factor by which pixels are brightened.
    """

    image: NDArray[Any]
    title: str = ""
    below: str = ""
    white: float = 1.0
    gain: NDArray[Any] | float = 1.0

    @property
    def drawn(self) -> Map:
        """The picture as a map of sRGB."""
        light = np.atleast_3d(self.image) * np.asarray(self.gain)[..., None]
        return Map(srgb(light, self.white), self.title, self.below)

    def less(self, truth: Panel) -> Map:
        """Return the difference to the truth, brightened by the same gain."""
        return difference(self.image, truth.image, self.white, self.gain)


def difference(
    image: NDArray[Any], truth: NDArray[Any], white: float = 1.0, gain: NDArray[Any] | float = 1.0
) -> Map:
    """Return the error of a relit picture (H, W, C), mean of the channels, in per cent of white."""
    mean = (np.asarray(image, np.float64) - truth).mean(axis=-1)
    return Map(np.asarray(100 * mean * gain / white), "error", scale=_ERROR)


Drawn = Panel | Map | None
Rows = Sequence[Sequence[Drawn]]


def draw(rows: Rows, width: float = _WIDTH, labels: Sequence[str] = ()) -> Figure:
    """Draw rows of panels pixel by pixel; all errors have one scale.

    Parameters
    ----------
    rows : sequence of sequences of Panel, Map or None
        None leaves a place empty.
    width : float
        Width of a panel in inches.
    labels : sequence of str
        Labels of the rows.
    """
    columns = max(map(len, rows))
    heights = [width * _ratio(filter(None, row)) for row in rows]
    lines = max((name.count("\n") + 1 for name in labels), default=0)
    size = (width * columns + 0.9 + _LINE * lines, sum(heights) + sum(map(_text_height, rows)))
    figure, axes = new_figure(len(rows), columns, size, "compressed", height_ratios=heights)
    _fill(figure, axes, rows)
    for axis, name in zip(axes[:, 0], labels, strict=False):
        axis.set_ylabel(name)
    return figure


def _fill(figure: Figure, axes: Iterable[Any], rows: Rows) -> None:
    """Draw panels into axes, row by row; all maps of errors share one scale."""
    maps = [[panel.drawn if isinstance(panel, Panel) else panel for panel in row] for row in rows]
    errors = [panel.values for row in maps for panel in row if panel and panel.scale == _ERROR]
    limit = _round_limit(errors)
    # from blue, too dark, to red
    bounds: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
    scales: dict[str, tuple[Any, Axes]] = {}
    for row_axes, row in zip(axes, maps, strict=True):
        for axis, picture in zip_longest(row_axes, row):
            if picture is None:
                axis.set_axis_off()
                continue
            is_error = picture.scale == _ERROR
            axis.set(xticks=[], yticks=[], xlabel=picture.below, facecolor="#d3e3f3")
            axis.set_title(picture.title, fontsize=8.5, pad=3)
            options = bounds if is_error else picture.options
            image = axis.imshow(picture.values, interpolation="nearest", **options)
            scales[picture.scale] = image, row_axes[-1] if is_error else axis
    scales.pop("", None)
    for label, (image, axis) in scales.items():
        bar = figure.colorbar(image, ax=axis, fraction=0.06, pad=0.03)
        bar.set_label(label, fontsize=8)
        bar.ax.tick_params(labelsize=7.5)


def _text_height(row: Sequence[Drawn]) -> float:
    """Return the height of the titles above a row and of the texts below it, in inches."""
    above = 0.05 + _LINE * any(panel.title for panel in row if panel)
    lines = max((panel.below.count("\n") + 1 for panel in row if panel and panel.below), default=0)
    return above + _LINE * lines


def _ratio(panels: Iterable[Panel | Map]) -> float:
    """Return the largest ratio of height to width of panels, within `_RATIOS`."""
    maps = (panel.image if isinstance(panel, Panel) else panel.values for panel in panels)
    ratios = (values.shape[0] / values.shape[1] for values in maps)
    return float(np.clip(max(ratios, default=1), *_RATIOS))


def _round_limit(maps: Sequence[NDArray[Any]]) -> float:
    """Return 1, 2 or 5 times a power of ten, within which 99 % of the magnitudes lie."""
    magnitudes = np.abs(np.concatenate([np.zeros(1), *(values.ravel() for values in maps)]))
    bound = max(float(np.percentile(magnitudes, 99)), _LEAST_LIMIT)
    power = 10.0 ** np.floor(np.log10(bound))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= 0.999 * bound))


def new_figure(
    rows: int, columns: int, size: tuple[float, float], layout: Any = "constrained", **options: Any
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure of a size in inches, and its axes (rows, columns)."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(figsize=size, dpi=110, layout=layout)
        return figure, figure.subplots(rows, columns, squeeze=False, **options)


def scene_curves(
    scenes: Sequence[tuple[str, Any]], draw_scene: Callable[[Axes, Any], None]
) -> Figure:
    """Draw errors against pictures on the rig on logarithmic axes, with a panel for each scene.

    Parameters
    ----------
    scenes : sequence of (str, object)
        Title of each panel, and the argument of `draw_scene`.
    draw_scene : callable
        Draws the curves of a scene, errors in per cent.
    """
    columns = min(ABREAST, len(scenes))
    rows = -(-len(scenes) // columns)
    size = (max(2.5 * columns, 7.0) + 0.5, 2.4 * rows + 0.4)
    figure, axes = new_figure(rows, columns, size, sharex=True, sharey=True)
    for axis in axes.flat[len(scenes) :]:
        axis.set_axis_off()
    for axis, (title, scene) in zip(axes.flat, scenes, strict=False):
        axis.set_title(title, fontsize=9, pad=4)
        axis.set(xscale="log", yscale="log", xlabel="pictures on the rig", ylabel="error, %")
        axis.grid(True, linewidth=0.4, color="#dddddd")
        for direction, marks in ((axis.xaxis, (1,)), (axis.yaxis, (1, 2, 5))):
            plain_numbers(direction, marks)
        draw_scene(axis, scene)
        axis.label_outer()
    shared_legend(figure)
    return figure


def plain_numbers(axis: Any, marks: tuple[int, ...]) -> None:
    """Mark a logarithmic axis at these multiples of powers of ten, by plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(10, marks))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
    axis.set_minor_formatter(NullFormatter())


def shared_legend(figure: Figure) -> None:
    """Put a common legend of all panels below a figure."""
    handles: dict[str, Any] = {}
    for axis in figure.axes:
        handles |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    longest = max(map(len, handles), default=1)
    across = _LEGEND_MARK + _LEGEND_SIGN * longest
    columns = min(max(int(figure.get_figwidth() / across), 1), len(handles))
    rows = -(-len(handles) // columns)
    figure.set_figheight(figure.get_figheight() + _LEGEND_ROW * rows)
    look: dict[str, Any] = {"ncols": columns, "fontsize": 8.5, "frameon": False}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", **look)


def unlit_gain(pattern: NDArray[Any], gain: float = UNLIT_GAIN) -> NDArray[np.float64]:
    """Return factors (H, W) that brighten the pixels that a pattern leaves dark."""
    return np.where(pattern == 0, gain, 1.0)
