"""Products of the hierarchical tensor's leaves with patterns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float, Index
from rfpipe.blocks import BlockTree
from rfpipe.transport.hierarchical.leaves import (
    LeafSet,
    factor_offsets,
    leaf_offsets,
    ragged_ranges,
)

# Patterns that are relit at a time: bounds the memory of their images.
_PATTERNS_PER_BATCH = 16
# Patterns of a task, for which each leaf is fetched once.
_PATTERNS_PER_GROUP = 4
# Values that stay in a core's cache from one pattern to the next.
_RUN_VALUES = 2**14
# At least this number of tasks on every machine, so that results are the same everywhere. More
# tasks use more cores, and each adds an image to be cleared and summed.
_TASKS = 6
# Rays whose images under a batch of patterns stay in a core's cache.
_TILE_RAYS = 1024


def apply_leaf_sets(
    tree: BlockTree, leaf_sets: Sequence[LeafSet], patterns: Float, channels: Sequence[int]
) -> Float:
    """Return ``T p`` for patterns, both in the order of images.

    The sets are read one at a time, once for every 16 patterns. Images don't depend on the number
    of threads; their last bits may differ between calls with fewer and with more patterns.

    Parameters
    ----------
    tree : BlockTree
    leaf_sets : sequence of LeafSet
    patterns : ndarray of float32, shape (P, K, N)
        A plane for each of `channels`.
    channels : sequence of int

    Returns
    -------
    ndarray of float32, shape (P, K, N)
    """
    result = np.empty(patterns.shape, np.float32)
    if not patterns.size:
        return result
    chosen = np.array(list(channels), np.int64)
    groups = -(-min(len(patterns), _PATTERNS_PER_BATCH) // _PATTERNS_PER_GROUP)
    n_chunks = -(-_TASKS // (groups * len(chosen)))
    for first in range(0, len(patterns), _PATTERNS_PER_BATCH):
        batch = slice(first, first + _PATTERNS_PER_BATCH)
        light, images = patterns[batch], result[batch]
        if light.strides[1] == 0:
            light = light[:, :1]  # white light, the same for all channels
        sums = np.zeros((n_chunks, *images.shape), np.float32)
        _add_products(tree, leaf_sets, light[..., tree.order], chosen, sums)
        np.take(sums.sum(axis=0), tree.inverse, axis=-1, out=images)
    return result


def _add_products(
    tree: BlockTree, leaf_sets: Sequence[LeafSet], patterns: Float, channels: Index, sums: Float
) -> None:
    """Add the product of each chunk of the leaves, (chunks, P, K, N), in tree order."""
    from rfpipe.transport.hierarchical import kernels

    lit = _lit_blocks(tree, patterns)
    for leaves in filter(len, leaf_sets):
        work = kernels.WorkSplit(*_divide(tree, leaves, len(sums)), _PATTERNS_PER_GROUP)
        blocks = leaves.block_a, leaves.block_b
        arrays = kernels.Leaves(tree.starts[leaves.level], *blocks, leaves.values, _scales(leaves))
        if leaves.level == tree.n_levels - 1:
            kernels.apply_scalars(arrays, channels, work, patterns, sums)
        else:
            kernels.apply_leaves(arrays, channels, work, patterns, lit[leaves.level], sums)


def _scales(leaves: LeafSet) -> Float:
    """Return the scales of the leaves' factors, 1 where they are not rounded."""
    if leaves.scales is not None:
        return leaves.scales
    return np.broadcast_to(np.float32(1), (len(leaves.values), len(leaves)))


def _lit_blocks(tree: BlockTree, patterns: Float) -> list[Bools]:
    """Return for each level the blocks that each pattern lights, bool ``(P, n_blocks)``."""
    lit = [(patterns != 0).any(axis=1)]
    for child_starts in reversed(tree.child_starts):
        lit.append(np.logical_or.reduceat(lit[-1], child_starts[:-1], axis=1))
    return lit[::-1]


def _divide(tree: BlockTree, leaves: LeafSet, n_chunks: int) -> tuple[Index, Index]:
    """Divide leaves into chunks of equal work and these into runs; see `kernels.WorkSplit`."""
    key = f"{n_chunks} chunks"
    if key not in leaves.cache:
        offsets = leaf_offsets(tree, leaves)
        n_runs = max(1, -(-int(offsets[-1]) // (_RUN_VALUES * n_chunks)))
        targets = np.arange(n_chunks * n_runs + 1) * (offsets[-1] / (n_chunks * n_runs))
        ends = np.searchsorted(offsets, targets)
        bounds = ends[np.arange(n_chunks)[:, None] * n_runs + np.arange(n_runs + 1)]
        leaves.cache[key] = bounds, offsets[bounds]
    split: tuple[Index, Index] = leaves.cache[key]
    return split


def predict(
    tree: BlockTree,
    leaf_sets: Sequence[LeafSet],
    level: int,
    pattern_of_block: NDArray[np.int32],
    first: int,
    last: int,
    channels: int,
) -> Float:
    """Return the images of patterns ``first:last`` of a level's schedule, by the leaves alone.

    The schedule lights each ray in at most one pattern, so that a leaf's factor is read once for
    many patterns and dark blocks take no time.

    Parameters
    ----------
    tree : BlockTree
    leaf_sets : sequence of LeafSet
    level : int
        Level of the scheduled blocks.
    pattern_of_block : ndarray of int32, shape (n_blocks,)
        Pattern that lights each block, -1 for none.
    first, last, channels : int

    Returns
    -------
    ndarray of float32, shape (last - first, channels, N)
        In tree order; an image doesn't depend on the other patterns of the call.
    """
    from rfpipe.transport.hierarchical import kernels

    images = np.zeros((last - first, channels, tree.domain.size), np.float32)
    pattern_of_cell = pattern_of_block - np.int32(first)
    lit_cells = np.flatnonzero((pattern_of_cell >= 0) & (pattern_of_cell < last - first))
    cell_starts = tree.starts[level]
    for leaves in filter(len, leaf_sets):
        blocks = leaves.block_a, leaves.block_b
        if leaves.level == tree.n_levels - 1:
            pattern_of_ray = np.repeat(pattern_of_cell, np.diff(cell_starts))
            kernels.scalars_to_partition(*blocks, leaves.values, pattern_of_ray, images)
            continue
        starts = tree.starts[leaves.level]
        first_lit = np.searchsorted(lit_cells, _overlaps(starts, cell_starts))
        offset_a, offset_b, _ = factor_offsets(starts, *blocks)
        kernels.apply_to_partition(
            kernels.LeafSides(
                starts, *blocks, offset_a, offset_b, leaves.values, *_sides(leaves, tree)
            ),
            _tiles(starts),
            kernels.Partition(cell_starts, pattern_of_cell, lit_cells, first_lit),
            images,
        )
    return images


def _tiles(starts: Index) -> Index:
    """Divide blocks into tiles of at most `_TILE_RAYS` rays, (n, 3): block, first ray, end."""
    counts = -(-np.diff(starts) // _TILE_RAYS)
    block = np.repeat(np.arange(len(counts)), counts)
    ray = starts[block] + ragged_ranges(np.zeros_like(counts), counts) * _TILE_RAYS
    return np.stack([block, ray, np.minimum(ray + _TILE_RAYS, starts[block + 1])], axis=1)


def _overlaps(starts: Index, cell_starts: Index) -> Index:
    """Return the first and the end of the cells that overlap each block, ``(n_blocks, 2)``."""
    first = np.searchsorted(cell_starts, starts[:-1], side="right") - 1
    return np.stack([first, np.searchsorted(cell_starts, starts[1:], side="left")], axis=1)


def _sides(leaves: LeafSet, tree: BlockTree) -> tuple[Index, Index]:
    """List the leaves of each block; see `first_side` and `sides` of `kernels.LeafSides`."""
    if "sides" not in leaves.cache:
        off_diagonal = np.flatnonzero(leaves.block_a != leaves.block_b)
        block = np.concatenate([leaves.block_a, leaves.block_b[off_diagonal]])
        side = np.concatenate([2 * np.arange(len(leaves)), 2 * off_diagonal + 1])
        order = np.lexsort((side, block))
        first = np.searchsorted(block[order], np.arange(tree.n_blocks(leaves.level) + 1))
        leaves.cache["sides"] = first, side[order]
    sides: tuple[Index, Index] = leaves.cache["sides"]
    return sides
