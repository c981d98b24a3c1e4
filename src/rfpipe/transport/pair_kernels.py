"""Compiled kernels over pairs: of a block and a pixel, of two functions; many images at once.

Images of pairs of blocks and pixels are planar, one plane a pattern and channel. Each plane is
summed by one thread in the order of the pairs, so that results don't depend on the threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from rfpipe.transport.base import Float

Functions = NDArray[np.int32]


@numba.njit(cache=True, parallel=True)
def scatter_to_pixels(block, pixel, values, weights, out):  # type: ignore[no-untyped-def]
    """Add ``values * weights[block]`` to the pixels.

    Parameters
    ----------
    block, pixel : int32 (n,)
    values : float32 (K, n)
    weights : float64 (P, K, n_blocks)
    out : float64 (P, K, pixels)
        Added to in place.
    """
    channels = values.shape[0]
    for plane in numba.prange(weights.shape[0] * channels):
        p, c = plane // channels, plane % channels
        source, target = weights[p, c], out[p, c]
        for n in range(block.shape[0]):
            target[pixel[n]] += values[c, n] * source[block[n]]


@numba.njit(cache=True, parallel=True)
def gather_to_blocks(block, pixel, values, images, out):  # type: ignore[no-untyped-def]
    """Add ``values * images[pixel]`` to the blocks: the transpose of `scatter_to_pixels`.

    Pairs are ordered by block, so that a block's sum stays in a register; `out` is float64 (P, K,
    n_blocks).
    """
    channels = values.shape[0]
    for plane in numba.prange(images.shape[0] * channels):
        p, c = plane // channels, plane % channels
        source, target = images[p, c], out[p, c]
        n = 0
        while n < block.shape[0]:
            current = block[n]
            total = 0.0
            while n < block.shape[0] and block[n] == current:
                total += values[c, n] * source[pixel[n]]
                n += 1
            target[current] += total


@numba.njit(cache=True, nogil=True, fastmath=True)
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


@numba.njit(cache=True, nogil=True, fastmath=True)
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


class AsymmetricCores(NamedTuple):
    """Sparse matrix S over functions, by its symmetric and antisymmetric parts.

    ``S_ab = symmetric + antisymmetric`` and ``S_ba = symmetric - antisymmetric`` for each pair
    (a, b) of functions. The antisymmetric part of a pair (a, a) is 0.
    """

    first: Functions  # a, (pairs,)
    second: Functions  # b, (pairs,)
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
