"""Compiled steps of the Haar transform, and transposition of large matrices.

One step of the transform turns each square of four values (a b; c d) into a mean and three details,
and back::

    mean = (a + b + c + d) / 2          a = (mean + x + y + z) / 2
    x    = (a - b + c - d) / 2          b = (mean - x + y - z) / 2
    y    = (a + b - c - d) / 2          c = (mean + x - y - z) / 2
    z    = (a - b - c + d) / 2          d = (mean - x - y + z) / 2
"""

from __future__ import annotations

import numba
import numpy as np

from rfpipe.array_types import Float

_HALF = np.float32(0.5)
_TILE = 32  # rows and columns that are transposed at a time, so that they stay in the cache


@numba.njit(cache=True, nogil=True, fastmath=True)
def divide_into_details(images: Float, means: Float, details: Float) -> None:
    """Write the means (V, H, W, P) and details (3, V, H, W, P) of P images (V, 2 H, 2 W, P)."""
    views, height, width, count = means.shape
    for view in range(views):
        for row in range(height):
            for column in range(width):
                for p in range(count):
                    a = _HALF * images[view, 2 * row, 2 * column, p]
                    b = _HALF * images[view, 2 * row, 2 * column + 1, p]
                    c = _HALF * images[view, 2 * row + 1, 2 * column, p]
                    d = _HALF * images[view, 2 * row + 1, 2 * column + 1, p]
                    means[view, row, column, p] = (a + c) + (b + d)
                    details[0, view, row, column, p] = (a + c) - (b + d)
                    details[1, view, row, column, p] = (a - c) + (b - d)
                    details[2, view, row, column, p] = (a - c) - (b - d)


@numba.njit(cache=True, nogil=True, fastmath=True)
def combine_details(means: Float, details: Float, images: Float) -> None:
    """Write P images (V, 2 H, 2 W, P) from their means and details, see `divide_into_details`."""
    views, height, width, count = means.shape
    for view in range(views):
        for row in range(height):
            for column in range(width):
                for p in range(count):
                    mean = _HALF * means[view, row, column, p]
                    x = _HALF * details[0, view, row, column, p]
                    y = _HALF * details[1, view, row, column, p]
                    z = _HALF * details[2, view, row, column, p]
                    images[view, 2 * row, 2 * column, p] = (mean + y) + (x + z)
                    images[view, 2 * row, 2 * column + 1, p] = (mean + y) - (x + z)
                    images[view, 2 * row + 1, 2 * column, p] = (mean - y) + (x - z)
                    images[view, 2 * row + 1, 2 * column + 1, p] = (mean - y) - (x - z)


@numba.njit(cache=True, nogil=True)
def transpose(matrix: Float, out: Float) -> None:
    """Write the transpose of a matrix (m, n) into (n, m), tile by tile."""
    rows, columns = matrix.shape
    for row in range(0, rows, _TILE):
        for column in range(0, columns, _TILE):
            for i in range(row, min(row + _TILE, rows)):
                for j in range(column, min(column + _TILE, columns)):
                    out[j, i] = matrix[i, j]
