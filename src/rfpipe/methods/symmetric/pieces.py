"""What a level's images hold beside the light that is known already, pair by pair of blocks.

(Thesis §5.1, C.2.) The images are read once, a few at a time, and only the pieces that a method
asks for are kept: for the unknown nodes of a fine level a small part of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rfpipe.blocks import BlockTree
from rfpipe.methods.base import LevelImages
from rfpipe.methods.symmetric.nodes import (
    Blocks,
    Double,
    Float,
    Frontier,
    Grid,
    Index,
    Nodes,
    Pairs,
    compared_pixels,
)
from rfpipe.transport.hierarchical.apply import predict
from rfpipe.transport.hierarchical.leaves import LeafSet, runs


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

    Attributes
    ----------
    tree : BlockTree
    level : int
        Of the nodes; the children's is the next.
    nodes : Frontier
    first_pair : ndarray of int64, shape (n + 1,)
        Node ``i``'s children are the pairs ``first_pair[i]:first_pair[i + 1]``.
    pieces : Pieces
        Of the children.
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
