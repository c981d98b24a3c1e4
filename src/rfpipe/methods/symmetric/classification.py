"""Measured pairs of blocks as empty nodes, leaves and unknown nodes (thesis §5.1, C.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rfpipe.array_types import Bools, Double, Index
from rfpipe.blocks import BlockTree
from rfpipe.methods.symmetric.nodes import (
    EstimatedNodes,
    LevelBlocks,
    NodeArrays,
    Pairs,
    as_leaves,
    no_nodes,
    select,
)
from rfpipe.methods.symmetric.pieces import MeasuredPieces, Pieces, Profiles
from rfpipe.methods.symmetric.rank_test import Thresholds
from rfpipe.transport.hierarchical.leaves import LeafSet


@dataclass(frozen=True)
class NodeCandidates:
    """Pairs of a level that become empty nodes, leaves or unknown nodes.

    Attributes
    ----------
    pair : ndarray of int64, shape (n,)
        Numbers of the pairs in `Pieces`.
    is_final : ndarray of bool, shape (n,)
        Pairs that become leaves in any case, unless they are empty.
    parents : EstimatedNodes
        Nodes of the level above; empty at level 0.
    parent : ndarray of int64, shape (n,)
        Number of each pair's node in `parents`.
    """

    pair: Index
    is_final: Bools
    parents: EstimatedNodes
    parent: Index

    def __len__(self) -> int:
        return len(self.pair)

    def select(self, chosen: Bools) -> NodeCandidates:
        """Return some of the candidates."""
        return replace(
            self, pair=self.pair[chosen], is_final=self.is_final[chosen], parent=self.parent[chosen]
        )


@dataclass(frozen=True)
class Classification:
    """Leaves and unknown nodes of a level, and numbers of its pairs by kind.

    Attributes
    ----------
    leaves : LeafSet
    unknown : EstimatedNodes
        Nodes that the next level subdivides.
    counts : dict
        Numbers of empty nodes and of leaves, as in the table of levels.
    """

    leaves: LeafSet
    unknown: EstimatedNodes
    counts: dict[str, int]


def classify(
    tree: BlockTree, level: int, pieces: Pieces, candidates: NodeCandidates, limits: Thresholds
) -> Classification:
    """Divide measured pairs of a level into empty nodes, leaves and unknown nodes.

    Pairs without significant light are empty. Pairs with too little light to be worth patterns are
    leaves, since the light of many of them adds up; at the last level all pairs are scalar leaves.
    """
    from rfpipe.methods.symmetric import classification_kernels

    energy, is_significant = classification_kernels.pair_energies(
        pieces, candidates.pair, limits.significance**2, limits.squared_level_significance
    )
    is_final = candidates.is_final | ~is_significant.any(axis=0)
    lit: Bools = np.any(energy, axis=0)
    empty = len(lit) - int(np.count_nonzero(lit))
    candidates = replace(candidates, is_final=is_final).select(lit)
    energy = np.ascontiguousarray(energy[:, lit])
    if level == tree.n_levels - 1:
        a, b = pieces.block_a[candidates.pair], pieces.block_b[candidates.pair]
        leaves = LeafSet(level, a, b, energy.astype(np.float32))
        counts = {"empty": empty, "scalar": len(leaves)}
        return Classification(leaves, no_nodes(len(energy)), counts)
    nodes, is_leaf = _estimate(tree, level, pieces, candidates, energy, limits)
    leaves = as_leaves(tree, level, select(tree, level, nodes, is_leaf))
    unknown = select(tree, level, nodes, ~is_leaf)
    return Classification(leaves, unknown, {"empty": empty, "rank1": len(leaves)})


def _estimate(
    tree: BlockTree,
    level: int,
    pieces: Pieces,
    candidates: NodeCandidates,
    energy: Double,
    limits: Thresholds,
) -> tuple[EstimatedNodes, Bools]:
    """Return pairs as nodes with rank-1 estimates, and which of them are leaves, bool (n,).

    A node is a leaf without further patterns where its rank test can't fail (the bound of
    `classification_kernels.estimate_pieces`), or where a block is a single ray, so that its rank
    is 1.
    """
    from rfpipe.methods.symmetric import classification_kernels, piece_kernels

    starts, pair = tree.starts[level], candidates.pair
    pairs, n_values = Pairs.of(starts, pieces.block_a[pair], pieces.block_b[pair])
    a, b = pairs.block_a, pairs.block_b
    offsets = np.stack([pieces.offset_a[pair], pieces.offset_b[pair]])
    variance = piece_kernels.piece_sums(starts, Pairs(a, b, *offsets), pieces.variances)
    nodes = NodeArrays(*pairs, np.empty((len(energy), n_values), np.float32), energy, variance)
    bound, pixels = classification_kernels.estimate_pieces(
        LevelBlocks.of(tree, level),
        nodes,
        MeasuredPieces(pieces.values, pieces.variances, offsets),
        _profiles(tree, level, pairs, candidates),
        limits.significance,
    )
    sizes = np.diff(starts)
    noise = np.where(a == b, variance[:, 0], variance.sum(axis=1))
    noise = noise / np.where(a == b, sizes[a], sizes[a] + sizes[b])
    pixels = np.maximum(pixels, 1.0)
    is_leaf = (bound / pixels <= limits.allowed(noise, pixels)).all(axis=0)
    is_leaf |= (sizes[a] == 1) | (sizes[b] == 1) | candidates.is_final
    return EstimatedNodes(a, b, nodes.pieces, energy, variance), is_leaf


def _profiles(tree: BlockTree, level: int, pairs: Pairs, candidates: NodeCandidates) -> Profiles:
    """Locate the images of the pairs' blocks in the pieces of the nodes above."""
    parents, parent = candidates.parents, candidates.parent
    if not len(parents):
        return Profiles(parents.pieces, np.full((2, len(pairs.block_a)), -1, np.int64))
    starts, finer = tree.starts[level - 1], tree.starts[level]
    layout = parents.nodes(tree, level - 1)
    offsets = [
        layout.offset_a[parent] + finer[pairs.block_a] - starts[layout.block_a[parent]],
        layout.offset_b[parent] + finer[pairs.block_b] - starts[layout.block_b[parent]],
    ]
    return Profiles(parents.pieces, np.stack(offsets))
