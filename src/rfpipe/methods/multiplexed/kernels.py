"""Compiled sparse Bayesian regression of the blocks that light a camera pixel.

For the radiance c of a pixel in P pictures, with noise variances N, means A of the patterns over
K blocks, and prior variances V of the blocks' light t, let ``B = N^-1/2 A V^1/2``. The posterior
has two equal forms, of which the one with the smaller matrix is computed:

    t = V^1/2 B^T S^-1 N^-1/2 c,  var(t) = V - V^1/2 B^T S^-1 B V^1/2,   S = 1 + B B^T    (P, P)
    t = V^1/2 H^-1 B^T N^-1/2 c,  var(t) = V^1/2 H^-1 V^1/2,             H = 1 + B^T B    (K, K)

Both are products of the columns of ``L^-1 X``, where S or ``H = L L^T`` and X has the columns of B
and N^-1/2 c, or of 1 and B^T N^-1/2 c.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from rfpipe.array_types import Double, Float, Index, Numbers
from rfpipe.methods.multiplexed.lapack_kernels import add_products, whiten

# Variance below which a block's light counts as 0, relative to the squared floodlit pixel. With a
# hundredth of it fits take 1.2 to 1.6 times as long and errors are 2 % smaller; with ten times as
# much, errors are 4 % larger.
VANISHING = 1e-7


# Power of the factor of expectation maximisation by which variances change. Iterations with it have
# the effect of twice as many with a power of 1.
_POWER = 1.8


class PixelPictures(NamedTuple):
    """Pictures of some camera pixels, the floodlit picture first."""

    means: Float  # mean of each pattern over each block of all levels, (P, blocks)
    radiance: Double  # (pixels, P)
    noise: Double  # variance of the radiance, (pixels, P)


@numba.njit(cache=True, nogil=True, fastmath=True)
def fit_pixels(
    pictures: PixelPictures,
    starts: Index,
    blocks: Numbers,
    variance: Double,
    iterations: int,
    light: Double,
) -> None:
    """Fit the light of the blocks of each pixel; write `light`, and `variance` for the next fit.

    Each iteration changes V by a power of the factor ``(max(t, 0)^2 + var(t)) / V`` of expectation
    maximisation, which converges slowly. V is at most the squared floodlit pixel, since no block
    sends more light than all do. Pixel i has the entries ``starts[i]:starts[i + 1]`` of blocks,
    variance and light, (n,) each.
    """
    for pixel in range(len(starts) - 1):
        c = pictures.radiance[pixel]
        active = np.arange(starts[pixel], starts[pixel + 1])
        variance[active] = np.minimum(variance[active], c[0] ** 2)
        for _ in range(iterations):
            active = active[variance[active] > VANISHING * c[0] ** 2]
            light[starts[pixel] : starts[pixel + 1]] = 0
            if not len(active):
                break
            A, V = _columns(pictures.means, blocks[active]), variance[active]
            N = pictures.noise[pixel] + _variance_within_blocks(A, V)
            by_block = len(active) < len(c)
            t, posterior = _block_form(A, c, N, V) if by_block else _picture_form(A, c, N, V)
            light[active] = t
            factor = (np.maximum(t, 0) ** 2 + np.maximum(posterior, 0)) / V
            variance[active] *= factor**_POWER


class BlockRanges(NamedTuple):
    """Blocks of each camera pixel, as ascending ranges of rays in the order of the block tree."""

    starts: Index  # first block of each pixel, and the number of all, (M + 1,)
    first: Index  # first ray of each block, (n,)
    end: Index  # last ray of each block, plus 1, (n,)


@numba.njit(cache=True, nogil=True)
def average_variances(
    blocks: BlockRanges, variance: Double, camera: tuple[int, int, int]
) -> Double:
    """Average variances (n,) over each camera pixel and its neighbours that have blocks.

    `camera` has the numbers of views, rows and columns.
    """
    average = np.zeros_like(variance)
    for pixel in range(len(blocks.starts) - 1):
        count = 0
        for neighbour in _neighbourhood(pixel, camera):
            if blocks.starts[neighbour] < blocks.starts[neighbour + 1]:
                count += 1
                _add_variances(blocks, variance, neighbour, pixel, average)
        average[blocks.starts[pixel] : blocks.starts[pixel + 1]] /= max(count, 1)
    return average


@numba.njit(cache=True, nogil=True)
def _neighbourhood(pixel: int, camera: tuple[int, int, int]) -> Index:
    """Number a camera pixel and its neighbours in the same view, at most 9 pixels."""
    _, height, width = camera
    row_of_stack, column = divmod(pixel, width)
    first = row_of_stack // height * height
    rows = np.arange(max(row_of_stack - 1, first), min(row_of_stack + 2, first + height))
    columns = np.arange(max(column - 1, 0), min(column + 2, width))
    return (rows[:, None] * width + columns).ravel()


@numba.njit(cache=True, nogil=True)
def _add_variances(
    blocks: BlockRanges, variance: Double, neighbour: int, pixel: int, total: Double
) -> None:
    """Add the variances of a neighbour's blocks to those of a pixel's, by the rays they share."""
    theirs, end_of_theirs = blocks.starts[neighbour], blocks.starts[neighbour + 1]
    own, end_of_own = blocks.starts[pixel], blocks.starts[pixel + 1]
    while own < end_of_own and theirs < end_of_theirs:
        first = max(blocks.first[own], blocks.first[theirs])
        end = min(blocks.end[own], blocks.end[theirs])
        if first < end:
            share = (end - first) / (blocks.end[theirs] - blocks.first[theirs])
            total[own] += share * variance[theirs]
        if blocks.end[own] <= blocks.end[theirs]:
            own += 1
        else:
            theirs += 1


@numba.njit(cache=True, nogil=True)
def _columns(means: Float, blocks: Numbers) -> Double:
    """Select the columns of some blocks, (P, K)."""
    A = np.empty((len(means), len(blocks)))
    for p in range(len(means)):
        for k in range(len(blocks)):
            A[p, k] = means[p, blocks[k]]
    return A


@numba.njit(cache=True, nogil=True, fastmath=True)
def _variance_within_blocks(A: Double, V: Double) -> Double:
    """Compute the variance of pictures whose patterns divide blocks, (P,).

    The light of a block comes from one of its rays: a pattern that lights a share a of the block
    shows all of it with the probability a, and the variance is ``a (1 - a) V``.
    """
    variance = np.zeros(len(A))
    for p in range(len(A)):
        for k in range(len(V)):
            variance[p] += A[p, k] * (1 - A[p, k]) * V[k]
    return variance


@numba.njit(cache=True, nogil=True, fastmath=True)
def _picture_form(A: Double, c: Double, N: Double, V: Double) -> tuple[Double, Double]:
    """Compute t and var(t) with a matrix over pictures."""
    columns = _whitened_by_noise(A, c, N, V)
    S = np.eye(len(c), dtype=np.float32)
    add_products(S, np.ascontiguousarray(columns[:, :-1]))
    whiten(S, columns)
    t, explained = _products(columns)
    return t * np.sqrt(V), V * (1 - explained)


@numba.njit(cache=True, nogil=True, fastmath=True)
def _block_form(A: Double, c: Double, N: Double, V: Double) -> tuple[Double, Double]:
    """Compute t and var(t) with a matrix over blocks."""
    rows = np.ascontiguousarray(_whitened_by_noise(A, c, N, V).T)  # B^T, and N^-1/2 c
    H = np.eye(len(V), dtype=np.float32)
    add_products(H, rows[:-1])
    columns = np.eye(len(V), len(rows), dtype=np.float32)
    columns[:, -1] = np.dot(rows[:-1], rows[-1])
    whiten(H, columns)
    t, remaining = _products(columns)
    return t * np.sqrt(V), V * remaining


@numba.njit(cache=True, nogil=True, fastmath=True)
def _whitened_by_noise(A: Double, c: Double, N: Double, V: Double) -> Float:
    """Compute the columns of B and N^-1/2 c, (P, K + 1)."""
    deviations = np.sqrt(V)
    whitened = np.empty((len(c), len(V) + 1), np.float32)
    for p in range(len(c)):
        certainty = 1 / np.sqrt(N[p])
        for k in range(len(V)):
            whitened[p, k] = certainty * A[p, k] * deviations[k]
        whitened[p, -1] = certainty * c[p]
    return whitened


@numba.njit(cache=True, nogil=True, fastmath=True)
def _products(columns: Float) -> tuple[Double, Double]:
    """Multiply all but the last column with the last, and with themselves, (K,) each."""
    blocks = columns.shape[1] - 1
    with_last, squares = np.zeros(blocks), np.zeros(blocks)
    for row in columns:
        for k in range(blocks):
            with_last[k] += row[k] * row[blocks]
            squares[k] += row[k] ** 2
    return with_last, squares
