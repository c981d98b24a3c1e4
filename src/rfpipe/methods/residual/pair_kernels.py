"""Compiled products with the exchange of pairs of wavelets.

A pair k of a camera's wavelet a and a projector's wavelet b has the prior variance V_k. For the
light l and the dual solution r, in wavelets, `rfpipe.methods.residual.posterior` needs

    X_k = V_k (r_a . l_b)                   and the sum of X_k l_b over the pairs of each a

and on coaxial rigs, where a pair (a, b) with a <= b is stored once and X is symmetric,

    X_k = V_k (r_a . l_b + r_b . l_a)       and also the sum of X_k l_a over the pairs of each b
"""

from __future__ import annotations

import numba
import numpy as np

from rfpipe.array_types import Float
from rfpipe.methods.residual.cell_data import WaveletPairs


@numba.njit(cache=True, nogil=True, fastmath=True)
def exchange(pairs: WaveletPairs, received: Float, light: Float, X: Float, out: Float) -> None:
    """Write X, (pairs,), and add its product with the light to `out`, (m, P)."""
    for k in range(len(pairs.first)):
        a, b = pairs.first[k], pairs.second[k]
        total = np.float32(0)
        for p in range(light.shape[1]):
            total += received[a, p] * light[b, p]
        X[k] = core = pairs.variance[k] * total
        for p in range(light.shape[1]):
            out[a, p] += core * light[b, p]


@numba.njit(cache=True, nogil=True, fastmath=True)
def exchange_symmetric(
    pairs: WaveletPairs, received: Float, light: Float, X: Float, out: Float
) -> None:
    """Write X, (pairs,), and add the product of the symmetric X with the light to `out`, (m, P)."""
    for k in range(len(pairs.first)):
        a, b = pairs.first[k], pairs.second[k]
        total = np.float32(0)
        for p in range(light.shape[1]):
            total += received[a, p] * light[b, p] + received[b, p] * light[a, p]
        X[k] = core = pairs.variance[k] * total
        for p in range(light.shape[1]):
            out[a, p] += core * light[b, p]
        if a != b:
            for p in range(light.shape[1]):
                out[b, p] += core * light[a, p]


@numba.njit(cache=True, nogil=True)
def extrapolate(
    matrix: Float, previous: Float, weight: float, least: Float, skips_diagonal: bool
) -> None:
    """Extrapolate K from a previous K, and clip it to the least light between two cells.

    ``K + weight (K - previous)`` is written to `matrix`, and K to `previous`. Entries below `least`
    are raised to it, except on the diagonal if `skips_diagonal`.
    """
    factor = np.float32(weight)
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            value = matrix[i, j]
            further = value + factor * (value - previous[i, j])
            previous[i, j] = value
            if further < least[i, j] and not (skips_diagonal and i == j):
                further = least[i, j]
            matrix[i, j] = further
