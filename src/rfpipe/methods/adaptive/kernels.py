"""Kernels over patches of pixels, and over the matrix of what cells exchange."""

from __future__ import annotations

import numpy as np
from numba import njit

from rfpipe.methods.base import Float

_TILE = 32  # transposes of tiles are cached


@njit(cache=True, nogil=True, fastmath=True)
def weigh(arriving: Float, dark: Float, lit: Float, out: Float) -> None:
    """Weigh the light that arrives under each pattern and, last, full light, as pictures show it.

    Dark pixels see a pattern's light, lit ones how it differs from full light. `out` may be
    `arriving`.
    """
    last = dark.shape[1]
    for patch in range(len(arriving)):
        full, back = arriving[patch, last], np.float32(0)
        for pattern in range(last):
            under = arriving[patch, pattern]
            lacking = lit[patch, pattern] * (under - full)
            out[patch, pattern] = dark[patch, pattern] * under + lacking
            back -= lacking
        out[patch, last] = back


@njit(cache=True, nogil=True)
def symmetric_product(half: Float, weight: Float) -> None:
    """Replace `half` by ``(half + half^T) weight``, weights symmetric."""
    size = len(half)
    other = np.empty((_TILE, _TILE), np.float32)
    for top in range(0, size, _TILE):
        rows = min(_TILE, size - top)
        for left in range(0, top + 1, _TILE):
            columns = min(_TILE, size - left)
            for column in range(columns):
                for row in range(rows):
                    other[row, column] = half[left + column, top + row]
            for row in range(rows):
                for column in range(columns):
                    both = half[top + row, left + column] + other[row, column]
                    other[row, column] = both * weight[top + row, left + column]
            for row in range(rows):
                for column in range(columns):
                    half[top + row, left + column] = other[row, column]
            for column in range(columns):
                for row in range(rows):
                    half[left + column, top + row] = other[row, column]
