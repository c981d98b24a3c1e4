"""Residual images cut into the pieces of the nodes' children (thesis §5.1, C.2 AcquireImages).

A piece (a, b) is the part of an image over block a while block b is lit, less the light that the
known leaves predict there. See `rfpipe.methods.symmetric` for symbols.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from rfpipe.array_types import Blocks, Double, Float, Index
from rfpipe.blocks import BlockTree
from rfpipe.methods.base import LevelImages
from rfpipe.methods.images import rounding
from rfpipe.methods.symmetric.nodes import (
    EstimatedNodes,
    LevelBlocks,
    NodeArrays,
    Pairs,
    compared_pixels,
)
from rfpipe.ranges import ranges
from rfpipe.transport.hierarchical.apply import predict
from rfpipe.transport.hierarchical.leaves import LeafSet, runs

_IMAGE_COPIES = 5  # as read and in tree order, both with their variance, and the prediction
_MOST_PATTERNS_PER_BATCH = 64


class Pieces(NamedTuple):
    """The two pieces of each pair of blocks of a level, for kernels; one piece on the diagonal.

    Attributes
    ----------
    block_a, block_b, offset_a, offset_b
        The pairs and their layout, see `Pairs`.
    values, variances : ndarray of float32, shape (C, n_values)
        Residual radiance; the variance includes the rounding of the images to float32.
    sums : ndarray of float64, shape (C, 2, n)
        Sums of the two pieces.
    noise_variance : ndarray of float64, shape (C, 2, n)
        Variances of the sums by the noise of their known pixels.
    variance : ndarray of float64, shape (C, 2, n)
        Variances of the sums, including the estimates of masked pixels.
    masked : ndarray of int64, shape (k,)
        Ascending tree positions of masked pixels. Their values are estimates from the known pixels
        of the same piece and the sum of the pair's other piece (`piece_kernels.complete_pieces`),
        with a variance of 0; the rank test leaves them out.
    """

    block_a: Blocks
    block_b: Blocks
    offset_a: Index
    offset_b: Index
    values: Float
    variances: Float
    sums: Double
    noise_variance: Double
    variance: Double
    masked: Index


class ImageBatch(NamedTuple):
    """Residual images of consecutive patterns, for kernels.

    Attributes
    ----------
    first : int
        Number of the first pattern.
    residuals, variances : ndarray of float32, shape (P, C, N)
        Planar, in tree order.
    """

    first: int
    residuals: Float
    variances: Float


class MeasuredPieces(NamedTuple):
    """The pieces of nodes among the values of `Pieces`, for kernels.

    Attributes
    ----------
    values, variances : ndarray of float32, shape (C, n_values)
    offsets : ndarray of int64, shape (2, n)
        First value of x_ab and of x_ba of each node.
    """

    values: Float
    variances: Float
    offsets: Index


class Profiles(NamedTuple):
    """Pieces of the nodes above over the nodes' blocks, less noisy than measured, for kernels.

    Attributes
    ----------
    pieces : ndarray of float32, shape (C, n_values)
        Pieces of the nodes above.
    offsets : ndarray of int64, shape (2, n)
        First value over block a and over block b of each node; -1 where there is none.
    """

    pieces: Float
    offsets: Index


class Subdivision(NamedTuple):
    """Nodes of a level and the pieces of their children: arguments of kernels.

    Attributes
    ----------
    blocks : LevelBlocks
        Of the nodes' level.
    nodes : NodeArrays
    first_pair : ndarray of int64, shape (n + 1,)
        Node i has the children ``first_pair[i]:first_pair[i + 1]``, pairs of `pieces`.
    pieces : Pieces
        Of the next level.
    """

    blocks: LevelBlocks
    nodes: NodeArrays
    first_pair: Index
    pieces: Pieces

    @classmethod
    def of(
        cls, tree: BlockTree, level: int, nodes: EstimatedNodes, parent: Index, pieces: Pieces
    ) -> Subdivision:
        """Join nodes of `level` and pieces whose pairs have the nodes `parent`, ascending."""
        first_pair = np.searchsorted(parent, np.arange(len(nodes) + 1))
        return cls(LevelBlocks.of(tree, level), nodes.nodes(tree, level), first_pair, pieces)


def node_batches(
    tree: BlockTree, level: int, nodes: EstimatedNodes, memory_bytes: int
) -> Iterator[slice]:
    """Divide nodes of `level` into batches whose children's pieces fit into memory.

    Each batch costs a pass over the level's images.
    """
    channels = len(nodes.pieces)
    children = np.diff(tree.child_starts[level])
    pairs = children[nodes.block_a] * children[nodes.block_b]
    pixels = compared_pixels(tree, level, nodes)
    # 8 bytes for a pixel's value and variance, 64 for a pair's sums, variances and energy; half of
    # the memory is for the nodes and leaves made of the pieces, which take as much again at most
    nbytes = (8 * pixels + 64 * pairs) * channels
    return runs(nbytes, memory_bytes / 2)


def residual_pieces(
    tree: BlockTree,
    level: int,
    blocks: tuple[Blocks, Blocks],
    known: Sequence[LeafSet],
    channels: int,
    images: LevelImages,
    memory_bytes: int,
) -> Pieces:
    """Subtract the known leaves' light from a level's images and cut the pieces of pairs.

    Parameters
    ----------
    tree : BlockTree
    level : int
        Level of the images.
    blocks : two ndarrays of int32, shape (n,)
        Pairs of blocks of that level.
    known : sequence of LeafSet
    channels : int
    images : LevelImages
        The schedule lights each block in at most one pattern.
    memory_bytes : int
        Working memory; the pieces don't depend on it.
    """
    from rfpipe.methods.symmetric import piece_kernels

    starts = tree.starts[level]
    pairs, n_values = Pairs.of(starts, *blocks)
    pattern_of_block = images.schedule.pattern_of_block(tree, level)
    masked = np.zeros(tree.domain.size, np.bool_)
    values = np.zeros((channels, n_values), np.float32)
    variances = np.zeros_like(values)
    for first, last in _pattern_batches(tree, channels, images.schedule.count, memory_bytes):
        radiance, variance = (_planar(it, tree, channels) for it in images.read(first, last))
        masked |= np.isinf(variance[0]).any(axis=0)
        variance += rounding(radiance, least=0.0)
        radiance -= predict(tree, known, level, pattern_of_block, first, last, channels)
        radiance[..., masked], variance[..., masked] = 0, 0
        batch = ImageBatch(first, radiance, variance)
        piece_kernels.collect_pieces(starts, pairs, pattern_of_block, batch, values, variances)
    sums = piece_kernels.piece_sums(starts, pairs, values)
    noise_variance = piece_kernels.piece_sums(starts, pairs, variances)
    if not masked.any():
        no_pixels = np.zeros(0, np.int64)
        return Pieces(*pairs, values, variances, sums, noise_variance, noise_variance, no_pixels)
    pieces = Pieces(
        *pairs, values, variances, sums, noise_variance, noise_variance.copy(),
        np.flatnonzero(masked),
    )  # fmt: skip
    piece_kernels.complete_pieces(starts, pieces)
    return pieces


def _pattern_batches(
    tree: BlockTree, channels: int, count: int, memory_bytes: int
) -> list[tuple[int, int]]:
    """List the first pattern and the end of batches whose images take an eighth of the memory."""
    bytes_per_pattern = channels * tree.domain.size * np.dtype(np.float32).itemsize * _IMAGE_COPIES
    batch = min(max(1, memory_bytes // (8 * bytes_per_pattern)), _MOST_PATTERNS_PER_BATCH)
    return ranges(count, batch)


def _planar(image: Float, tree: BlockTree, channels: int) -> Float:
    """Copy images (P, *shape, C) into planar form and tree order, (P, C, N)."""
    rays = image.reshape(len(image), tree.domain.size, channels)
    planar: Float = np.take(np.moveaxis(rays, 2, 1), tree.order, axis=2)
    return planar
