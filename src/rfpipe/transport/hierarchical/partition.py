"""What leaves make of patterns that share out the blocks of a level among them.

Each ray is lit in one pattern at most, so that a leaf's factor is read once for many patterns, and
nothing is added where a pattern leaves a block dark.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.base import Float
from rfpipe.transport.hierarchical.leaves import LeafSet, factor_offsets, ragged_ranges

Index = NDArray[np.int64]

# Rays whose images under a batch of patterns stay in a core's cache.
_TILE = 1024


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

    Parameters
    ----------
    tree : BlockTree
    leaf_sets : sequence of LeafSet
        Of any levels.
    level : int
        Whose blocks the patterns are made of.
    pattern_of_block : ndarray of int32
        Pattern that lights each of them, -1 for none.
    first, last : int
        The patterns wanted, from `first` to before `last`.
    channels : int

    Returns
    -------
    ndarray of float32, shape (last - first, channels, N)
        In tree order. The images don't depend on which of them are asked for together.
    """
    from rfpipe.transport.hierarchical import partition_kernels as kernels

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
            leaves.signs_if_any, *_sides(leaves, tree), _tiles(starts), lit_parts, first_lit,
            part_starts, pattern_of_part, images,
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

    Returns
    -------
    ndarray of int64, shape (n_blocks + 1,)
        Where each block's list begins, and the length of all.
    ndarray of int64
        Twice a leaf's number where the block is its a, one more where it is its b alone.
    """
    if "sides" not in leaves.kept:
        apart = np.flatnonzero(leaves.block_a != leaves.block_b)
        block = np.concatenate([leaves.block_a, leaves.block_b[apart]])
        side = np.concatenate([2 * np.arange(len(leaves)), 2 * apart + 1])
        order = np.lexsort((side, block))
        first = np.searchsorted(block[order], np.arange(tree.n_blocks(leaves.level) + 1))
        leaves.kept["sides"] = first, side[order]
    found: tuple[Index, Index] = leaves.kept["sides"]
    return found
