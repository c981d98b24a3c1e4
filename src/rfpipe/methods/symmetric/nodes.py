"""The unknown nodes of a level of symmetric photography (thesis §4.2, §5.1)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.methods.base import LevelImages
from rfpipe.transport.hierarchical.apply import predict
from rfpipe.transport.hierarchical.leaves import LeafSet, factor_offsets, ragged_ranges, runs

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Blocks = NDArray[np.int32]
Index = NDArray[np.int64]

# Subdividing a node takes a kilobyte, its children some dozens of bytes.
_NODES_AT_A_TIME = 2**15


class Grid(NamedTuple):
    """The blocks of a level, for kernels: first tree positions, first children, and theirs."""

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
    blocks = [
        _child_blocks(tree.child_starts[level], nodes.block_a[run], nodes.block_b[run])
        for run in (slice(start, start + _NODES_AT_A_TIME) for start in starts)
    ]
    first, second = (np.concatenate(part) for part in zip(*blocks, strict=True))
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


class Pieces(NamedTuple):
    """The two pieces of pairs of blocks of one level; one on the diagonal.

    Attributes
    ----------
    pairs : Pairs
    values, variances : ndarray of float32, shape (C, n_values)
        Residual radiance; the variance includes the rounding of the images to float32.
    sums, spread : ndarray of float64, shape (C, 2, n)
        Sums of the two pieces, and their variances.
    doubt : ndarray of float64, shape (C, 2, n)
        The same variances, with what is not known of unknown pixels.
    unknown : ndarray of int64, shape (k,)
        Tree positions of pixels that the images don't know, ascending. Their values are what the
        other piece of the pair and their neighbours say, with a variance of 0; no test counts them.
    """

    pairs: Pairs
    values: Float
    variances: Float
    sums: Double
    spread: Double
    doubt: Double
    unknown: Index


class Divided(NamedTuple):
    """Unknown nodes and their children's pieces, for kernels; see `Subdivided`."""

    grid: Grid
    nodes: Nodes
    first_pair: Index
    pieces: Pieces


@dataclass(frozen=True)
class Subdivided:
    """Unknown nodes of a level, and what the next level's images say of their children.

    Node ``i``'s children are the pairs ``first_pair[i]:first_pair[i + 1]``, of the next level.
    """

    tree: BlockTree
    level: int
    nodes: Frontier
    first_pair: Index
    pieces: Pieces

    @property
    def arrays(self) -> Divided:
        """All of it, for kernels."""
        nodes = self.nodes.nodes(self.tree, self.level)
        return Divided(Grid.of(self.tree, self.level), nodes, self.first_pair, self.pieces)


def affordable(tree: BlockTree, level: int, nodes: Frontier, memory_bytes: int) -> Iterator[slice]:
    """Cut nodes of `level` into runs whose children's pieces fit into memory together.

    Each run costs a pass over the level's images; there is one where memory is sufficient.
    """
    channels = len(nodes.pieces)
    children = np.diff(tree.child_starts[level])
    pairs = children[nodes.block_a] * children[nodes.block_b]
    pixels = compared_pixels(tree, level, nodes)
    # a pixel of a piece and its variance, and a pair's sums, variances and energy; nodes and leaves
    # made of pieces take as much again at most
    taken = (8 * pixels + 64 * pairs) * channels
    return runs(taken, memory_bytes / 2)


def collect(
    tree: BlockTree,
    block_a: Blocks,
    block_b: Blocks,
    known: Sequence[LeafSet],
    channels: int,
    images: LevelImages,
    memory_bytes: int,
) -> Pieces:
    """Subtract the known leaves' prediction from a level's images and take the pairs' pieces.

    The images are of a schedule that is a partition of the rays; the pieces don't depend on the
    memory to work in.
    """
    from rfpipe.methods.symmetric import kernels

    schedule = images.schedule
    starts = tree.starts[schedule.level]
    pairs, n_values = Pairs.of(starts, block_a, block_b)
    values = np.zeros((channels, n_values), np.float32)
    variances = np.zeros_like(values)
    unknown = np.zeros(tree.domain.size, np.bool_)
    pattern_of_block = schedule.pattern_of_block(tree)
    # images take an eighth of the memory: five copies, as read and in tree order with their
    # variance, and predicted
    image_bytes = channels * tree.domain.size * np.dtype(np.float32).itemsize * 5
    batch = min(max(1, memory_bytes // (8 * image_bytes)), 64)
    for first in range(0, schedule.count, batch):
        last = min(first + batch, schedule.count)
        radiance, variance = (_planar(part, tree, channels) for part in images.read(first, last))
        unknown |= np.isinf(variance[0]).any(axis=0)
        rounding = np.finfo(np.float32).eps * radiance
        variance += rounding * rounding
        radiance -= predict(tree, known, schedule.level, pattern_of_block, first, last, channels)
        radiance[..., unknown], variance[..., unknown] = 0, 0
        kernels.collect_pieces(
            starts, pairs, pattern_of_block, first, radiance, variance, values, variances
        )
    sums = np.empty((channels, 2, len(block_a)))
    spread = np.empty_like(sums)
    for part, total in ((values, sums), (variances, spread)):
        kernels.sum_pieces(starts, pairs, part, total)
    positions, doubt = np.flatnonzero(unknown), spread
    if len(positions):
        doubt = spread.copy()
    pieces = Pieces(pairs, values, variances, sums, spread, doubt, positions)
    if len(positions):
        kernels.complete_pieces(starts, pieces)
    return pieces


def _planar(image: Float, tree: BlockTree, channels: int) -> Float:
    """Bring images (P, *shape, C) into planar form and tree order, a copy (P, C, N)."""
    rays = image.reshape(len(image), tree.domain.size, channels)
    planar: Float = np.take(np.moveaxis(rays, 2, 1), tree.order, axis=2)
    return planar
