"""Nodes of the sedectree: pairs of blocks of one level, and their children (thesis §4.2, §5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rfpipe.array_types import Blocks, Bools, Double, Float, Index
from rfpipe.blocks import BlockTree
from rfpipe.transport.hierarchical.leaves import LeafSet, factor_offsets, ragged_ranges

# Nodes that are subdivided at a time: a node takes a kilobyte, its children some dozens of bytes.
_NODES_PER_BATCH = 2**15


class LevelBlocks(NamedTuple):
    """Blocks of a level and their children, for kernels.

    Attributes
    ----------
    starts : ndarray of int64, shape (n_blocks + 1,)
        First tree position of each block.
    first_child : ndarray of int64, shape (n_blocks + 1,)
        First child of each block, a block of the next level.
    child_starts : ndarray of int64, shape (n_children + 1,)
        First tree position of each child.
    """

    starts: Index
    first_child: Index
    child_starts: Index

    @classmethod
    def of(cls, tree: BlockTree, level: int) -> LevelBlocks:
        """Return the blocks of a level other than the last."""
        return cls(tree.starts[level], tree.child_starts[level], tree.starts[level + 1])


class Pairs(NamedTuple):
    """Pairs of blocks (a, b) of a level, and the layout of their pieces in a flat array.

    The pieces (a, b) and (b, a) of a pair follow each other. On the diagonal there is one piece,
    and both offsets are equal.

    Attributes
    ----------
    block_a, block_b : ndarray of int32, shape (n,)
    offset_a, offset_b : ndarray of int64, shape (n,)
        First value of piece (a, b) and of piece (b, a).
    """

    block_a: Blocks
    block_b: Blocks
    offset_a: Index
    offset_b: Index

    @classmethod
    def of(cls, starts: Index, block_a: Blocks, block_b: Blocks) -> tuple[Pairs, int]:
        """Lay out the pieces of pairs; also return the total number of values."""
        offset_a, offset_b, n_values = factor_offsets(starts, block_a, block_b)
        return cls(block_a, block_b, offset_a, offset_b), n_values


class NodeArrays(NamedTuple):
    """`EstimatedNodes` with the layout of their pieces, for kernels.

    Blocks and offsets are as in `Pairs`, all other arrays as in `EstimatedNodes`.
    """

    block_a: Blocks
    block_b: Blocks
    offset_a: Index
    offset_b: Index
    pieces: Float
    energy: Double
    variance: Double


@dataclass(frozen=True)
class EstimatedNodes:
    """Nodes of a level with their rank-1 estimates ``x_ab x_ba^T / m``.

    Unknown nodes are tested on the next level's images; all others are converted by `as_leaves`.

    Attributes
    ----------
    block_a, block_b : ndarray of int32, shape (n,)
    pieces : ndarray of float32, shape (C, n_values)
        Pieces ``x_ab`` and ``x_ba`` in the layout of `Pairs`; radiance, not negative.
    energy : ndarray of float64, shape (C, n)
        Sum ``m`` of either piece.
    variance : ndarray of float64, shape (C, 2, n)
        Summed variance of the pixels of the two pieces.
    """

    block_a: Blocks
    block_b: Blocks
    pieces: Float
    energy: Double
    variance: Double

    def __len__(self) -> int:
        return len(self.block_a)

    def nodes(self, tree: BlockTree, level: int) -> NodeArrays:
        """Return the nodes, which are of `level`, for kernels."""
        pairs, _ = Pairs.of(tree.starts[level], self.block_a, self.block_b)
        return NodeArrays(*pairs, self.pieces, self.energy, self.variance)


def no_nodes(channels: int) -> EstimatedNodes:
    """Return no nodes, of a number of channels."""
    none = np.zeros(0, np.int32)
    pieces = np.zeros((channels, 0), np.float32)
    return EstimatedNodes(none, none, pieces, np.zeros((channels, 0)), np.zeros((channels, 2, 0)))


def counts_of_children(tree: BlockTree, level: int, nodes: EstimatedNodes) -> Index:
    """Count the children of each node of `level`, see `child_pairs`."""
    if level >= tree.n_levels - 1:
        return np.zeros(len(nodes), np.int64)
    children = np.diff(tree.child_starts[level])
    a, b = children[nodes.block_a], children[nodes.block_b]
    return np.where(nodes.block_a == nodes.block_b, a * (a + 1) // 2, a * b)


def child_pairs(tree: BlockTree, level: int, nodes: EstimatedNodes) -> tuple[Index, Blocks, Blocks]:
    """Subdivide nodes of `level` into pairs of children of their blocks.

    A node off the diagonal gives every pair of a child of a and a child of b, 16 of quadtree
    blocks. By symmetry a node on the diagonal gives each unordered pair once.

    Returns
    -------
    parent : ndarray of int64, shape (n,)
        The node of each pair.
    block_a, block_b : ndarray of int32, shape (n,)
        The blocks of each pair, of the next level.
    """
    parent = np.repeat(np.arange(len(nodes)), counts_of_children(tree, level, nodes))
    return parent, *child_blocks(tree, level, nodes)


def child_blocks(tree: BlockTree, level: int, nodes: EstimatedNodes) -> tuple[Blocks, Blocks]:
    """Return the blocks of the nodes' children, see `child_pairs`."""
    if level >= tree.n_levels - 1 or not len(nodes):
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    first_child = tree.child_starts[level]
    batches = [slice(n, n + _NODES_PER_BATCH) for n in range(0, len(nodes), _NODES_PER_BATCH)]
    blocks = [
        _child_blocks(first_child, nodes.block_a[batch], nodes.block_b[batch]) for batch in batches
    ]
    block_a, block_b = (np.concatenate(side) for side in zip(*blocks, strict=True))
    return block_a, block_b


def _child_blocks(first_child: Index, block_a: Blocks, block_b: Blocks) -> tuple[Blocks, Blocks]:
    a, b = block_a.astype(np.int64), block_b.astype(np.int64)
    count_b = first_child[b + 1] - first_child[b]
    count = (first_child[a + 1] - first_child[a]) * count_b
    parent = np.repeat(np.arange(len(a)), count)
    number = ragged_ranges(np.zeros_like(count), count)
    child_a = first_child[a][parent] + number // count_b[parent]
    child_b = first_child[b][parent] + number % count_b[parent]
    ordered = child_a <= child_b
    return child_a[ordered].astype(np.int32), child_b[ordered].astype(np.int32)


def compared_pixels(tree: BlockTree, level: int, nodes: EstimatedNodes) -> Double:
    """Count the pixels that each node's rank test compares, float64 (n,)."""
    sizes = np.diff(tree.starts[level])
    children = np.diff(tree.child_starts[level])
    a, b = nodes.block_a, nodes.block_b
    in_a = sizes[a] * children[b]
    return np.where(a == b, in_a, in_a + sizes[b] * children[a]).astype(np.float64)


def select(
    tree: BlockTree, level: int, nodes: EstimatedNodes, chosen: Bools | slice
) -> EstimatedNodes:
    """Return some of the nodes, in contiguous arrays: kernels are compiled for those alone."""
    block_a = nodes.block_a[chosen]
    if len(block_a) == len(nodes):
        return nodes
    starts = tree.starts[level]
    offset_a, _, n_values = factor_offsets(starts, nodes.block_a, nodes.block_b)
    lengths = np.diff(np.append(offset_a, n_values))
    index = ragged_ranges(offset_a[chosen], lengths[chosen])
    return EstimatedNodes(
        block_a,
        nodes.block_b[chosen],
        np.ascontiguousarray(nodes.pieces[:, index]),
        np.ascontiguousarray(nodes.energy[:, chosen]),
        np.ascontiguousarray(nodes.variance[..., chosen]),
    )


def as_leaves(tree: BlockTree, level: int, nodes: EstimatedNodes) -> LeafSet:
    """Turn nodes into rank-1 leaves, ``T_ab = x_ab x_ba^T / m`` (Fig. 5.1).

    Leaves store the factors ``u = x_ab / sqrt(m)`` and ``v = x_ba / sqrt(m)``, 0 where m is 0.
    """
    offset_a, _, n_values = factor_offsets(tree.starts[level], nodes.block_a, nodes.block_b)
    lengths = np.diff(np.append(offset_a, n_values))
    root = np.sqrt(nodes.energy, where=nodes.energy > 0, out=np.ones_like(nodes.energy))
    scale = np.repeat((1.0 / root).astype(np.float32), lengths, axis=1)
    return LeafSet(level, nodes.block_a, nodes.block_b, nodes.pieces * scale)
