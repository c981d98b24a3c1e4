"""Pictures of light in rows, with maps of the errors of those that are relit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BRIGHT = 99.0  # percentile of a picture's radiance that is shown as white
_WIDTH, _TEXT = 2.0, 0.55  # inches, of a panel and of what stands above and below


@dataclass(frozen=True)
class Panel:
    """A picture of light: radiance (H, W, C) or (H, W), shown as white where it is `white`."""

    image: NDArray[Any]
    title: str = ""
    below: str = ""
    white: float = 1.0


@dataclass(frozen=True)
class Error:
    """The difference of a relit picture from the truth, over `white`."""

    image: NDArray[Any]
    truth: NDArray[Any]
    white: float = 1.0


def exposure(*images: NDArray[Any]) -> float:
    """Return the radiance to show as white, so that few pixels of these pictures are cut off."""
    return float(max(np.percentile(image, _BRIGHT) for image in images)) or 1.0


def new_figure(rows: int, columns: int, size: tuple[float, float], **options: Any) -> Any:
    """Return a figure without global state, and its axes (rows, columns)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=110, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.flat:
        axis.tick_params(labelsize=8)
    return figure, axes


def draw(rows: Sequence[Sequence[Panel | Error | None]], width: float = _WIDTH) -> Figure:
    """Draw rows of panels; all errors have one scale of colours, at the right.

    Parameters
    ----------
    rows : sequence of sequences of Panel, Error or None
        None leaves a place empty.
    width : float
        Of a panel, in inches.
    """
    columns = max(map(len, rows))
    shapes = [panel.image.shape for row in rows for panel in row if panel is not None]
    ratio = float(np.clip(max(shape[0] / shape[1] for shape in shapes), 0.25, 1.4))
    height = (width * ratio + _TEXT) * len(rows)
    figure, axes = new_figure(len(rows), columns, (width * columns + 0.5, height))
    errors = []
    for own, row in zip(axes, rows, strict=True):
        for axis in own:
            axis.set_axis_off()
        for axis, panel in zip(own, row, strict=False):
            if isinstance(panel, Error):
                difference = np.asarray(panel.image, float) - panel.truth
                errors.append((axis, 100 * difference.mean(axis=-1) / panel.white))
            elif panel is not None:
                _show(axis, srgb(panel.image, panel.white))
                axis.set_title(panel.title, fontsize=8.5, pad=3)
                axis.set_xlabel(panel.below, fontsize=8, labelpad=3)
    if errors:
        limit = max(float(np.percentile(np.abs([v for _, e in errors for v in e.flat]), 99)), 1e-3)
        for axis, values in errors:
            shown = _show(axis, values, cmap="RdBu_r", vmin=-limit, vmax=limit)
            axis.set_title("error", fontsize=8.5, pad=3)
        bar = figure.colorbar(shown, ax=list(axes[-1, -1:]), fraction=0.06, pad=0.03)
        bar.set_label("relit - truth, % of white", fontsize=8)
        bar.ax.tick_params(labelsize=7.5)
    return figure


def with_errors(
    levels: Sequence[Panel], truth: Panel, columns: int = 5
) -> list[list[Panel | Error | None]]:
    """Return rows of panels and of their errors below, the truth last without one."""
    panels: list[Panel] = [*levels, truth]
    rows: list[list[Panel | Error | None]] = []
    for first in range(0, len(panels), columns):
        own = panels[first : first + columns]
        rows.append(list(own))
        errors = [None if p is truth else Error(p.image, truth.image, truth.white) for p in own]
        if any(errors):
            rows.append(list(errors))
    return rows


def srgb(image: NDArray[Any], white: float) -> NDArray[np.float64]:
    """Return radiance (H, W) or (H, W, C) as sRGB (H, W, 3), by the curve of IEC 61966-2-1."""
    linear = np.clip(np.asarray(image, float) / white, 0, 1)
    if linear.ndim == 2:
        linear = linear[..., None]
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.broadcast_to(encoded, (*encoded.shape[:2], 3))


def _show(axis: Any, image: NDArray[Any], **options: Any) -> Any:
    """Show an image pixel by pixel, without ticks."""
    axis.set_axis_on()
    axis.set(xticks=[], yticks=[])
    return axis.imshow(image, interpolation="nearest", **options)
