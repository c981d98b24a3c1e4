"""Compiled kernels of the rank test (thesis §5.1, C.2 ProcessResults).

Formulas use the symbols of `rfpipe.methods.symmetric`. Arguments are the named tuples of `nodes`
and `pieces`, with planar images and pieces in tree order: a piece is one run of values.
"""

import numba
import numpy as np

from rfpipe.transport.hierarchical.kernels import summed

_FAST = {"reassoc", "contract", "nsz", "arcp"}


@numba.njit(cache=True, fastmath=_FAST)
def squared_difference(measured, piece, scale):  # type: ignore[no-untyped-def]
    """Return ``|measured - scale piece|^2``."""
    total = 0.0
    for k in range(measured.shape[0]):
        difference = measured[k] - piece[k] * scale
        total += np.float64(difference * difference)
    return total


@numba.njit(cache=True)
def _masked_difference(masked, start, measured, piece, scale):  # type: ignore[no-untyped-def]
    """Return `squared_difference` of the masked pixels of a piece that begins at `start`."""
    total = 0.0
    end = start + measured.shape[0]
    for k in range(np.searchsorted(masked, start), np.searchsorted(masked, end)):
        pixel = masked[k] - start
        difference = measured[pixel] - piece[pixel] * scale
        total += np.float64(difference * difference)
    return total


@numba.njit(cache=True)
def energy_shares(piece, energy, block, blocks):  # type: ignore[no-untyped-def]
    """Return the energy shares ``w_i = sum(x[i]) / m`` of a block's children, and ``sum w_i^2``."""
    first, last = blocks.first_child[block], blocks.first_child[block + 1]
    shares, squares = np.empty(last - first), 0.0
    for child in range(first, last):
        begin = blocks.child_starts[child] - blocks.child_starts[first]
        end = blocks.child_starts[child + 1] - blocks.child_starts[first]
        share = summed(piece[begin:end]) / energy if energy > 0.0 else 0.0
        shares[child - first] = share
        squares += share * share
    return shares, squares


@numba.njit(cache=True, parallel=True)
def compare_children(blocks, nodes, first_pair, pieces):  # type: ignore[no-untyped-def]
    """Compare the pieces of each node's children with their prediction by the node's pieces.

    For node (a, b) with children (i, j)::

        x_ij ~ w_j x_ab[i],    w_j = sum(x_ba[j]) / m
        x_ji ~ w_i x_ba[j],    w_i = sum(x_ab[i]) / m
        ssd   = sum_ij |x_ij - w_j x_ab[i]|^2 + |x_ji - w_i x_ba[j]|^2
        noise = sum_ij var(x_ij) + var(x_ji) + sum_j w_j^2 var(x_ab) + sum_i w_i^2 var(x_ba)

    The arguments are the parts of `Subdivision`.

    Returns
    -------
    ssd, noise : float64 (C, n)
        Sum of squared differences, and its expectation if noise is the only difference.
    squares : float64 (C, 2, n)
        ``sum_j w_j^2`` and ``sum_i w_i^2``: 1 where one child has all the energy.
    """
    ssd = np.empty(nodes.energy.shape)
    noise = np.empty(nodes.energy.shape)
    squares = np.empty(nodes.variance.shape)
    for n in numba.prange(len(nodes.block_a)):
        for c in range(len(nodes.pieces)):
            ssd[c, n], noise[c, n], squares[c, 0, n], squares[c, 1, n] = _test_node(
                blocks, nodes, first_pair, pieces, c, n
            )
    return ssd, noise, squares


@numba.njit(cache=True)
def _test_node(blocks, nodes, first_pair, pieces, c, n):  # type: ignore[no-untyped-def]
    """Return ssd, noise and the two sums of squared shares of one node; see `compare_children`."""
    a, b = nodes.block_a[n], nodes.block_b[n]
    child_a, child_b = blocks.first_child[a], blocks.first_child[b]
    start_a, start_b = blocks.starts[a], blocks.starts[b]
    offset_a, offset_b = nodes.offset_a[n], nodes.offset_b[n]
    piece_a = nodes.pieces[c, offset_a : offset_a + blocks.starts[a + 1] - start_a]
    piece_b = nodes.pieces[c, offset_b : offset_b + blocks.starts[b + 1] - start_b]
    shares_a, squares_a = energy_shares(piece_a, nodes.energy[c, n], a, blocks)
    shares_b, squares_b = energy_shares(piece_b, nodes.energy[c, n], b, blocks)
    ssd, noise = 0.0, squares_b * nodes.variance[c, 0, n]
    if a != b:
        noise += squares_a * nodes.variance[c, 1, n]
    for pair in range(first_pair[n], first_pair[n + 1]):
        i, j = pieces.block_a[pair], pieces.block_b[pair]
        ssd = _add_difference(
            ssd, blocks, pieces, c, i, pieces.offset_a[pair], piece_a, start_a,
            np.float32(shares_b[j - child_b]),
        )  # fmt: skip
        noise += pieces.noise_variance[c, 0, pair]
        if i == j:
            continue
        ssd = _add_difference(
            ssd, blocks, pieces, c, j, pieces.offset_b[pair], piece_b, start_b,
            np.float32(shares_a[i - child_a]),
        )  # fmt: skip
        noise += pieces.noise_variance[c, 1, pair]
    return ssd, noise, squares_b, squares_a


@numba.njit(cache=True)
def _add_difference(ssd, blocks, pieces, c, child, offset, piece, start, share):  # type: ignore[no-untyped-def]
    """Add the squared difference of a child's measured piece from its prediction.

    The measured piece, at `offset` of the values, is compared with ``share piece`` over the child,
    by its known pixels. `piece` is the node's, and begins at tree position `start`.
    """
    child_start, child_end = blocks.child_starts[child], blocks.child_starts[child + 1]
    measured = pieces.values[c, offset : offset + child_end - child_start]
    predictor = piece[child_start - start : child_end - start]
    ssd += squared_difference(measured, predictor, share)
    ssd -= _masked_difference(pieces.masked, child_start, measured, predictor, share)
    return ssd
