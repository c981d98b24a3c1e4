"""Leaves of the hierarchical tensor, in flat arrays (thesis §4.2).

A leaf is a node that is not subdivided: its part of ``T`` has rank 1, or is a scalar at the last
level. Rank is the number of pairs of images whose tensor products add up to the node (Fig. 4.2).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float, Index
from rfpipe.blocks import BlockTree
from rfpipe.units import NumberFormat

# Values per channel of a set of leaves, at most, unless one leaf has more: 25 MB of RGB. Sets are
# stored and read as a whole, so that a transport beyond the memory budget is read in parts.
_SET_VALUES = 2**21

LEAF_PARTS = ("block_a", "block_b", "values")
"""Names of the arrays of a `LeafSet` in stores."""

CODED_PARTS = ("block_a", "block_b", "codes", "scales")
"""Names of the arrays of a rounded `LeafSet` in stores."""


@dataclass(frozen=True, eq=False)
class LeafSet:
    """Rank-1 leaves of one level: ``T_ab = u v^T`` and, by symmetry, ``T_ba = v u^T``.

    Factors and scalars are light, never negative. On the diagonal u and v are the same.

    Attributes
    ----------
    level : int
    block_a, block_b : ndarray of int32, shape (n,)
        ``block_a <= block_b``. At the last level a leaf is a scalar.
    values : ndarray of float32, shape (channels, n_values)
        Factors u and v of one leaf after the other; on the diagonal u alone, of a scalar its one
        value. With `scales` they are codes, uint8 or uint16.
    scales : ndarray of float32, shape (channels, n), optional
        Of rounded leaves: a value is the square of its code, times the scale of its leaf.
    cache : dict
        Index arrays that `rfpipe.transport.hierarchical.apply` computes once.
    """

    level: int
    block_a: NDArray[np.int32]
    block_b: NDArray[np.int32]
    values: NDArray[Any]
    scales: Float | None = None
    cache: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        return len(self.block_a)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        scales = 0 if self.scales is None else self.scales.nbytes
        return self.block_a.nbytes + self.block_b.nbytes + self.values.nbytes + scales

    def subset(self, tree: BlockTree, chosen: Bools) -> LeafSet:
        """Return some of the leaves."""
        offsets = leaf_offsets(tree, self)
        index = ragged_ranges(offsets[:-1][chosen], np.diff(offsets)[chosen])
        # indexing alone would make the channel the last axis in memory
        values = np.ascontiguousarray(self.values[:, index])
        scales = None if self.scales is None else np.ascontiguousarray(self.scales[:, chosen])
        return LeafSet(self.level, self.block_a[chosen], self.block_b[chosen], values, scales)


def factor_offsets(
    starts: Index, block_a: NDArray[np.int32], block_b: NDArray[np.int32]
) -> tuple[Index, Index, int]:
    """Return the first values of each pair's factors u and v, and the total number of values.

    On the diagonal both are the same.
    """
    sizes = np.diff(starts)
    size_a = sizes[block_a]
    size_b = np.where(block_a == block_b, 0, sizes[block_b])
    ends = np.cumsum(size_a + size_b)
    first = ends - size_a - size_b
    second = np.where(block_a == block_b, first, first + size_a)
    return first, second, int(ends[-1]) if len(ends) else 0


def leaf_sizes(
    tree: BlockTree, level: int, block_a: NDArray[np.int32], block_b: NDArray[np.int32]
) -> Index:
    """Count the values of each leaf of a level, int64 (n,)."""
    if level == tree.n_levels - 1:
        return np.ones(len(block_a), np.int64)
    sizes = np.diff(tree.starts[level])
    return sizes[block_a] + np.where(block_a == block_b, 0, sizes[block_b])


def pair_of_views(
    tree: BlockTree, level: int, block_a: NDArray[np.int32], block_b: NDArray[np.int32]
) -> Index:
    """Number of the pair of views of each pair of blocks, in the order of ``numpy.triu_indices``.

    It is 0 where the domain has a single view, and at level 0.
    """
    if level == 0 or not tree.splits_views(0):
        return np.zeros(len(block_a), np.int64)
    view = tree.ancestors(level, 1)
    first, second = view[block_a], view[block_b]
    return first * tree.n_blocks(1) - first * (first + 1) // 2 + second


def leaf_offsets(tree: BlockTree, leaves: LeafSet) -> Index:
    """Return the first value of each leaf, and last the total number of values, int64 (n + 1,)."""
    sizes = leaf_sizes(tree, leaves.level, leaves.block_a, leaves.block_b)
    return np.append(0, np.cumsum(sizes))


def leaf_entries(tree: BlockTree, leaves: LeafSet, rays: Index, channel: int) -> Float:
    """Return entries of the transport that are in leaves, float32 (n,), 0 for all others.

    `rays` are the tree positions of row and column of each entry, (2, n), row before column.
    """
    from scipy.sparse import csr_array

    starts, pair = tree.starts[leaves.level], (leaves.block_a, leaves.block_b)
    count, blocks = tree.n_blocks(leaves.level), tree.block_of_position(leaves.level)[rays]
    number = csr_array((np.arange(1, len(leaves) + 1), pair), shape=(count, count))[*blocks]
    inside = np.flatnonzero(number)
    leaf, values = number[inside] - 1, leaves.values[channel]
    entries = np.zeros(len(number), np.float32)
    if leaves.level == tree.n_levels - 1:
        entries[inside] = values[leaf]
    else:
        first, second, _ = factor_offsets(starts, *pair)
        a, b = (rays - starts[blocks])[:, inside]
        entries[inside] = values[first[leaf] + a] * values[second[leaf] + b]
    return entries


def ragged_ranges(begin: Index, lengths: Index) -> Index:
    """Concatenate the ranges ``begin[i] : begin[i] + lengths[i]``."""
    ends = np.cumsum(lengths)
    return np.arange(int(ends[-1]) if len(ends) else 0) + np.repeat(begin - ends + lengths, lengths)


def runs(lengths: NDArray[np.number[Any]], limit: float) -> Iterator[slice]:
    """Divide items into consecutive runs of a total length of at most `limit`, or of one item."""
    ends = np.cumsum(lengths)
    first = 0
    while first < len(ends):
        start = ends[first] - lengths[first]
        last = max(int(np.searchsorted(ends, start + limit, "right")), first + 1)
        yield slice(first, last)
        first = last


def merge_leaf_sets(leaf_sets: Sequence[LeafSet], tree: BlockTree) -> list[LeafSet]:
    """Merge sets of leaves in any order into sets by level, the coarsest first.

    A level has several sets where one would have more than `_SET_VALUES` values. Leaves are in the
    order of their pairs of views, then of their blocks, so that a view has few runs of leaves.
    """
    merged: list[LeafSet] = []
    for level in sorted({leaves.level for leaves in leaf_sets if len(leaves)}):
        parts = [leaves for leaves in leaf_sets if leaves.level == level and len(leaves)]
        merged += _merge_level(parts, tree)
    return merged


def _merge_level(parts: Sequence[LeafSet], tree: BlockTree) -> Iterator[LeafSet]:
    """Yield the leaves of one level in sets of at most `_SET_VALUES` values, or of one leaf."""
    block_a = np.concatenate([leaves.block_a for leaves in parts])
    block_b = np.concatenate([leaves.block_b for leaves in parts])
    part = np.repeat(np.arange(len(parts)), [len(leaves) for leaves in parts])
    offsets = [leaf_offsets(tree, leaves) for leaves in parts]
    begin = np.concatenate([ends[:-1] for ends in offsets])
    length = np.concatenate([np.diff(ends) for ends in offsets])
    order = np.lexsort((block_b, block_a, pair_of_views(tree, parts[0].level, block_a, block_b)))
    for run in runs(length[order], _SET_VALUES):
        chosen = order[run]
        ends = np.cumsum(length[chosen])
        target = ends - length[chosen]
        values = np.empty((len(parts[0].values), int(ends[-1])), np.float32)
        for index, leaves in enumerate(parts):
            mask = part[chosen] == index
            lengths = length[chosen[mask]]
            factors = leaves.values[:, ragged_ranges(begin[chosen[mask]], lengths)]
            values[:, ragged_ranges(target[mask], lengths)] = factors
        yield LeafSet(parts[0].level, block_a[chosen], block_b[chosen], values)


def pack_leaves(
    tree: BlockTree, leaves: LeafSet, number_format: NumberFormat
) -> dict[str, NDArray[Any]]:
    """Return the arrays of a set of leaves in a store.

    A rounded factor is stored as ``(code / L)^2`` of its maximum, with L = 255 or 65,535. Each leaf
    and channel has a scale: the geometric mean of its two maxima, over ``L^2``. The steps are even
    in the square root: as with shot noise, dim values are rounded less than bright ones, so that a
    glint doesn't hide its surroundings. The maximum is exact to float32, and 0 stays 0.

    Scalars are not rounded, since direct light is among them. Neither are sets with a negative or
    infinite factor, and those whose scales would take more bytes than the rounding saves.

    Returns
    -------
    dict
        With the names `LEAF_PARTS`, or `CODED_PARTS`: ``codes``, unsigned (channels, n_values),
        from the second channel on as differences to the first; ``scales``, float32 (channels, n).
    """
    blocks = {"block_a": leaves.block_a, "block_b": leaves.block_b}
    if leaves.scales is not None:
        if leaves.values.dtype == number_format:
            return {**blocks, "codes": _differences(leaves.values), "scales": leaves.scales}
        leaves = decoded(tree, leaves)
    exact = {**blocks, "values": leaves.values}
    if number_format == "float32" or leaves.level == tree.n_levels - 1:
        return exact
    if not ((leaves.values >= 0) & (leaves.values < np.inf)).all():
        return exact
    dtype = np.dtype(number_format)
    if leaves.values.size * (4 - dtype.itemsize) <= 4 * len(leaves.values) * len(leaves):
        return exact
    starts, largest = tree.starts[leaves.level], np.iinfo(dtype).max
    *sides, size = factor_offsets(starts, leaves.block_a, leaves.block_b)
    begin = np.unique(np.concatenate(sides))
    maxima = np.maximum.reduceat(leaves.values, begin, axis=1).astype(np.float64)
    factors = [np.searchsorted(begin, side) for side in sides]
    mean = np.sqrt(maxima[:, factors[0]]) * np.sqrt(maxima[:, factors[1]])
    for factor in factors:  # codes of a leaf without light are 0
        maxima[:, factor] = np.where(mean > 0, maxima[:, factor], np.inf)
    relative = leaves.values / np.repeat(maxima, np.diff(np.append(begin, size)), axis=1)
    codes = (np.sqrt(relative) * largest + 0.5).astype(dtype)
    scales = (mean / float(largest) ** 2).astype(np.float32)
    return {**blocks, "codes": _differences(codes), "scales": scales}


def unpack_leaves(level: int, arrays: Mapping[str, NDArray[Any]]) -> LeafSet:
    """Build a set of leaves from its arrays in a store, rounded ones as codes."""
    blocks = arrays["block_a"], arrays["block_b"]
    if "values" in arrays:
        return LeafSet(level, *blocks, arrays["values"])
    return LeafSet(level, *blocks, _from_differences(arrays["codes"]), arrays["scales"])


def decoded(tree: BlockTree, leaves: LeafSet) -> LeafSet:
    """Decode the factors of rounded leaves to float32; return other leaves unchanged."""
    if leaves.scales is None:
        return leaves
    values = np.square(leaves.values, dtype=np.float32)
    values *= np.repeat(leaves.scales, np.diff(leaf_offsets(tree, leaves)), axis=1)
    return replace(leaves, values=values, scales=None)


def _differences(codes: NDArray[Any]) -> NDArray[Any]:
    """Replace all channels except the first by differences to it, small ones by small numbers."""
    signed = (codes[1:] - codes[:1]).view(codes.dtype.name.removeprefix("u"))
    folded = (signed << 1) ^ (signed >> (8 * codes.itemsize - 1))
    return np.concatenate([codes[:1], folded.view(codes.dtype)])


def _from_differences(stored: NDArray[Any]) -> NDArray[Any]:
    """Inverse of `_differences`."""
    folded = stored[1:]
    bit = folded.dtype.type(1)
    differences = (folded >> bit) ^ (~(folded & bit) + bit)
    return np.concatenate([stored[:1], differences + stored[:1]])
