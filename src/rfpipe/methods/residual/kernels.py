"""Kernels over the matrix of what places exchange, tile by tile, so that transposes are cached."""

from __future__ import annotations

import numpy as np
from numba import njit

from rfpipe.methods.base import Float

_TILE = 32


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


@njit(cache=True, nogil=True)
def expected_squares(core: Float, prior: Float, told: Float, least: np.float32) -> None:
    """Replace `told` by the expected squares of entries, given the solution `core`.

    Rows tell of an entry, and so do columns: either leaves of its variance, the symmetric prior's,
    the part ``1 - prior told``, or a part `least`; certainties add up.
    """
    size = len(core)
    one = np.float32(1)
    for top in range(0, size, _TILE):
        for left in range(0, top + 1, _TILE):
            for row in range(top, min(top + _TILE, size)):
                for column in range(left, min(left + _TILE, row + 1)):
                    before = prior[row, column]
                    by_row = before * max(one - before * told[row, column], least)
                    by_column = before * max(one - before * told[column, row], least)
                    certainty = max(one / by_row + one / by_column - one / before, one / before)
                    told[row, column] = core[row, column] ** 2 + one / certainty
                    told[column, row] = core[column, row] ** 2 + one / certainty
