"""Compiled sums of float32 numbers in float64."""

from __future__ import annotations

import numba
import numpy as np

_FAST = {"reassoc", "contract", "nsz", "arcp"}


@numba.njit(cache=True, fastmath=_FAST)
def summed(values):  # type: ignore[no-untyped-def]
    """Return the sum of values."""
    total = 0.0
    for k in range(values.shape[0]):
        total += np.float64(values[k])
    return total


@numba.njit(cache=True, fastmath=_FAST)
def dot(first, second):  # type: ignore[no-untyped-def]
    """Return the inner product of two runs of values."""
    total = 0.0
    for k in range(first.shape[0]):
        total += np.float64(first[k]) * np.float64(second[k])
    return total
