"""Rank-k leaves that the images of a node's children give for free.

With ``Y = T_ab Omega``, the images in a under the children of b, ``Z = T_ab^T Psi``, those in b
under the children of a, and ``W = Psi^T T_ab Omega``, their blocks' sums,

    T_ab ~ Y W^+ Z^T

is the generalised Nystroem approximation [Nakatsukasa 2020, arXiv:2009.11392]. It gives back
the images it is made of, whatever the transport; what it is worth else is asked of the images
themselves, see `predictable`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.symmetric.nodes import as_leaves, compared_pixels, select
from rfpipe.methods.symmetric.pieces import Subdivided
from rfpipe.methods.symmetric.rank_test import Limits
from rfpipe.transport.hierarchical.leaves import LeafSet, factor_offsets, ragged_ranges

__all__ = ["predictable", "rank_k_leaves"]

Flags = NDArray[np.bool_]

AMPLIFIED = 32.0
"""How many times the leading term's a term's norm, over its part of the block sums, may be. From 8
to 128 errors are the same within some per cent (`benchmarks/bench_rank_k.py --sweep`)."""


def predictable(divided: Subdivided, asked: Flags, limits: Limits) -> Flags:
    """Tell which nodes' images under each child follow from those under the other children.

    Each of the 4 + 4 images is held out in turn and predicted by the approximation of the others,
    of rank 3 at most. All four together make a leaf that is better than what passes: the corner of
    a square is extrapolated from the three others.

    Parameters
    ----------
    divided : Subdivided
        With the children's pieces as they were measured.
    asked : ndarray of bool, shape (n,)
        Which nodes to test. None on the diagonal passes, where direct light is, and none with a
        single child on a side.
    limits : Limits
        Of the images' differences, as in the rank test.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    from rfpipe.methods.symmetric import rank_k_kernels as kernels

    tree, level, nodes, pieces = divided.tree, divided.level, divided.nodes, divided.pieces
    children = np.diff(tree.child_starts[level])
    several = np.minimum(children[nodes.block_a], children[nodes.block_b]) > 1
    tested = asked & several & (nodes.block_a != nodes.block_b)
    passed = np.zeros(len(nodes), np.bool_)
    chosen = np.flatnonzero(tested)
    ssd = np.empty((len(pieces.values), len(chosen)))
    noise = np.empty_like(ssd)
    kernels.leave_one_out(
        tree.child_starts[level], tree.starts[level + 1], nodes.block_a[chosen],
        nodes.block_b[chosen], divided.first_pair[chosen], pieces.offset_a, pieces.offset_b,
        pieces.values, pieces.sums, pieces.spread, AMPLIFIED, ssd, noise,
    )  # fmt: skip
    samples = compared_pixels(tree, level, nodes)[chosen]
    allowed = limits.allowed(noise / samples, samples)
    passed[chosen] = (ssd / samples <= allowed).all(axis=0)
    return passed


def rank_k_leaves(divided: Subdivided, chosen: Flags) -> LeafSet:
    """Return the leaves of some nodes, as many terms each as their block sums are evidence of.

    Where none is, in a colour channel that had light a level above, the node's rank-1 leaf is kept.

    Parameters
    ----------
    divided : Subdivided
        The children's pieces may have been reconciled with the nodes'.
    chosen : ndarray of bool, shape (n,)
        Nodes that passed.
    """
    from rfpipe.methods.symmetric import kernels as of_pieces
    from rfpipe.methods.symmetric import rank_k_kernels as kernels

    tree, level, nodes, pieces = divided.tree, divided.level, divided.nodes, divided.pieces
    starts, children = tree.starts[level], tree.child_starts[level]
    block_a, block_b = nodes.block_a[chosen], nodes.block_b[chosen]
    first = divided.first_pair[:-1][chosen]
    channels, count = len(pieces.values), len(block_a)
    most = int(np.diff(children)[np.concatenate([block_a, block_b])].max(initial=0))
    left, right = np.zeros((2, channels, count, most, most))
    rank = np.empty((channels, count), np.int64)
    sums = np.empty_like(pieces.sums)
    of_pieces.sum_pieces(
        tree.starts[level + 1], pieces.block_a, pieces.block_b, pieces.offset_a, pieces.offset_b,
        pieces.values, sums,
    )  # fmt: skip
    kernels.invert_cores(
        children, tree.starts[level + 1], block_a, block_b, first, pieces.offset_a, pieces.offset_b,
        pieces.values, sums, pieces.sums, pieces.spread, AMPLIFIED, left, right, rank,
    )  # fmt: skip
    without = (rank == 0) & (nodes.energy[:, chosen] > 0)
    terms = np.maximum(rank.max(axis=0), without.any(axis=0))
    term_a, term_b = np.repeat(block_a, terms), np.repeat(block_b, terms)
    begin, _, n_values = factor_offsets(starts, term_a, term_b)
    factors = np.zeros((channels, n_values), np.float32)
    first_term = np.append(0, np.cumsum(terms))
    kernels.combine_pieces(
        children, tree.starts[level + 1], block_a, block_b, first, pieces.offset_a,
        pieces.offset_b, pieces.values, left, right, first_term, begin, factors,
    )  # fmt: skip
    if without.any():
        rank_1 = as_leaves(tree, level, select(tree, level, nodes, chosen)).values
        own, _, n_values = factor_offsets(starts, block_a, block_b)
        sizes = np.diff(np.append(own, n_values))
        for c, some in enumerate(without):
            target = ragged_ranges(begin[first_term[:-1][some]], sizes[some])
            factors[c, target] = rank_1[c, ragged_ranges(own[some], sizes[some])]
    return LeafSet(level, term_a, term_b, factors)
