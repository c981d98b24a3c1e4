"""What the leaves of the hierarchical tensor make of patterns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.base import Float
from rfpipe.transport.hierarchical.codes import decoded
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

Index = NDArray[np.int64]


def apply_leaf_sets(
    tree: BlockTree, leaf_sets: Sequence[LeafSet], patterns: Float, channels: Sequence[int]
) -> Float:
    """Return what the leaves make of patterns, both in the order of images.

    Parameters
    ----------
    tree : BlockTree
    leaf_sets : sequence of LeafSet
        Gone through once for every 16 patterns; one set at a time is in use.
    patterns : ndarray of float32, shape (P, K, N)
        One plane for each of `channels`.
    channels : sequence of int
        Which channels of the leaves to use.

    Returns
    -------
    ndarray of float32, shape (P, K, N)
        The same whatever the number of threads. A pattern's result may differ in the last bits
        between calls with fewer and with more patterns.
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
    for leaves in _prepared(tree, leaf_sets):
        bounds, offsets = _cut(tree, leaves, len(sums))
        blocks = leaves.block_a, leaves.block_b
        if leaves.level == tree.n_levels - 1:
            kernels.apply_scalars(
                *blocks, leaves.values, channels, bounds, _GROUP, patterns, sums
            )  # fmt: skip
        else:
            kernels.apply_leaves(
                tree.starts[leaves.level], *blocks, leaves.values, _signed_scales(leaves),
                channels, bounds, offsets, _GROUP, patterns, lit[leaves.level], sums,
            )  # fmt: skip


def _signed_scales(leaves: LeafSet) -> Float:
    """Return the scales by which the kernels multiply, with the leaves' signs."""
    one = np.float32(1)
    if leaves.signs is not None:
        return np.multiply(leaves.signs, one if leaves.scales is None else leaves.scales)
    if leaves.scales is not None:
        return leaves.scales
    return np.broadcast_to(one, (len(leaves.values), len(leaves)))


def _lit_blocks(tree: BlockTree, patterns: Float) -> list[NDArray[np.bool_]]:
    """Tell for each level which blocks each pattern lights, ``(P, n_blocks)``."""
    lit = [(patterns != 0).any(axis=1)]
    for child_starts in reversed(tree.child_starts):
        lit.append(np.logical_or.reduceat(lit[-1], child_starts[:-1], axis=1))
    return lit[::-1]


def _prepared(tree: BlockTree, leaf_sets: Sequence[LeafSet]) -> Iterator[LeafSet]:
    """Yield the leaves as they are applied soonest, see `_split_scalars`."""
    for leaves in leaf_sets:
        if "split" not in leaves.kept:
            leaves.kept["split"] = _split_scalars(tree, leaves)
        yield from filter(len, leaves.kept["split"] or (leaves,))


def _split_scalars(tree: BlockTree, leaves: LeafSet) -> tuple[LeafSet, LeafSet] | None:
    """Return leaves, and those that take no more numbers as scalars as such; None without."""
    if leaves.level == tree.n_levels - 1:
        return None
    sizes = np.diff(tree.starts[leaves.level])
    size_a, size_b = sizes[leaves.block_a], sizes[leaves.block_b]
    few = size_a * size_b <= np.where(leaves.block_a == leaves.block_b, size_a, size_a + size_b)
    if not few.any():
        return None
    scalars = _as_scalars(tree, decoded(tree, leaves.subset(tree, few)))
    return leaves.subset(tree, ~few), scalars


def _as_scalars(tree: BlockTree, leaves: LeafSet) -> LeafSet:
    """Return leaves as scalars, one for each pair of rays."""
    starts = tree.starts[leaves.level]
    sizes = np.diff(starts)
    first, second, _ = factor_offsets(starts, leaves.block_a, leaves.block_b)
    count = sizes[leaves.block_a] * sizes[leaves.block_b]
    within = ragged_ranges(np.zeros_like(count), count)
    row, column = np.divmod(within, np.repeat(sizes[leaves.block_b], count))
    values = np.empty((len(leaves.values), len(row)), np.float32)
    np.multiply(
        leaves.values[:, np.repeat(first, count) + row],
        leaves.values[:, np.repeat(second, count) + column],
        out=values,
    )
    if leaves.signs is not None:
        values *= np.repeat(leaves.signs, count, axis=1)
    ray_a = np.repeat(starts[leaves.block_a], count) + row
    ray_b = np.repeat(starts[leaves.block_b], count) + column
    return LeafSet(tree.n_levels - 1, ray_a.astype(np.int32), ray_b.astype(np.int32), values)


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
    found: tuple[Index, Index] = leaves.kept[name]
    return found
