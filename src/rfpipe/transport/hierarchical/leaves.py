"""The leaves of the hierarchical tensor, side by side in flat arrays (thesis §4.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.base import Float
from rfpipe.units import NumberFormat

# A set of leaves that is stored or read at a time has at most this many values a channel, unless
# one leaf has more: some 25 MB of RGB, so that a transport beyond the memory budget streams.
_SET_VALUES = 2**21

LEAF_PARTS = ("block_a", "block_b", "values")
"""The arrays of a `LeafSet`, by which stores name them."""


CODED_PARTS = ("block_a", "block_b", "codes", "scales")
"""The arrays of a rounded `LeafSet`, by which stores name them."""


@dataclass(frozen=True, eq=False)
class LeafSet:
    """Rank-1 leaves of one level: ``T_ab = factor_a x factor_b`` and, by symmetry, ``T_ba``.

    Factors and scalars are light, none of them negative; on the diagonal both factors are the same.

    Attributes
    ----------
    level : int
    block_a, block_b : ndarray of int32, shape (n,)
        ``block_a <= block_b``. At the last level a leaf is a scalar.
    values : ndarray of float32, shape (channels, n_values)
        The factors one leaf after the other: over block a, then over block b unless it is the
        same; one value a scalar. With `scales`, codes of them: uint8 or uint16.
    scales : ndarray of float32, shape (channels, n), optional
        Of rounded leaves: a value is its code squared times its leaf's scale.
    kept : dict
        Preparations that `rfpipe.transport.hierarchical.apply` makes once, by name.
    """

    level: int
    block_a: NDArray[np.int32]
    block_b: NDArray[np.int32]
    values: NDArray[Any]
    scales: Float | None = None
    kept: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        return len(self.block_a)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        scales = 0 if self.scales is None else self.scales.nbytes
        return self.block_a.nbytes + self.block_b.nbytes + self.values.nbytes + scales

    def subset(self, tree: BlockTree, chosen: NDArray[np.bool_]) -> LeafSet:
        """Return some of the leaves."""
        offsets = leaf_offsets(tree, self)
        index = ragged_ranges(offsets[:-1][chosen], np.diff(offsets)[chosen])
        # numpy would leave channels side by side
        values = np.ascontiguousarray(self.values[:, index])
        scales = None if self.scales is None else np.ascontiguousarray(self.scales[:, chosen])
        return LeafSet(self.level, self.block_a[chosen], self.block_b[chosen], values, scales)


def factor_offsets(
    starts: NDArray[np.int64], block_a: NDArray[np.int32], block_b: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Return where each pair's two factors begin, and the number of values of all.

    On the diagonal both factors are the same values.
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
) -> NDArray[np.int64]:
    """Return how many values each leaf has."""
    if level == tree.n_levels - 1:
        return np.ones(len(block_a), np.int64)
    sizes = np.diff(tree.starts[level])
    return sizes[block_a] + np.where(block_a == block_b, 0, sizes[block_b])


def pair_of_views(
    tree: BlockTree, level: int, block_a: NDArray[np.int32], block_b: NDArray[np.int32]
) -> NDArray[np.int64]:
    """Number the pairs of views of pairs of blocks, as ``numpy.triu_indices`` counts them.

    All are 0 where there are no views to tell apart, and of blocks above them.
    """
    if level == 0 or not tree.splits_views(0):
        return np.zeros(len(block_a), np.int64)
    above = tree.ancestors(level, 1)
    first, second = above[block_a], above[block_b]
    return first * tree.n_blocks(1) - first * (first + 1) // 2 + second


def leaf_offsets(tree: BlockTree, leaves: LeafSet) -> NDArray[np.int64]:
    """Return where each leaf's values begin, and the number of values at the end."""
    sizes = leaf_sizes(tree, leaves.level, leaves.block_a, leaves.block_b)
    return np.append(0, np.cumsum(sizes))


def leaf_entries(tree: BlockTree, leaves: LeafSet, rays: NDArray[np.int64], channel: int) -> Float:
    """Return what leaves tell of entries, rows before columns: positions (2, n), float32 (n,)."""
    from scipy.sparse import csr_array

    starts, pair = tree.starts[leaves.level], (leaves.block_a, leaves.block_b)
    count, blocks = tree.n_blocks(leaves.level), tree.block_of_position(leaves.level)[rays]
    number = csr_array((np.arange(1, len(leaves) + 1), pair), shape=(count, count))[*blocks]
    hit = np.flatnonzero(number)
    leaf, values = number[hit] - 1, leaves.values[channel]
    entries = np.zeros(len(number), np.float32)
    if leaves.level == tree.n_levels - 1:
        entries[hit] = values[leaf]
    else:
        first, second, _ = factor_offsets(starts, *pair)
        a, b = (rays - starts[blocks])[:, hit]
        entries[hit] = values[first[leaf] + a] * values[second[leaf] + b]
    return entries


def ragged_ranges(begin: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the indices of runs ``begin[i] : begin[i] + lengths[i]``, one after the other."""
    ends = np.cumsum(lengths)
    return np.arange(int(ends[-1]) if len(ends) else 0) + np.repeat(begin - ends + lengths, lengths)


def runs(lengths: NDArray[np.number[Any]], most: float) -> Iterator[slice]:
    """Cut items into runs, one after the other, of at most `most` in all, or of one item."""
    ends = np.cumsum(lengths)
    first = 0
    while first < len(ends):
        before = ends[first] - lengths[first]
        last = max(int(np.searchsorted(ends, before + most, "right")), first + 1)
        yield slice(first, last)
        first = last


def merge_leaf_sets(leaf_sets: Sequence[LeafSet], tree: BlockTree) -> list[LeafSet]:
    """Return the leaves by level and block, from sets found one after the other.

    A level is one set, or several where it has many values. Leaves of a light field are in the
    order of their pairs of views first, so that those of a view lie in few runs.
    """
    merged: list[LeafSet] = []
    for level in sorted({leaves.level for leaves in leaf_sets if len(leaves)}):
        parts = [leaves for leaves in leaf_sets if leaves.level == level and len(leaves)]
        merged += _merge_level(parts, tree)
    return merged


def _merge_level(parts: Sequence[LeafSet], tree: BlockTree) -> Iterator[LeafSet]:
    """Yield the leaves of one level in order, in sets of at most `_SET_VALUES`, or of one leaf."""
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
            of_leaf = length[chosen[mask]]
            factors = leaves.values[:, ragged_ranges(begin[chosen[mask]], of_leaf)]
            values[:, ragged_ranges(target[mask], of_leaf)] = factors
        yield LeafSet(parts[0].level, block_a[chosen], block_b[chosen], values)


def pack_leaves(
    tree: BlockTree, leaves: LeafSet, number_format: NumberFormat
) -> dict[str, NDArray[Any]]:
    """Return the arrays that a store keeps of a set of leaves.

    A factor is kept as ``(code / L)^2`` of its maximum, with L = 255 or 65,535. Each leaf and
    channel has a scale: the geometric mean of its two maxima, over ``L^2``. The step is even in the
    square root: as with shot noise, dim values are rounded less than bright ones, so that a glint
    doesn't drown its surroundings. A maximum is kept to float32, and what is 0 stays 0.

    Scalars stay as they are, for direct light is among them; so do sets with factors that are
    negative or not finite somewhere, and those of which the scales would take more than the
    rounding saves.

    Returns
    -------
    dict
        By `LEAF_PARTS`; or by `CODED_PARTS`: ``codes``, unsigned (channels, n_values), from the
        second channel on as differences to the first; ``scales``, float32 (channels, n).
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
    places = [np.searchsorted(begin, side) for side in sides]
    mean = np.sqrt(maxima[:, places[0]]) * np.sqrt(maxima[:, places[1]])
    for place in places:  # codes of a leaf that is zero are 0
        maxima[:, place] = np.where(mean > 0, maxima[:, place], np.inf)
    relative = leaves.values / np.repeat(maxima, np.diff(np.append(begin, size)), axis=1)
    codes = (np.sqrt(relative) * largest + 0.5).astype(dtype)
    scales = (mean / float(largest) ** 2).astype(np.float32)
    return {**blocks, "codes": _differences(codes), "scales": scales}


def unpack_leaves(level: int, arrays: Mapping[str, NDArray[Any]]) -> LeafSet:
    """Return the leaves of which a store has kept these arrays, rounded ones as codes."""
    blocks = arrays["block_a"], arrays["block_b"]
    if "values" in arrays:
        return LeafSet(level, *blocks, arrays["values"])
    return LeafSet(level, *blocks, _from_differences(arrays["codes"]), arrays["scales"])


def decoded(tree: BlockTree, leaves: LeafSet) -> LeafSet:
    """Return rounded leaves with float32 factors, others as they are."""
    if leaves.scales is None:
        return leaves
    values = np.square(leaves.values, dtype=np.float32)
    values *= np.repeat(leaves.scales, np.diff(leaf_offsets(tree, leaves)), axis=1)
    return replace(leaves, values=values, scales=None)


def _differences(codes: NDArray[Any]) -> NDArray[Any]:
    """Turn all channels but the first into differences to it, small ones into small numbers."""
    signed = (codes[1:] - codes[:1]).view(codes.dtype.name.removeprefix("u"))
    folded = (signed << 1) ^ (signed >> (8 * codes.itemsize - 1))
    return np.concatenate([codes[:1], folded.view(codes.dtype)])


def _from_differences(stored: NDArray[Any]) -> NDArray[Any]:
    """Undo `_differences`."""
    folded = stored[1:]
    one = folded.dtype.type(1)
    differences = (folded >> one) ^ (~(folded & one) + one)
    return np.concatenate([stored[:1], differences + stored[:1]])
