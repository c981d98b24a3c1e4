"""What the leaves of the hierarchical tensor make of patterns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.base import Float
from rfpipe.transport.hierarchical.leaves import (
    LeafSet,
    factor_offsets,
    leaf_offsets,
    ragged_ranges,
)

# Patterns relit together: bounds the memory of their images.
_BATCH = 16
# Patterns for which a task fetches each leaf once.
_GROUP = 4
# Values that stay in a core's cache from one pattern to the next.
_RUN_VALUES = 2**14
# The work is cut into this many tasks or a few more, whatever the machine, so that results are the
# same everywhere. More would feed more cores, and each adds an image to be cleared and summed.
_TASKS = 6

# Rays whose images under a batch of patterns stay in a core's cache.
_TILE = 1024

Index = NDArray[np.int64]


def apply_leaf_sets(
    tree: BlockTree, leaf_sets: Sequence[LeafSet], patterns: Float, channels: Sequence[int]
) -> Float:
    """Return what the leaves make of patterns, both in the order of images.

    Patterns and images are float32 (P, K, N), one plane for each of `channels`. The sets are gone
    through once for every 16 patterns, one at a time. Images are the same whatever the number of
    threads; their last bits may differ between calls with fewer and with more patterns.
    """
    result = np.empty(patterns.shape, np.float32)
    if not patterns.size:
        return result
    chosen = np.array(list(channels), np.int64)
    groups = -(-min(len(patterns), _BATCH) // _GROUP)
    shares = -(-_TASKS // (groups * len(chosen)))
    for first in range(0, len(patterns), _BATCH):
        part, images = patterns[first : first + _BATCH], result[first : first + _BATCH]
        if part.strides[1] == 0:
            part = part[:, :1]  # white light, the same for all channels
        sums = np.zeros((shares, *images.shape), np.float32)
        _add_up(tree, leaf_sets, part[..., tree.order], chosen, sums)
        np.take(sums.sum(axis=0), tree.inverse, axis=-1, out=images)
    return result


def _add_up(
    tree: BlockTree, leaf_sets: Sequence[LeafSet], patterns: Float, channels: Index, sums: Float
) -> None:
    """Add what each share of the leaves makes of patterns."""
    from rfpipe.transport.hierarchical import kernels

    lit = _lit_blocks(tree, patterns)
    for leaves in filter(len, leaf_sets):
        bounds, offsets = _cut(tree, leaves, len(sums))
        blocks = leaves.block_a, leaves.block_b
        if leaves.level == tree.n_levels - 1:
            kernels.apply_scalars(
                *blocks, leaves.values, channels, bounds, _GROUP, patterns, sums
            )  # fmt: skip
        else:
            kernels.apply_leaves(
                tree.starts[leaves.level], *blocks, leaves.values, _scales(leaves),
                channels, bounds, offsets, _GROUP, patterns, lit[leaves.level], sums,
            )  # fmt: skip


def _scales(leaves: LeafSet) -> Float:
    """Return the scales by which the kernels multiply factors, 1 where none are rounded."""
    if leaves.scales is not None:
        return leaves.scales
    return np.broadcast_to(np.float32(1), (len(leaves.values), len(leaves)))


def _lit_blocks(tree: BlockTree, patterns: Float) -> list[NDArray[np.bool_]]:
    """Tell for each level which blocks each pattern lights, ``(P, n_blocks)``."""
    lit = [(patterns != 0).any(axis=1)]
    for child_starts in reversed(tree.child_starts):
        lit.append(np.logical_or.reduceat(lit[-1], child_starts[:-1], axis=1))
    return lit[::-1]


def _cut(tree: BlockTree, leaves: LeafSet, shares: int) -> tuple[Index, Index]:
    """Cut leaves into shares of about equal work, and these into runs of `_RUN_VALUES`."""
    name = f"{shares} shares"
    if name not in leaves.kept:
        offsets = leaf_offsets(tree, leaves)
        runs = max(1, -(-int(offsets[-1]) // (_RUN_VALUES * shares)))
        aims = np.arange(shares * runs + 1) * (offsets[-1] / (shares * runs))
        cuts = np.searchsorted(offsets, aims)
        bounds = cuts[np.arange(shares)[:, None] * runs + np.arange(runs + 1)]
        leaves.kept[name] = bounds, offsets[bounds]
    limits: tuple[Index, Index] = leaves.kept[name]
    return limits


def predict(
    tree: BlockTree,
    leaf_sets: Sequence[LeafSet],
    level: int,
    pattern_of_block: NDArray[np.int32],
    first: int,
    last: int,
    channels: int,
) -> Float:
    """Return the images of some patterns of a level's schedule, by the leaves alone.

    Each ray is lit in one pattern at most, so that a leaf's factor is read once for many patterns,
    and nothing is added where a pattern leaves a block dark.

    `pattern_of_block` is the pattern that lights each block of `level`, -1 for none; the images,
    float32 (last - first, channels, N) in tree order, don't depend on which are asked for together.
    """
    from rfpipe.transport.hierarchical import kernels

    images = np.zeros((last - first, channels, tree.domain.size), np.float32)
    pattern_of_part = pattern_of_block - np.int32(first)
    lit_parts = np.flatnonzero((pattern_of_part >= 0) & (pattern_of_part < last - first))
    part_starts = tree.starts[level]
    for leaves in leaf_sets:
        if not len(leaves):
            continue
        if leaves.level == tree.n_levels - 1:
            pattern_of_ray = np.repeat(pattern_of_part, np.diff(part_starts))
            kernels.scalars_to_partition(
                leaves.block_a, leaves.block_b, leaves.values, pattern_of_ray, images
            )
            continue
        starts = tree.starts[leaves.level]
        offset_a, offset_b, _ = factor_offsets(starts, leaves.block_a, leaves.block_b)
        first_lit = np.searchsorted(lit_parts, _met(starts, part_starts))
        kernels.apply_to_partition(
            starts, leaves.block_a, leaves.block_b, offset_a, offset_b, leaves.values,
            *_sides(leaves, tree), _tiles(starts), lit_parts, first_lit, part_starts,
            pattern_of_part, images,
        )  # fmt: skip
    return images


def _tiles(starts: Index) -> Index:
    """Cut blocks into runs of at most `_TILE` rays, ``(n, 3)``: block, first ray, end."""
    counts = -(-np.diff(starts) // _TILE)
    block = np.repeat(np.arange(len(counts)), counts)
    ray = starts[block] + ragged_ranges(np.zeros_like(counts), counts) * _TILE
    return np.stack([block, ray, np.minimum(ray + _TILE, starts[block + 1])], axis=1)


def _met(starts: Index, others: Index) -> Index:
    """Return which of the other blocks each block meets, ``(n, 2)``: first, and after the last."""
    first = np.searchsorted(others, starts[:-1], side="right") - 1
    return np.stack([first, np.searchsorted(others, starts[1:], side="left")], axis=1)


def _sides(leaves: LeafSet, tree: BlockTree) -> tuple[Index, Index]:
    """List the leaves that each block has a factor of, block by block; once.

    Returns where each block's list begins, and the lists: twice a leaf's number where the block is
    its a, one more where it is its b alone.
    """
    if "sides" not in leaves.kept:
        apart = np.flatnonzero(leaves.block_a != leaves.block_b)
        block = np.concatenate([leaves.block_a, leaves.block_b[apart]])
        side = np.concatenate([2 * np.arange(len(leaves)), 2 * apart + 1])
        order = np.lexsort((side, block))
        first = np.searchsorted(block[order], np.arange(tree.n_blocks(leaves.level) + 1))
        leaves.kept["sides"] = first, side[order]
    sides: tuple[Index, Index] = leaves.kept["sides"]
    return sides
