"""What the leaves of the hierarchical tensor make of patterns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.base import Float
from rfpipe.transport.leaves import LeafSet, leaf_offsets, split_scalars

# Patterns relit together: bounds the memory of their images.
_BATCH = 16
# Patterns for which a task fetches each leaf once.
_GROUP = 4
# Values that stay in a core's cache from one pattern to the next.
_RUN_VALUES = 2**14
# The work is cut into this many tasks or a few more, enough to keep a dozen cores busy, whatever
# the machine: results are the same everywhere.
_TASKS = 12


def apply_leaf_sets(
    tree: BlockTree, leaf_sets: Sequence[LeafSet], patterns: Float, channels: Sequence[int]
) -> Float:
    """Return what the leaves make of patterns, all in tree order.

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
        The same whatever the number of threads. Patterns of one call may differ in the last bits
        from those of calls with fewer.
    """
    result = np.empty(patterns.shape, np.float32)
    if not patterns.size:
        return result
    chosen = np.array(list(channels), np.int64)
    groups = -(-min(len(patterns), _BATCH) // _GROUP)
    shares = -(-_TASKS // (groups * len(chosen)))
    for first in range(0, len(patterns), _BATCH):
        part = np.ascontiguousarray(patterns[first : first + _BATCH])
        _apply(tree, leaf_sets, part, chosen, shares, result[first : first + _BATCH])
    return result


def _apply(
    tree: BlockTree,
    leaf_sets: Sequence[LeafSet],
    patterns: Float,
    channels: NDArray[np.int64],
    shares: int,
    result: Float,
) -> None:
    """Write what the leaves make of one batch of patterns."""
    from rfpipe.transport import kernels

    rays = tree.domain.size
    sums = result[None] if shares == 1 else np.empty((shares, *patterns.shape), np.float32)
    kernels.clear(sums.reshape(-1, rays))
    lit = _lit_blocks(tree, patterns)
    for leaves in _prepared(tree, leaf_sets):
        bounds, offsets = _cut(tree, leaves, shares)
        if leaves.level == tree.n_levels - 1:
            kernels.apply_scalars(
                leaves.block_a, leaves.block_b, leaves.values, channels, bounds, _GROUP, patterns,
                sums,
            )  # fmt: skip
        else:
            kernels.apply_leaves(
                tree.starts[leaves.level], leaves.block_a, leaves.block_b, leaves.values, channels,
                bounds, offsets, _GROUP, patterns, lit[leaves.level], sums,
            )  # fmt: skip
    if shares > 1:
        kernels.add_shares(sums.reshape(shares, -1, rays), result.reshape(-1, rays))


def _prepared(tree: BlockTree, leaf_sets: Sequence[LeafSet]) -> Iterator[LeafSet]:
    """Yield the leaves as they are applied soonest, see `split_scalars`."""
    for leaves in leaf_sets:
        if not leaves.parts:
            leaves.parts.extend(split_scalars(tree, leaves))
        yield from filter(len, leaves.parts)


def _lit_blocks(tree: BlockTree, patterns: Float) -> list[NDArray[np.uint8]]:
    """Tell for each level which blocks each pattern lights, ``(P, n_blocks)``."""
    from rfpipe.transport import kernels

    count, _, rays = patterns.shape
    lit = [np.empty((count, rays), np.uint8)]
    kernels.lit_rays(patterns, lit[0])
    if lit[0].all():
        return [np.ones((count, len(starts) - 1), np.uint8) for starts in tree.starts]
    for child_starts in reversed(tree.child_starts):
        lit.append(np.empty((count, len(child_starts) - 1), np.uint8))
        kernels.lit_parents(child_starts, lit[-2], lit[-1])
    return lit[::-1]


def _cut(
    tree: BlockTree, leaves: LeafSet, shares: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut leaves into shares of about equal work, and these into runs of `_RUN_VALUES`.

    Returns the first leaf and the first value of each run, both ``(shares, runs + 1)``.
    """
    if shares not in leaves.cuts:
        offsets = leaf_offsets(tree, leaves)
        runs = max(1, -(-int(offsets[-1]) // (_RUN_VALUES * shares)))
        aims = np.arange(shares * runs + 1) * (offsets[-1] / (shares * runs))
        cuts = np.searchsorted(offsets, aims)
        bounds = cuts[np.arange(shares)[:, None] * runs + np.arange(runs + 1)]
        leaves.cuts[shares] = bounds, offsets[bounds]
    return leaves.cuts[shares]
