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

Flags = NDArray[np.bool_]

AMPLIFIED = 32.0
"""How many times the leading term's a term's norm, over its part of the block sums, may be. From 8
to 128 errors are the same within some per cent (`benchmarks/bench_rank_k.py --sweep`)."""


def predictable(divided: Subdivided, asked: Flags, limits: Limits) -> Flags:
    """Tell which nodes' images under each child follow from those under the other children, (n,).

    Each of the 4 + 4 images is held out in turn and predicted by the approximation of the others,
    of rank 3 at most. All four together make a leaf that is better than what passes: the corner of
    a square is extrapolated from the three others. None on the diagonal passes, where direct light
    is, and none with a single child on a side. The children's pieces are those measured.
    """
    from rfpipe.methods.symmetric import rank_k_kernels as kernels

    tree, level, nodes = divided.tree, divided.level, divided.nodes
    children = np.diff(tree.child_starts[level])
    several = np.minimum(children[nodes.block_a], children[nodes.block_b]) > 1
    passed = np.zeros(len(nodes), np.bool_)
    chosen = np.flatnonzero(asked & several & (nodes.block_a != nodes.block_b))
    ssd = np.empty((len(nodes.energy), len(chosen)))
    noise = np.empty_like(ssd)
    kernels.leave_one_out(divided.arrays, chosen, AMPLIFIED, ssd, noise)
    samples = compared_pixels(tree, level, nodes)[chosen]
    allowed = limits.allowed(noise / samples, samples)
    passed[chosen] = (ssd / samples <= allowed).all(axis=0)
    return passed


def rank_k_leaves(divided: Subdivided, chosen: Flags) -> LeafSet:
    """Return the leaves of chosen nodes, as many terms each as their block sums are evidence of.

    Where none is, in a colour channel that had light a level above, the node's rank-1 leaf is kept.
    The children's pieces may have been reconciled with the nodes'.
    """
    from rfpipe.methods.symmetric import rank_k_kernels as kernels
    from rfpipe.methods.symmetric.kernels import sum_pieces

    tree, level, nodes, pieces = divided.tree, divided.level, divided.nodes, divided.pieces
    arrays, own = divided.arrays, np.flatnonzero(chosen)
    block_a, block_b = nodes.block_a[own], nodes.block_b[own]
    channels, count = len(pieces.values), len(own)
    children = np.diff(arrays.grid.children)
    most = int(children[np.concatenate([block_a, block_b])].max(initial=0))
    left, right = np.zeros((2, channels, count, most, most))
    rank = np.empty((channels, count), np.int64)
    sums = np.empty_like(pieces.sums)
    sum_pieces(arrays.grid.below, pieces.pairs, pieces.values, sums)
    kernels.invert_cores(arrays, own, AMPLIFIED, sums, left, right, rank)
    without = (rank == 0) & (nodes.energy[:, own] > 0)
    terms = np.maximum(rank.max(axis=0), without.any(axis=0))
    term_a, term_b = np.repeat(block_a, terms), np.repeat(block_b, terms)
    begin, _, n_values = factor_offsets(arrays.grid.starts, term_a, term_b)
    factors = np.zeros((channels, n_values), np.float32)
    first_term = np.append(0, np.cumsum(terms))
    kernels.combine_pieces(arrays, own, left, right, first_term, begin, factors)
    if without.any():
        rank_1 = as_leaves(tree, level, select(tree, level, nodes, chosen)).values
        at, _, n_values = factor_offsets(arrays.grid.starts, block_a, block_b)
        sizes = np.diff(np.append(at, n_values))
        for c, some in enumerate(without):
            target = ragged_ranges(begin[first_term[:-1][some]], sizes[some])
            factors[c, target] = rank_1[c, ragged_ranges(at[some], sizes[some])]
    return LeafSet(level, term_a, term_b, factors)
