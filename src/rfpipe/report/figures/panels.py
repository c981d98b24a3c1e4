"""Rows of pictures of light, as the thesis' figures show them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report.drawing import Drawing, new_panels
from rfpipe.report.inputs import Study
from rfpipe.report.light import Light

__all__ = ["Panel", "compared", "draw_panels", "exposure", "light_of", "size_of"]

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
    columns = max(map(len, rows))
    shapes = [light.radiance.shape for row in rows for _, light, _ in row]
    drawing = new_panels(len(rows), columns, shapes, _WIDTH, _BELOW)
    for axes, row in zip(drawing.axes, rows, strict=True):
        for axis in axes[len(row) :]:
            axis.set_axis_off()
        for axis, (title, light, below) in zip(axes, row, strict=False):
            drawing.show(axis, light, below)
            axis.set_title(title, fontsize=8.5, pad=3)
    return drawing


def compared(rows: Sequence[Sequence[Panel]], pairs: Sequence[tuple[Light, Light]]) -> Drawing:
    """Draw rows of panels, each with a map of the error of a relit picture at its right."""
    columns = max(map(len, rows)) + 1
    shapes = [light.radiance.shape for row in rows for _, light, _ in row]
    drawing = new_panels(len(rows), columns, shapes, _WIDTH, _BELOW)
    for axes, row, (relit, truth) in zip(drawing.axes, rows, pairs, strict=True):
        for axis in axes[len(row) : -1]:
            axis.set_axis_off()
        for axis, (title, light, below) in zip(axes, row, strict=False):
            drawing.show(axis, light, below)
            axis.set_title(title, fontsize=8.5, pad=3)
        axes[-1].set_title("error", fontsize=8.5, pad=3)
        drawing.compare(axes[-1], relit, truth)
    drawing.show_errors()
    return drawing


def size_of(row: dict[str, Any]) -> str:
    """Say how large a study's pictures are, and how exact its ground truth."""
    camera, projector = (
        " x ".join(map(str, row[f"{side}_shape"])) for side in ("camera", "projector")
    )
    noise = row.get("noise")
    exact = "" if noise is None else f"; the true matrix has {noise:.1%} of Monte-Carlo noise"
    return f"Camera {camera}, projector {projector} pixels{exact}."
