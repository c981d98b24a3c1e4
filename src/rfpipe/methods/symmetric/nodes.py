"""The unknown nodes of a level of symmetric photography (thesis §4.2, §5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.hierarchical.leaves import LeafSet, factor_offsets, ragged_ranges

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Blocks = NDArray[np.int32]
Index = NDArray[np.int64]

# Subdividing a node takes a kilobyte, its children some dozens of bytes.
_NODES_AT_A_TIME = 2**15


class Grid(NamedTuple):
    """The blocks of a level, for kernels.

    Attributes
    ----------
    starts : ndarray of int64, shape (n_blocks + 1,)
        First tree positions of the level's blocks.
    children : ndarray of int64, shape (n_blocks + 1,)
        Each block's first child, a block of the next level.
    below : ndarray of int64
        First tree positions of the next level's blocks.
    """

    starts: Index
    children: Index
    below: Index

    @classmethod
    def of(cls, tree: BlockTree, level: int) -> Grid:
        """Return the blocks of a level that is not the last."""
        return cls(tree.starts[level], tree.child_starts[level], tree.starts[level + 1])


class Pairs(NamedTuple):
    """Pairs of blocks (a, b) of a level, and where their two pieces begin, (n,) each.

    Piece (a, b), then piece (b, a) unless it is the same, pair after pair.
    """

    a: Blocks
    b: Blocks
    at_a: Index
    at_b: Index

    @classmethod
    def of(cls, starts: Index, a: Blocks, b: Blocks) -> tuple[Pairs, int]:
        """Return pairs, and how many values their pieces have."""
        at_a, at_b, n_values = factor_offsets(starts, a, b)
        return cls(a, b, at_a, at_b), n_values


class Nodes(NamedTuple):
    """Unknown nodes with their factors, for kernels; see `Frontier`."""

    pairs: Pairs
    factors: Float
    energy: Double
    variance: Double


@dataclass(frozen=True)
class Frontier:
    """The unknown nodes of a level, with the rank-1 estimate that the next level tests.

    Attributes
    ----------
    block_a, block_b : ndarray of int32, shape (n,)
    pieces : ndarray of float32, shape (C, n_values)
        Piece (a, b), then piece (b, a) unless it is the same, node after node; non-negative.
    energy : ndarray of float64, shape (C, n)
        Sum of either piece, ``m`` of Fig. 5.1.
    variance : ndarray of float64, shape (C, 2, n)
        Summed variance of the two pieces.
    """

    block_a: Blocks
    block_b: Blocks
    pieces: Float
    energy: Double
    variance: Double

    def __len__(self) -> int:
        return len(self.block_a)

    def nodes(self, tree: BlockTree, level: int) -> Nodes:
        """Return the nodes, of `level`, for kernels."""
        pairs, _ = Pairs.of(tree.starts[level], self.block_a, self.block_b)
        return Nodes(pairs, self.pieces, self.energy, self.variance)


def no_nodes(channels: int) -> Frontier:
    """Return an empty frontier."""
    none = np.zeros(0, np.int32)
    return Frontier(
        none, none, np.zeros((channels, 0), np.float32), np.zeros((channels, 0)),
        np.zeros((channels, 2, 0)),
    )  # fmt: skip


def child_counts(tree: BlockTree, level: int, nodes: Frontier) -> Index:
    """Count the children of each node of `level`; see `child_pairs`."""
    if level >= tree.n_levels - 1:
        return np.zeros(len(nodes), np.int64)
    children = np.diff(tree.child_starts[level])
    a, b = children[nodes.block_a], children[nodes.block_b]
    return np.where(nodes.block_a == nodes.block_b, a * (a + 1) // 2, a * b)


def child_pairs(tree: BlockTree, level: int, nodes: Frontier) -> tuple[Index, Blocks, Blocks]:
    """Subdivide nodes of `level`: return each child's node, and its blocks of the next level.

    A node off the diagonal gives every pair of a child of a and a child of b; one on the diagonal
    gives each unordered pair once.
    """
    node = np.repeat(np.arange(len(nodes)), child_counts(tree, level, nodes))
    return node, *child_blocks(tree, level, nodes)


def child_blocks(tree: BlockTree, level: int, nodes: Frontier) -> tuple[Blocks, Blocks]:
    """Return the blocks of the nodes' children, as `child_pairs` does."""
    if level >= tree.n_levels - 1 or not len(nodes):
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    starts = range(0, len(nodes), _NODES_AT_A_TIME)
    found = [
        _child_blocks(tree.child_starts[level], nodes.block_a[run], nodes.block_b[run])
        for run in (slice(start, start + _NODES_AT_A_TIME) for start in starts)
    ]
    first, second = (np.concatenate(part) for part in zip(*found, strict=True))
    return first, second


def _child_blocks(children: Index, block_a: Blocks, block_b: Blocks) -> tuple[Blocks, Blocks]:
    a, b = block_a.astype(np.int64), block_b.astype(np.int64)
    count_b = children[b + 1] - children[b]
    total = (children[a + 1] - children[a]) * count_b
    node = np.repeat(np.arange(len(a)), total)
    within = ragged_ranges(np.zeros_like(total), total)
    first = children[a][node] + within // count_b[node]
    second = children[b][node] + within % count_b[node]
    once = first <= second
    return first[once].astype(np.int32), second[once].astype(np.int32)


def compared_pixels(tree: BlockTree, level: int, nodes: Frontier) -> Double:
    """Count the pixels that each node's rank test compares."""
    sizes = np.diff(tree.starts[level])
    children = np.diff(tree.child_starts[level])
    a, b = nodes.block_a, nodes.block_b
    one_side = sizes[a] * children[b]
    return np.where(a == b, one_side, one_side + sizes[b] * children[a]).astype(np.float64)


def select(
    tree: BlockTree, level: int, nodes: Frontier, chosen: NDArray[np.bool_] | slice
) -> Frontier:
    """Return some of the nodes, in contiguous arrays: kernels are compiled for those alone."""
    block_a = nodes.block_a[chosen]
    if len(block_a) == len(nodes):
        return nodes
    starts = tree.starts[level]
    offset_a, _, n_values = factor_offsets(starts, nodes.block_a, nodes.block_b)
    lengths = np.diff(np.append(offset_a, n_values))
    index = ragged_ranges(offset_a[chosen], lengths[chosen])
    return Frontier(
        block_a,
        nodes.block_b[chosen],
        np.ascontiguousarray(nodes.pieces[:, index]),
        np.ascontiguousarray(nodes.energy[:, chosen]),
        np.ascontiguousarray(nodes.variance[..., chosen]),
    )


def as_leaves(tree: BlockTree, level: int, nodes: Frontier) -> LeafSet:
    """Turn nodes into rank-1 leaves: ``T_ab = piece(a, b) x piece(b, a) / m`` (Fig. 5.1)."""
    offset_a, _, n_values = factor_offsets(tree.starts[level], nodes.block_a, nodes.block_b)
    lengths = np.diff(np.append(offset_a, n_values))
    root = np.sqrt(nodes.energy, where=nodes.energy > 0, out=np.ones_like(nodes.energy))
    scale = np.repeat((1.0 / root).astype(np.float32), lengths, axis=1)
    return LeafSet(level, nodes.block_a, nodes.block_b, nodes.pieces * scale)
