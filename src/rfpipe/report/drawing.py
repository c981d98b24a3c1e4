"""Drawing: figures without global state, radiance as pictures, and the report's palette."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.report import methods
from rfpipe.report.light import ERROR_COLOURS, ERROR_LABEL, Light, error_map, round_limit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

UNLIT_GAIN = 4
"""Factor on the radiance of the pixels that a pattern leaves dark, to show them."""

_DPI = 110
_SMALL = 8.0
_RATIOS = (0.25, 1.4)
_ABREAST = 4
_LEGEND_ENTRY = 1.9  # inches
_MARGIN = 1.3  # of a logarithmic axis, beyond what it shows


@dataclass(frozen=True)
class Drawing:
    """A figure with pictures of light, which its OpenEXR file and its caption tell of.

    Attributes
    ----------
    figure : Figure
    axes : ndarray of Axes, shape (rows, columns)
    light : list of Light
        What `show` was given.
    """

    figure: Figure
    axes: NDArray[Any]
    light: list[Light] = field(default_factory=list)
    _errors: list[tuple[Axes, NDArray[np.float64]]] = field(default_factory=list)

    def show(self, axis: Axes, light: Light, below: str = "") -> None:
        """Show a picture of light pixel by pixel, without ticks; say something under it."""
        show_image(axis, light.shown)
        label_below(axis, below)
        self.light.append(light)

    def compare(self, axis: Axes, relit: Light, truth: Light) -> None:
        """Keep a panel for the error of a relit picture; `show_errors` fills all that are kept."""
        self._errors.append((axis, error_map(relit, truth)))

    def show_errors(self) -> None:
        """Fill the panels that are kept, on one scale that stands at the right of the lowest."""
        if not self._errors:
            return
        limit = 100 * round_limit([values for _, values in self._errors])
        bounds = {"vmin": -limit, "vmax": limit}
        for axis, values in self._errors:
            shown = show_image(axis, 100 * values, cmap=ERROR_COLOURS, **bounds)
        row = max(int(np.argwhere(self.axes == axis)[0, 0]) for axis, _ in self._errors)
        colour_bar(self.figure, shown, list(self.axes[row, -1:]), ERROR_LABEL)
        self._errors.clear()


def new_figure(
    rows: int, columns: int, size: tuple[float, float], **options: Any
) -> tuple[Figure, NDArray[Any]]:
    """Make a figure with a grid of axes.

    Parameters
    ----------
    rows, columns : int
    size : (float, float)
        Width and height in inches.
    **options
        For ``Figure.subplots``.

    Returns
    -------
    Figure, ndarray of Axes, shape (rows, columns)
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.flat:
        axis.tick_params(labelsize=_SMALL, width=0.6, length=3)
        axis.spines[:].set_linewidth(0.6)
    return figure, axes


def new_panels(
    rows: int, columns: int, shapes: Sequence[tuple[int, ...]], panel: float, below: float
) -> Drawing:
    """Make a drawing of panels so many inches wide, for images of these shapes (H, W).

    Each has as many inches for text below as asked for; a row has half an inch on its left.
    """
    height = panel * panel_ratio(shapes) + below
    return Drawing(*new_figure(rows, columns, (panel * columns + 0.5, height * rows)))


def scene_curves(
    titles: Mapping[str, str],
    draw: Callable[[Axes, str], None],
    patterns: ArrayLike,
    errors: ArrayLike,
    steps: Sequence[int] = (1, 3),
) -> Figure:
    """Draw errors against patterns, both logarithmic: a panel a scene, at most four abreast.

    Parameters
    ----------
    titles : mapping of str to str
        What stands above each scene's panel.
    draw : callable
        Draws the curves of a scene, errors in per cent.
    patterns, errors : array_like of float
        All that is drawn, as fractions, for the limits of the axes.
    steps : sequence of int
        Numbers of a decade that the axes show.
    """
    columns = min(_ABREAST, len(titles))
    rows = -(-len(titles) // columns)
    figure, axes = new_figure(rows, columns, (2.5 * columns + 0.5, 2.4 * rows + 0.4))
    for axis, (scene, title) in zip(axes.flat, titles.items(), strict=False):
        axis.set_title(title, fontsize=9, pad=4)
        axis.set_xlabel("patterns", fontsize=8.5)
        logarithmic(axis, steps)
        draw(axis, scene)
        axis.set_xlim(*logarithmic_limits(patterns))
        axis.set_ylim(*logarithmic_limits(100 * np.asarray(errors)))
    for axis in axes.flat[len(titles) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel("error, %", fontsize=8.5)
    shared_legend(figure)
    return figure


def logarithmic(axis: Axes, steps: Sequence[int] = (1, 3)) -> None:
    """Make both axes of a plot logarithmic, with plain numbers at `steps` of each decade."""
    axis.set(xscale="log", yscale="log")
    for direction in (axis.xaxis, axis.yaxis):
        number_axis(direction, steps)
    axis.grid(True, which="major", linewidth=0.4, color="#dddddd")


def number_axis(axis: Axis, steps: Sequence[int] = (1, 3)) -> None:
    """Put plain numbers at `steps` of each decade of a logarithmic axis."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(10, steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
    axis.set_minor_formatter(NullFormatter())


def logarithmic_limits(values: ArrayLike) -> tuple[float, float]:
    """Return limits of a logarithmic axis that shows all values above 0."""
    found = np.asarray(values, float)
    found = found[np.isfinite(found) & (found > 0)]
    return (found.min() / _MARGIN, found.max() * _MARGIN) if found.size else (_MARGIN, 10.0)


def draw_method(axis: Axes, x: ArrayLike, y: ArrayLike, method: str) -> None:
    """Draw a method's curve, with its own colour and marker and its name for the legend."""
    axis.plot(
        x, y, label=methods.title(method), linewidth=1.4, markersize=4.5, markerfacecolor="white",
        markeredgewidth=1.2, **methods.style(method),
    )  # fmt: skip


def shared_legend(figure: Figure) -> None:
    """Put a legend of all that the panels of a figure name below them, each name once."""
    columns = max(int(figure.get_figwidth() / _LEGEND_ENTRY), 1)
    handles: dict[str, Any] = {}
    for axis in figure.axes:
        found, labels = axis.get_legend_handles_labels()
        handles |= dict(zip(labels, found, strict=True))
    figure.legend(
        handles=list(handles.values()), loc="outside lower center",
        ncols=min(columns, len(handles)),
        fontsize=8.5, frameon=False,
    )  # fmt: skip


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG file; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def image_png(pixels: NDArray[Any]) -> bytes:
    """Return an image (H, W, 3) in [0, 1] as a PNG file, pixel by pixel."""
    from matplotlib.image import imsave

    buffer = io.BytesIO()
    imsave(buffer, np.ascontiguousarray(pixels), format="png", metadata={"Software": ""})
    return buffer.getvalue()


def unlit_gain(pattern: NDArray[Any], gain: float = UNLIT_GAIN) -> NDArray[np.float64]:
    """Return factors (H, W) that brighten the pixels that a pattern leaves dark."""
    return np.where(pattern == 0, gain, 1.0)


def show_image(axis: Axes, image: NDArray[Any], **options: Any) -> AxesImage:
    """Show an image pixel by pixel, without ticks; options are those of ``Axes.imshow``."""
    axis.set(xticks=[], yticks=[])
    return axis.imshow(image, interpolation="nearest", **options)


def show_panels(
    drawing: Drawing, axes: Iterable[Axes], panels: Iterable[tuple[str, Light, str]]
) -> None:
    """Show pictures of light, each with its title and what stands below; leave other axes empty."""
    free = iter(axes)
    for (title, light, below), axis in zip(panels, free, strict=False):
        drawing.show(axis, light, below)
        axis.set_title(title, fontsize=8.5, pad=3)
    for unused in free:
        unused.set_axis_off()


def colour_bar(
    figure: Figure, shown: ScalarMappable, axes: Sequence[Axes], label: str, **options: Any
) -> None:
    """Put a scale of colours at the right of some panels."""
    bar = figure.colorbar(shown, ax=list(axes), fraction=0.06, pad=0.03, **options)
    bar.set_label(label, fontsize=_SMALL)
    bar.ax.tick_params(labelsize=7.5, width=0.5, length=2.5)
    bar.outline.set_linewidth(0.5)


def head(axes: Iterable[Axes], titles: Iterable[str]) -> None:
    """Put titles above a row of panels."""
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title, fontsize=9.5, pad=5)


def panel_ratio(shapes: Sequence[tuple[int, ...]]) -> float:
    """Return height over width of panels that show images of these shapes (H, W).

    As the tallest of them needs, within reason: an image that is longer or thinner is shown
    smaller in its panel.
    """
    return float(np.clip(max(height / width for height, width, *_ in shapes), *_RATIOS))


def label_left(axis: Axes, text: str) -> None:
    """Name a row of panels at its first one."""
    axis.set_ylabel(text, fontsize=_SMALL + 0.5, labelpad=6)


def label_below(axis: Axes, text: str) -> None:
    """Say something about a panel under it."""
    axis.set_xlabel(text, fontsize=_SMALL, labelpad=3)


def parts(items: Sequence[Any], longest: int = _ABREAST) -> Iterator[tuple[list[Any], str]]:
    """Cut what stands abreast into figures, as even as can be; yield items and a file's suffix."""
    count = -(-len(items) // longest)
    for index, part in enumerate(np.array_split(np.arange(len(items)), count or 1)):
        if len(part):
            yield [items[n] for n in part], f"_{index + 1}" if count > 1 else ""
