"""Rows of pictures of light, as the thesis' figures show them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report.drawing import Drawing, new_panels, show_panels
from rfpipe.report.inputs import Study
from rfpipe.report.light import Light

__all__ = [
    "Panel",
    "compared",
    "draw_levels",
    "draw_panels",
    "exposure",
    "light_of",
    "size_of",
    "with_errors_below",
]

Panel = tuple[str, Light, str]
"""What stands above a picture, the picture, and what stands below."""

_WIDTH, _BELOW = 2.0, 0.55  # inches
_BRIGHT = 99.0  # percentile of a picture's radiance that is shown as white


def exposure(*images: NDArray[Any]) -> float:
    """Return the radiance to show as white, so that few pixels of these pictures are cut off."""
    return float(max(np.percentile(image, _BRIGHT) for image in images)) or 1.0


def light_of(study: Study, name: str, what: str, white: float, of: str = "", **more: Any) -> Light:
    """Return a study's picture of this name, with the radiance that is shown as white."""
    return Light(of or study.rows[0].get("world", study.name), what, study.images.read(name), white,
                 **more)  # fmt: skip


def draw_panels(rows: Sequence[Sequence[Panel]]) -> Drawing:
    """Draw rows of panels."""
    drawing = _panels(len(rows), max(map(len, rows)), rows)
    for axes, row in zip(drawing.axes, rows, strict=True):
        show_panels(drawing, axes, row)
    return drawing


def compared(rows: Sequence[Sequence[Panel]], pairs: Sequence[tuple[Light, Light]]) -> Drawing:
    """Draw rows of panels, each with a map of the error of a relit picture at its right."""
    drawing = _panels(len(rows), max(map(len, rows)) + 1, rows)
    for axes, row, (relit, truth) in zip(drawing.axes, rows, pairs, strict=True):
        show_panels(drawing, axes[:-1], row)
        axes[-1].set_title("error", fontsize=8.5, pad=3)
        drawing.compare(axes[-1], relit, truth)
    drawing.show_errors()
    return drawing


def with_errors_below(
    rows: Sequence[Sequence[Panel]], pairs: Sequence[tuple[Light, Light] | None]
) -> Drawing:
    """Draw rows of panels, and below each column the error of a relit picture; None for none."""
    drawing = _panels(len(rows) + 1, max(map(len, rows)), rows)
    for axes, row in zip(drawing.axes, rows, strict=False):
        show_panels(drawing, axes, row)
    _show_errors_in(drawing, drawing.axes[-1], pairs)
    return drawing


def draw_levels(levels: Sequence[Panel], last: Panel, truth: Light | None = None) -> Drawing:
    """Draw a panel a level in two rows, and one more at the end.

    Parameters
    ----------
    levels : sequence of Panel
        Coarse to fine.
    last : Panel
        What they are compared with, or add up to.
    truth : Light, optional
        Of which the error of each level is shown below it.
    """
    panels = [*levels, last]
    half = -(-len(panels) // 2)
    rows = [panels[:half], panels[half:]]
    if truth is None:
        return draw_panels(rows)
    drawing = _panels(4, half, rows)
    for index, row in enumerate(rows):
        show_panels(drawing, drawing.axes[2 * index], row)
        pairs = [(light, truth) for _, light, _ in row]
        if index:
            pairs.pop()  # the truth itself
        _show_errors_in(drawing, drawing.axes[2 * index + 1], pairs)
    return drawing


def _panels(rows: int, columns: int, shown: Sequence[Sequence[Panel]]) -> Drawing:
    shapes = [light.radiance.shape for row in shown for _, light, _ in row]
    return new_panels(rows, columns, shapes, _WIDTH, _BELOW)


def _show_errors_in(
    drawing: Drawing, axes: NDArray[Any], pairs: Sequence[tuple[Light, Light] | None]
) -> None:
    """Fill a row of axes with error maps, and leave the others of it empty."""
    for axis, pair in zip_longest(axes, pairs):
        if pair is None:
            axis.set_axis_off()
        else:
            axis.set_title("error", fontsize=8.5, pad=3)
            drawing.compare(axis, *pair)
    drawing.show_errors()


def size_of(row: dict[str, Any]) -> str:
    """Say how large a study's pictures are, and how exact its ground truth."""
    camera, projector = (
        " x ".join(map(str, row[f"{side}_shape"])) for side in ("camera", "projector")
    )
    noise = row.get("noise")
    exact = "" if noise is None else f"; the true matrix has {noise:.1%} of Monte-Carlo noise"
    return f"Camera {camera}, projector {projector} pixels{exact}."
