"""Compiled kernels that round the factors of leaves, and give them back."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def _maximum(values):  # type: ignore[no-untyped-def]
    found = np.float32(0.0)
    for value in values:
        found = max(found, value)
    return np.float64(found)


@numba.njit(cache=True, parallel=True)
def encode(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, offset_a, offset_b, values, largest, codes, scales
):
    """Write the codes of each leaf's factors, and its scale.

    Parameters
    ----------
    starts : int64 (n_blocks + 1,)
    block_a, block_b : int32 (n,)
    offset_a, offset_b : int64 (n,)
        Where the leaf's two factors begin in `values`.
    values : float32 (C, n_values)
        Not negative.
    largest : int
        Code of a factor's maximum.
    codes : unsigned (C, n_values)
    scales : float32 (C, n)
        Geometric mean of the two maxima, over ``largest ** 2``; 0 for a leaf that is zero, whose
        codes are 0, too.
    """
    for n in numba.prange(block_a.shape[0]):
        size_a = starts[block_a[n] + 1] - starts[block_a[n]]
        size_b = starts[block_b[n] + 1] - starts[block_b[n]]
        for c in range(values.shape[0]):
            maximum_a = _maximum(values[c, offset_a[n] : offset_a[n] + size_a])
            maximum_b = _maximum(values[c, offset_b[n] : offset_b[n] + size_b])
            mean = np.sqrt(maximum_a) * np.sqrt(maximum_b)
            scales[c, n] = mean / (np.float64(largest) * largest)
            for maximum, first, size in (
                (maximum_a, offset_a[n], size_a),
                (maximum_b, offset_b[n], size_b),
            ):
                for k in range(first, first + size):
                    root = np.sqrt(values[c, k] / maximum) if mean > 0 else 0.0
                    codes[c, k] = np.int64(root * largest + 0.5)


@numba.njit(cache=True, parallel=True)
def decode(offsets, codes, scales, values):  # type: ignore[no-untyped-def]
    """Write the values of each leaf's factors.

    Parameters
    ----------
    offsets : int64 (n + 1,)
        Where each leaf's values begin.
    codes : unsigned (C, n_values)
    scales : float32 (C, n)
    values : float32 (C, n_values)
    """
    for n in numba.prange(offsets.shape[0] - 1):
        for c in range(codes.shape[0]):
            for k in range(offsets[n], offsets[n + 1]):
                root = np.float32(codes[c, k])
                values[c, k] = root * root * scales[c, n]
