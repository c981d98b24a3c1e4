"""Compiled kernels of symmetric photography's rank test (thesis §5.1, C.2).

Images are planar and in tree order, so that a piece (one block of one image) is one run.
A *piece* ``(k, b)`` is what block ``k`` of the camera received while block ``b`` was lit.
"""

from __future__ import annotations

import numba
import numpy as np

_FAST = {"reassoc", "contract", "nsz", "arcp"}


@numba.njit(cache=True, fastmath=_FAST)
def _sum(values):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(values.shape[0]):
        total += np.float64(values[k])
    return total


@numba.njit(cache=True, fastmath=_FAST)
def _positive_sum(values):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(values.shape[0]):
        total += np.float64(max(values[k], np.float32(0)))
    return total


@numba.njit(cache=True, fastmath=_FAST)
def _squared_difference(measured, factor, scale):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(measured.shape[0]):
        difference = measured[k] - factor[k] * scale
        total += np.float64(difference * difference)
    return total


@numba.njit(cache=True)
def _test_side(  # type: ignore[no-untyped-def]
    target0, target1, factor, factor_variance, first_child, last_child, child_starts, source0,
    weights, energy, pattern_of_block, c, residuals, variances,
):  # fmt: skip
    """Compare the images of one side's blocks with what the node's factors predict.

    Returns the sum of squared differences, what noise makes of it, and the sum of the squared
    shares that the children have of the energy.
    """
    ssd, noise, squares = 0.0, 0.0, 0.0
    for child in range(first_child, last_child):
        begin, end = child_starts[child] - source0, child_starts[child + 1] - source0
        scale = _sum(weights[begin:end]) / energy if energy > 0.0 else 0.0
        pattern = pattern_of_block[child]
        ssd += _squared_difference(
            residuals[pattern, c, target0:target1], factor, np.float32(scale)
        )
        noise += _sum(variances[pattern, c, target0:target1]) + scale * scale * factor_variance
        squares += scale * scale
    return ssd, noise, squares


@numba.njit(cache=True, parallel=True)
def rank_test(  # type: ignore[no-untyped-def]
    starts, children, child_starts, block_a, block_b, offset_a, offset_b, pieces, energy,
    piece_variance, pattern_of_block, residuals, variances, ssd, noise, shares,
):  # fmt: skip
    """Predict the images of each node's children from its factors, and compare.

    Parameters
    ----------
    starts, child_starts : int64
        First tree positions of the blocks of the nodes' level, and of the next.
    children : int64 (n_blocks + 1,)
        The next level's blocks in each block.
    block_a, block_b, offset_a, offset_b : (n,)
        The nodes and where their two pieces begin in `pieces`.
    pieces : float32 (C, n_values)
        Non-negative; both pieces of a node sum to its energy.
    energy : float64 (C, n)
    piece_variance : float64 (C, 2, n)
        Summed variance of the two pieces.
    pattern_of_block : int32
        Pattern that lit each block of the next level.
    residuals, variances : float32 (P, C, N)
    ssd, noise : float64 (C, n)
        Written: summed squared differences, and what noise alone would make of them.
    shares : float64 (C, 2, n)
        Written: over the children of b, and over those of a, the sum of the squared shares that
        they have of the node's energy; 1 where a single child has all of it.
    """
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        a0, a1, b0, b1 = starts[a], starts[a + 1], starts[b], starts[b + 1]
        for c in range(pieces.shape[0]):
            piece_a = pieces[c, offset_a[n] : offset_a[n] + a1 - a0]
            piece_b = pieces[c, offset_b[n] : offset_b[n] + b1 - b0]
            total, expected, shares[c, 0, n] = _test_side(
                a0, a1, piece_a, piece_variance[c, 0, n], children[b], children[b + 1],
                child_starts, b0, piece_b, energy[c, n], pattern_of_block, c, residuals, variances,
            )  # fmt: skip
            shares[c, 1, n] = shares[c, 0, n]
            if a != b:
                more, more_expected, shares[c, 1, n] = _test_side(
                    b0, b1, piece_b, piece_variance[c, 1, n], children[a], children[a + 1],
                    child_starts, a0, piece_a, energy[c, n], pattern_of_block, c, residuals,
                    variances,
                )  # fmt: skip
                total += more
                expected += more_expected
            ssd[c, n] = total
            noise[c, n] = expected


@numba.njit(cache=True, parallel=True)
def measure_pieces(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, pattern_of_block, residuals, variances, energy, variance
):
    """Sum the two pieces of each pair of blocks, and their variances.

    Parameters
    ----------
    starts : int64 (n_blocks + 1,)
    block_a, block_b : int32 (n,)
    pattern_of_block, residuals, variances
        As in `rank_test`, of the pairs' own level.
    energy, variance : float64 (C, 2, n)
        Written: sums over piece (a, b) and over piece (b, a).
    """
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        a0, a1, b0, b1 = starts[a], starts[a + 1], starts[b], starts[b + 1]
        pattern_a, pattern_b = pattern_of_block[a], pattern_of_block[b]
        for c in range(energy.shape[0]):
            energy[c, 0, n] = _sum(residuals[pattern_b, c, a0:a1])
            energy[c, 1, n] = _sum(residuals[pattern_a, c, b0:b1])
            variance[c, 0, n] = _sum(variances[pattern_b, c, a0:a1])
            variance[c, 1, n] = _sum(variances[pattern_a, c, b0:b1])


@numba.njit(cache=True)
def _take_piece(source, energy, target):  # type: ignore[no-untyped-def]
    """Copy a piece without its negative values, scaled to the node's energy; return its square."""
    positive = _positive_sum(source)
    scale = np.float32(energy / positive) if positive > 0.0 and energy > 0.0 else np.float32(0)
    square = 0.0
    for k in range(source.shape[0]):
        target[k] = max(source[k], np.float32(0)) * scale
        square += np.float64(target[k]) * np.float64(target[k])
    return square


@numba.njit(cache=True)
def _worst_share(piece, energy, first_child, last_child, child_starts, source0):  # type: ignore[no-untyped-def]
    """Largest sum of squares by which a split of one unit among the children can miss the shares.

    The piece predicts the share ``w_q`` of child ``q``; whatever the truth is, it splits one
    unit into non-negative parts, so the worst is all of it in the child of the smallest share.
    """
    smallest, squares = 1.0, 0.0
    for child in range(first_child, last_child):
        begin, end = child_starts[child] - source0, child_starts[child + 1] - source0
        share = _sum(piece[begin:end]) / energy if energy > 0.0 else 0.0
        smallest = min(smallest, share)
        squares += share * share
    return 1.0 - 2.0 * smallest + squares


@numba.njit(cache=True, parallel=True)
def gather_pieces(  # type: ignore[no-untyped-def]
    starts, children, child_starts, block_a, block_b, offset_a, offset_b, energy,
    pattern_of_block, residuals, pieces, worst, lit,
):  # fmt: skip
    """Copy the pieces of nodes out of the images, and bound what the rank test can still find.

    Parameters
    ----------
    starts, children, child_starts, block_a, block_b, offset_a, offset_b, pattern_of_block
        As in `rank_test`, `pattern_of_block` of the nodes' own level.
    energy : float64 (C, n)
        Energy that both pieces are scaled to; 0 gives empty pieces.
    residuals : float32 (P, C, N)
    pieces : float32 (C, n_values)
        Written.
    worst : float64 (C, n)
        Written: no non-negative transport with these pieces can give the next level's rank test
        a larger sum of squared differences.
    lit : float64 (C, n)
        Written: how many pixels that sum is over in effect, by the participation number
        ``(sum x)^2 / sum x^2`` of each piece; a glint in a dark block counts as one pixel.
    """
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        a0, a1, b0, b1 = starts[a], starts[a + 1], starts[b], starts[b + 1]
        for c in range(pieces.shape[0]):
            piece_a = pieces[c, offset_a[n] : offset_a[n] + a1 - a0]
            piece_b = pieces[c, offset_b[n] : offset_b[n] + b1 - b0]
            e = energy[c, n]
            square = _take_piece(residuals[pattern_of_block[b], c, a0:a1], e, piece_a)
            if a != b:
                other = _take_piece(residuals[pattern_of_block[a], c, b0:b1], e, piece_b)
            else:
                other = 0.0
            worst[c, n] = square * _worst_share(
                piece_b, e, children[b], children[b + 1], child_starts, b0
            ) + other * _worst_share(piece_a, e, children[a], children[a + 1], child_starts, a0)
            lit[c, n] = 0.0
            if square > 0.0:
                lit[c, n] += e * e / square * (children[b + 1] - children[b])
            if other > 0.0:
                lit[c, n] += e * e / other * (children[a + 1] - children[a])
