"""Compiled products of a symmetric sparse matrix S of cores, one for each pair of functions.

S has the core ``cores[k]`` at (first[k], second[k]) and, by symmetry, at (second[k], first[k]).
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from rfpipe.array_types import Float, Numbers


@numba.njit(cache=True, nogil=True, fastmath=True)
def couple(first: Numbers, second: Numbers, cores: Float, light: Float, out: Float) -> None:
    """Add ``S light`` to `out`; both are (functions, columns)."""
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


@numba.njit(cache=True, nogil=True, fastmath=True)
def correlate(first: Numbers, second: Numbers, received: Float, light: Float, out: Float) -> None:
    """Write the adjoint of `couple` with respect to the cores.

    ::

        out[k] = sum over columns of received[a] light[b] + received[b] light[a]

    for functions a = first[k] and b = second[k], where the second term counts only if a != b.
    """
    for pair in range(len(first)):
        a, b = first[pair], second[pair]
        total = np.float32(0)
        if a == b:
            for column in range(light.shape[1]):
                total += received[a, column] * light[a, column]
        else:
            for column in range(light.shape[1]):
                total += (
                    received[a, column] * light[b, column] + received[b, column] * light[a, column]
                )
        out[pair] = total


class AsymmetricCores(NamedTuple):
    """Sparse matrix S over functions, by its symmetric and antisymmetric parts.

    ``S_ab = symmetric + antisymmetric`` and ``S_ba = symmetric - antisymmetric`` for each pair
    (a, b) of functions. The antisymmetric part of a pair (a, a) is 0.
    """

    first: Numbers  # a, (pairs,)
    second: Numbers  # b, (pairs,)
    symmetric: Float  # (pairs,)
    antisymmetric: Float  # (pairs,)


@numba.njit(cache=True, nogil=True, fastmath=True)
def couple_asymmetric(S: AsymmetricCores, light: Float, out: Float) -> None:
    """Add ``S light`` to `out`, both (functions, columns)."""
    for pair in range(len(S.first)):
        a, b = S.first[pair], S.second[pair]
        core = S.symmetric[pair] + S.antisymmetric[pair]
        mirrored = S.symmetric[pair] - S.antisymmetric[pair]
        for column in range(light.shape[1]):
            out[a, column] += core * light[b, column]
        if a != b:
            for column in range(light.shape[1]):
                out[b, column] += mirrored * light[a, column]


@numba.njit(cache=True, nogil=True, fastmath=True)
def correlate_asymmetric(received: Float, light: Float, S: AsymmetricCores) -> None:
    """Write the adjoint of `couple_asymmetric` with respect to the cores into S.

    For `received` r and `light` l, (functions, columns), the parts of a pair (a, b) are
    ``r_a . l_b + r_b . l_a`` and ``r_a . l_b - r_b . l_a``, those of (a, a) ``r_a . l_a`` and 0.
    """
    for pair in range(len(S.first)):
        a, b = S.first[pair], S.second[pair]
        core, mirrored = np.float32(0), np.float32(0)
        for column in range(light.shape[1]):
            core += received[a, column] * light[b, column]
            mirrored += received[b, column] * light[a, column]
        S.symmetric[pair] = core if a == b else core + mirrored
        S.antisymmetric[pair] = 0 if a == b else core - mirrored
