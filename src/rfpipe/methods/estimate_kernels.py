"""Compiled sums over a relit picture for the error estimate."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from rfpipe.array_types import Bools, Double, Float, Index


class RelitParts(NamedTuple):
    """Sum of the relit pictures of a pattern's parts.

    Attributes
    ----------
    total : ndarray of float64, shape (C, M)
    brightest : ndarray of int64, shape (M,)
        Number of the part that lights each pixel most.
    brightness : ndarray of float32, shape (M,)
        Light of that part, summed over channels.
    """

    total: Double
    brightest: Index
    brightness: Float


@numba.njit(cache=True, nogil=True)
def add_part(
    relit: RelitParts, part: int, picture: Float, known: Bools, dark: Bools
) -> tuple[float, float]:
    """Add the picture (C, M) of a part; return its squared norms on known, and known dark pixels.

    `known` and `dark`, (M,), are the pixels that count, and those without direct light.
    """
    all_light, dark_light = 0.0, 0.0
    for pixel in range(len(known)):
        if not known[pixel]:
            continue
        brightness, square = np.float32(0), 0.0
        for channel in range(len(picture)):
            value = picture[channel, pixel]
            relit.total[channel, pixel] += value
            brightness += value
            square += np.float64(value) * value
        if brightness > relit.brightness[pixel]:
            relit.brightest[pixel] = part
            relit.brightness[pixel] = brightness
        all_light += square
        if dark[pixel]:
            dark_light += square
    return all_light, dark_light
