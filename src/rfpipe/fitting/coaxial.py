"""Few pictures on a coaxial rig: near/far's model, fitted to patterns of light and dark."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.fitting.series import Series
from rfpipe.methods.adaptive.pictures import Pictures
from rfpipe.methods.adaptive.residual import Canvas, residual_of
from rfpipe.methods.adaptive.smooth import as_transport, fit
from rfpipe.methods.states import joined
from rfpipe.transport.base import Transport

__all__ = ["floodlit_of", "near_far_models"]

Float = NDArray[np.float32]


def floodlit_of(series: Series) -> tuple[Float, Float] | None:
    """Return the floodlit image (C, M) and its variance: of white pictures, else of opposite ones.

    None where there are neither, or the patterns aren't of light and dark.
    """
    if not series.is_binary:
        return None
    white = series.patterns.all(axis=1)
    if white.any():
        count = int(np.count_nonzero(white))
        mean = series.radiance[white].mean(axis=0, dtype=np.float64)
        spread = series.variance[white].sum(axis=0, dtype=np.float64) / count**2
        return mean.astype(np.float32), spread.astype(np.float32)
    number = {pattern.tobytes(): index for index, pattern in enumerate(series.patterns)}
    for index, pattern in enumerate(series.patterns):
        other = number.get((1 - pattern).astype(np.float32).tobytes())
        if other is not None:
            return (
                series.radiance[index] + series.radiance[other],
                series.variance[index] + series.variance[other],
            )
    return None


def near_far_models(series: Series, rows: list[dict[str, Any]]) -> Iterator[tuple[str, Transport]]:
    """Yield direct and smooth indirect light, and the same with what it leaves of the pictures.

    Parameters
    ----------
    series : Series
        Camera and projector share their rays, patterns are of light and dark, and `floodlit_of`
        is there.
    rows : list of dict
        The table of levels.
    """
    known = floodlit_of(series)
    assert known is not None
    told = ~series.patterns.all(axis=1) & series.patterns.any(axis=1)
    shape = series.projector_shape
    white = np.ones((1, series.patterns.shape[1]), np.bool_)
    floodlit = Pictures(white, known[0][None], known[1][None]).completed(shape)
    probes = Pictures(series.patterns[told] > 0, series.radiance[told], series.variance[told])
    pictures = joined([floodlit, probes], axis=0)
    model = fit(shape, pictures)
    smooth = as_transport(shape, rows, model, pictures)
    yield "near_far", smooth
    canvas = Canvas.of(shape, pictures)
    taken = canvas.taken(pictures.lit, pictures.radiance, pictures.variance)
    rest = residual_of(canvas, taken, smooth).transport(canvas)
    yield "near_far and what it leaves", as_transport(shape, rows, model, pictures, [rest])
