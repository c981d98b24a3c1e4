"""Kernels over the pairs of functions of a `MultiscaleBasis`."""

from __future__ import annotations

import numpy as np
from numba import njit

from rfpipe.transport.base import Float
from rfpipe.transport.multiscale.basis import Functions


@njit(cache=True, nogil=True, fastmath=True)
def couple(first: Functions, second: Functions, cores: Float, light: Float, out: Float) -> None:
    """Add ``S light`` to `out`, S symmetric with one core a pair; both (functions, columns)."""
    for pair in range(len(first)):
        a, b, core = first[pair], second[pair], cores[pair]
        if core == 0:
            continue
        if a == b:
            for column in range(light.shape[1]):
                out[a, column] += core * light[a, column]
        else:
            for column in range(light.shape[1]):
                out[a, column] += core * light[b, column]
                out[b, column] += core * light[a, column]


@njit(cache=True, nogil=True, fastmath=True)
def correlate(first: Functions, second: Functions, seen: Float, light: Float, out: Float) -> None:
    """Write the adjoint of `couple` by cores: per pair, ``seen_a light_b + seen_b light_a``."""
    for pair in range(len(first)):
        a, b = first[pair], second[pair]
        total = np.float32(0)
        if a == b:
            for column in range(light.shape[1]):
                total += seen[a, column] * light[a, column]
        else:
            for column in range(light.shape[1]):
                total += seen[a, column] * light[b, column] + seen[b, column] * light[a, column]
        out[pair] = total
