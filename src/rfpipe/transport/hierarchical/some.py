"""The leaves that pass light between some rays, read without the others."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.store.arrays import ArrayBundle
from rfpipe.store.places import Place
from rfpipe.transport.arrays import SetsOnDemand, by_prefix
from rfpipe.transport.hierarchical.codes import CODED_PARTS, unpack_leaves
from rfpipe.transport.hierarchical.leaves import (
    LEAF_PARTS,
    LeafSet,
    leaf_offsets,
    leaf_sizes,
    pair_of_views,
)

VIEWS_PART = "views"
"""Array of a set of leaves of a light field: `offsets_of_views`."""

_BLOCKS = ("block_a", "block_b")
_AT_ONCE = 16  # requests to a server: each waits for the way there and back

Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Rays:
    """The rays that see, and those that are lit, bool (N,) in tree order."""

    tree: BlockTree
    seen: Mask
    lit: Mask

    def pass_light(self, level: int, block_a: NDArray[Any], block_b: NDArray[Any]) -> Mask:
        """Return which pairs of blocks have light to pass between them, one way or the other."""
        starts = self.tree.starts[level][:-1]
        seen, lit = (np.logical_or.reduceat(rays, starts) for rays in (self.seen, self.lit))
        found: Mask = (seen[block_a] & lit[block_b]) | (seen[block_b] & lit[block_a])
        return found

    def chosen(self, leaves: LeafSet) -> LeafSet:
        """Return the leaves that pass light between the rays."""
        passing = self.pass_light(leaves.level, leaves.block_a, leaves.block_b)
        return leaves.subset(self.tree, passing)


class StoredLeaves(SetsOnDemand[str, LeafSet]):
    """The sets of leaves of a store, read when used, as a whole or in part."""

    def __init__(self, bundle: ArrayBundle, *, keep: bool) -> None:
        self._bundle = bundle
        self._sets = by_prefix(bundle, (*LEAF_PARTS, "signs", *CODED_PARTS, VIEWS_PART))
        super().__init__(list(self._sets), self._whole, keep=keep)

    def between(self, rays: Rays) -> Sequence[LeafSet]:
        """Return those of the leaves that pass light between some rays, read when used."""

        def read(index: int) -> LeafSet:
            if index in self.kept:
                return rays.chosen(self.kept[index])
            return self._some(self.keys[index], rays)

        some = SetsOnDemand(range(len(self)), read, keep=self.keep)
        if self.keep and isinstance(self._bundle.path, Place):
            with ThreadPoolExecutor(_AT_ONCE) as pool:
                some.kept |= enumerate(pool.map(read, some.keys))
        return some

    def _whole(self, key: str) -> LeafSet:
        names = self._sets[key]
        arrays = {part: self._bundle.read(names[part]) for part in names if part != VIEWS_PART}
        return unpack_leaves(_level(key), arrays)

    def _some(self, key: str, rays: Rays) -> LeafSet:
        """Read some leaves of a set: first the blocks of the views that are asked for."""
        names, level, tree = self._sets[key], _level(key), rays.tree
        leaves = np.array([[0, self._bundle.shape(names["block_a"])[0]]])
        first_values = np.zeros(1, np.int64)
        if VIEWS_PART in names:
            offsets = self._bundle.read(names[VIEWS_PART])
            asked = rays.pass_light(1, *np.triu_indices(tree.n_blocks(1)))
            leaves = np.stack([offsets[0, :-1], offsets[0, 1:]], axis=1)[asked]
            first_values = offsets[1, :-1][asked]
        blocks = [self._bundle.read_runs(names[part], leaves) for part in _BLOCKS]
        sizes = leaf_sizes(tree, level, *blocks)
        ones = np.ones_like(sizes)
        chosen = rays.pass_light(level, *blocks)
        lengths = leaves[:, 1] - leaves[:, 0]
        of_leaf = _joined(_within(leaves[:, 0], lengths, ones)[chosen], ones[chosen])
        of_values = _joined(_within(first_values, lengths, sizes)[chosen], sizes[chosen])
        arrays = dict(zip(_BLOCKS, (found[chosen] for found in blocks), strict=True))
        for part in names.keys() - {*_BLOCKS, VIEWS_PART}:
            runs = of_values if part in ("values", "codes") else of_leaf
            arrays[part] = self._bundle.read_runs(names[part], runs)
        return unpack_leaves(level, arrays)


def leaves_between(leaf_sets: Sequence[LeafSet], rays: Rays) -> Sequence[LeafSet]:
    """Return those of the leaves that pass light between some rays."""
    if isinstance(leaf_sets, StoredLeaves):
        return leaf_sets.between(rays)
    return [rays.chosen(leaves) for leaves in leaf_sets]


def offsets_of_views(tree: BlockTree, leaves: LeafSet) -> Index:
    """Return where the leaves, and their values, of each pair of views begin.

    Returns
    -------
    ndarray of int64, shape (2, V (V + 1) / 2 + 1)
        Of leaves sorted by pair, in the order of ``numpy.triu_indices(V)``; at the end their
        numbers.
    """
    views = tree.n_blocks(1)
    pairs = np.arange(views * (views + 1) // 2 + 1)
    of_leaf = pair_of_views(tree, leaves.level, leaves.block_a, leaves.block_b)
    first = np.searchsorted(of_leaf, pairs)
    return np.stack([first, leaf_offsets(tree, leaves)[first]])


def _level(key: str) -> int:
    return int(key.split("_")[1])


def _within(first: Index, lengths: Index, sizes: Index) -> Index:
    """Return where items begin of runs that begin at `first`, one behind the other in each."""
    before = np.append(0, np.cumsum(sizes))
    begin = before[np.cumsum(lengths) - lengths]
    found: Index = before[:-1] + np.repeat(first - begin, lengths)
    return found


def _joined(first: Index, sizes: Index) -> Index:
    """Return runs ``(n, 2)``, those that follow on each other as one."""
    if not len(first):
        return np.empty((0, 2), np.int64)
    ends = first + sizes
    apart = np.flatnonzero(first[1:] != ends[:-1])
    return np.stack([first[np.append(0, apart + 1)], ends[np.append(apart, len(ends) - 1)]], axis=1)
