"""Rank-1 leaves of a coarse level from the leaves of finer ones (thesis Fig. 5.7).

The leaves below node (a, b) give the sum x_ab of its columns and the sum x_ba of its rows, and the
node becomes ``x_ab x_ba^T / m``, where m is the sum of either (Fig. 5.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Index
from rfpipe.blocks import BlockTree
from rfpipe.transport.hierarchical.leaves import (
    LeafSet,
    decoded,
    factor_offsets,
    merge_leaf_sets,
    ragged_ranges,
    runs,
)

# Values per channel that are summed at a time, in float64: 100 MB of RGB.
_SUMMED_VALUES = 2**22


def collapse(
    tree: BlockTree, leaf_sets: Sequence[LeafSet], level: int, channels: int
) -> Iterator[LeafSet]:
    """Yield rank-1 leaves of `level` with the row and column sums of the finer leaves.

    One set of leaves is in memory at a time.
    """
    keys = [_node_keys(tree, leaves, level) for leaves in leaf_sets]
    if not keys:
        return
    n_blocks = tree.n_blocks(level)
    nodes = np.unique(np.concatenate(keys))
    block_a, block_b = np.divmod(nodes, n_blocks)
    sizes = np.diff(tree.starts[level])
    lengths = sizes[block_a] + np.where(block_a == block_b, 0, sizes[block_b])
    for run in runs(lengths, _SUMMED_VALUES):
        collapsed = _collapse_run(tree, leaf_sets, keys, nodes[run], level, channels)
        yield from merge_leaf_sets([collapsed], tree)


def _node_keys(tree: BlockTree, leaves: LeafSet, level: int) -> Index:
    """Number of the node of `level` that each leaf is in, in the order of the nodes' blocks."""
    block = tree.ancestors(leaves.level, level)
    keys: Index = block[leaves.block_a] * np.int64(tree.n_blocks(level)) + block[leaves.block_b]
    return keys


def _collapse_run(
    tree: BlockTree,
    leaf_sets: Sequence[LeafSet],
    keys: Sequence[Index],
    nodes: Index,
    level: int,
    channels: int,
) -> LeafSet:
    """Return the rank-1 leaves of some nodes, from the leaves below them."""
    block_a, block_b = (
        blocks.astype(np.int32) for blocks in np.divmod(nodes, tree.n_blocks(level))
    )
    starts = tree.starts[level]
    offset_a, offset_b, n_values = factor_offsets(starts, block_a, block_b)
    marginals = np.zeros((channels, n_values))
    offsets = offset_a - starts[block_a], offset_b - starts[block_b]
    for index, key in enumerate(keys):
        inside = (key >= nodes[0]) & (key <= nodes[-1])
        if inside.any():
            leaves = decoded(tree, leaf_sets[index].subset(tree, inside))
            _add_marginals(tree, leaves, np.searchsorted(nodes, key[inside]), offsets, marginals)
    sizes = np.diff(starts)
    rows = ragged_ranges(offset_a, sizes[block_a])
    begin = np.cumsum(sizes[block_a]) - sizes[block_a]
    lengths = np.diff(np.append(offset_a, n_values))
    values = np.empty(marginals.shape, np.float32)
    for sums, factors in zip(marginals, values, strict=True):
        light = np.add.reduceat(sums[rows], begin)
        scale = np.where(light > 0, 1 / np.sqrt(np.where(light > 0, light, 1)), 0.0)
        np.multiply(sums, np.repeat(scale, lengths), out=factors, casting="same_kind")
    return LeafSet(level, block_a, block_b, values)


def _add_marginals(
    tree: BlockTree,
    leaves: LeafSet,
    node: Index,
    node_offsets: tuple[Index, Index],
    marginals: NDArray[np.float64],
) -> None:
    """Add the row and column sums of leaves to the sums of their nodes, in place.

    The sum of a node's tree position k is at ``node_offsets[side][node] + k``.
    """
    starts, values = tree.starts[leaves.level], leaves.values
    sizes, off_diagonal = np.diff(starts), leaves.block_a != leaves.block_b
    if leaves.level == tree.n_levels - 1:
        # a scalar x is the leaf x * 1
        values = np.concatenate([values, np.ones_like(values)], axis=1)
        offsets = [np.arange(len(leaves)), np.arange(len(leaves)) + len(leaves)]
    else:
        offsets = [*factor_offsets(starts, leaves.block_a, leaves.block_b)[:2]]
    sides = []
    blocks = leaves.block_a, leaves.block_b
    for block, offset, first in zip(blocks, offsets, node_offsets, strict=True):
        lengths = sizes[block]
        factors = values[:, ragged_ranges(offset, lengths)].astype(np.float64)
        sums = np.add.reduceat(factors, np.cumsum(lengths) - lengths, axis=1)
        sides.append((ragged_ranges(first[node] + starts[block], lengths), lengths, factors, sums))
    a, b = sides
    for (index, lengths, factors, _), sums in ((a, b[-1]), (b, a[-1] * off_diagonal)):
        light = factors * np.repeat(sums, lengths, axis=1)
        marginals += [np.bincount(index, plane, marginals.shape[1]) for plane in light]
