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
from rfpipe.transport.hierarchical.leaves import (
    CODED_PARTS,
    LEAF_PARTS,
    LeafSet,
    leaf_offsets,
    leaf_sizes,
    pair_of_views,
    ragged_ranges,
    unpack_leaves,
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
        views = np.array([[0, self._bundle.shape(names["block_a"])[0]], [0, 0]])
        asked = np.ones(1, np.bool_)
        if VIEWS_PART in names:
            views = self._bundle.read(names[VIEWS_PART])
            asked = rays.pass_light(1, *np.triu_indices(tree.n_blocks(1)))
        first, first_value = views[:, :-1][:, asked]
        lengths = np.diff(views[0])[asked]
        of_leaf = ragged_ranges(first, lengths)
        blocks = [self._bundle.take(names[part], of_leaf) for part in _BLOCKS]
        chosen = rays.pass_light(level, *blocks)
        sizes = leaf_sizes(tree, level, *blocks)
        # values of a pair of views lie one leaf behind the other
        before = np.cumsum(sizes) - sizes
        ends = np.cumsum(lengths)
        of_views = np.append(0, np.cumsum(sizes))[ends - lengths]
        begin = before + np.repeat(first_value - of_views, lengths)
        of_values = ragged_ranges(begin[chosen], sizes[chosen])
        arrays = dict(zip(_BLOCKS, (found[chosen] for found in blocks), strict=True))
        for part in names.keys() - {*_BLOCKS, VIEWS_PART}:
            items = of_values if part in ("values", "codes") else of_leaf[chosen]
            arrays[part] = self._bundle.take(names[part], items)
        return unpack_leaves(level, arrays)


def leaves_between(leaf_sets: Sequence[LeafSet], rays: Rays) -> Sequence[LeafSet]:
    """Return those of the leaves that pass light between some rays."""
    if isinstance(leaf_sets, StoredLeaves):
        return leaf_sets.between(rays)
    return [rays.chosen(leaves) for leaves in leaf_sets]


def offsets_of_views(tree: BlockTree, leaves: LeafSet) -> Index:
    """Return where the leaves, and their values, of each pair of views begin, int64 (2, pairs + 1).

    Leaves are sorted by pair, in the order of ``numpy.triu_indices(V)``.
    """
    views = tree.n_blocks(1)
    pairs = np.arange(views * (views + 1) // 2 + 1)
    of_leaf = pair_of_views(tree, leaves.level, leaves.block_a, leaves.block_b)
    first = np.searchsorted(of_leaf, pairs)
    return np.stack([first, leaf_offsets(tree, leaves)[first]])


def _level(key: str) -> int:
    return int(key.split("_")[1])
