"""A picture of the last bracket: its exposures, what is saturated in them, and their histograms."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.pictures.images import srgb
from rfpipe.server.worker import Shown
from rfpipe.units import SATURATION_FRACTION

_MOST_PIXELS = 512
_BINS = 128
_SATURATED_COLOUR = (0.85, 0.1, 0.1)
_CHANNEL_COLOURS = {1: ("#333333",), 3: ("#b2322c", "#2f7d36", "#2a5d9e")}


def preview_png(shown: Shown, sensor: Mapping[str, Any], exposures: Sequence[float]) -> bytes:
    """Draw a bracket.

    Parameters
    ----------
    shown : Shown
        Its bracket is (E, *shape[, C]); of a stack of views the views stand one above the other.
    sensor : mapping
        The sensor's description; where it tells the camera's bits, pixels are red that
        the merge takes for saturated where nothing else is set.
    exposures : sequence of E float
        In seconds.

    Returns
    -------
    bytes
        A PNG file.
    """
    from matplotlib.figure import Figure

    camera = sensor.get("sensor", sensor)  # of a resampled one, that behind it
    full_scale = 2 ** camera["bits"] - 1 if "bits" in camera else None
    has_mosaic = camera.get("bayer") is not None
    images = [_image(frame[..., None] if has_mosaic else frame) for frame in shown.bracket]
    figure = Figure(figsize=(3.2 * len(images), 5.2), dpi=100, layout="constrained")
    axes = figure.subplots(2, len(images), squeeze=False)
    for image, exposure, (above, below) in zip(images, exposures, axes.T, strict=True):
        top = full_scale or float(image.max()) or 1.0
        is_full = image >= SATURATION_FRACTION * top if full_scale else np.zeros(image.shape, bool)
        above.imshow(_shown(image, is_full, top), interpolation="nearest")
        above.set(xticks=[], yticks=[], xlabel=f"{exposure:g} s; {is_full.mean():.2%} saturated")
        for channel, colour in enumerate(_CHANNEL_COLOURS[image.shape[-1]]):
            counts, edges = np.histogram(image[..., channel], _BINS, (0.0, top))
            below.stairs(counts, edges, color=colour)
        below.set_yscale("symlog", linthresh=1)
        below.set_xlabel("counts" if full_scale else "radiance")
    figure.suptitle(f"bracket {shown.number}, pattern {', '.join(map(str, shown.key))}")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _image(frame: NDArray[Any]) -> NDArray[Any]:
    """Return a frame (*shape, C) as an image (H, W, C), of few enough pixels."""
    image = frame.reshape(-1, *frame.shape[-2:])
    step = max(1, -(-max(image.shape[:2]) // _MOST_PIXELS))
    return image[::step, ::step]


def _shown(image: NDArray[Any], is_full: NDArray[np.bool_], top: float) -> NDArray[Any]:
    """Return RGB in [0, 1] for a screen."""
    return np.where(is_full.any(axis=-1, keepdims=True), _SATURATED_COLOUR, srgb(image, top))
