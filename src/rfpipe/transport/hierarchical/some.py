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
from rfpipe.transport.hierarchical.codes import unpack_leaves
from rfpipe.transport.hierarchical.leaves import (
    LeafSet,
    leaf_offsets,
    leaf_sizes,
    pair_of_views,
)
from rfpipe.transport.stored import SetsOnDemand

__all__ = ["VIEWS_PART", "Rays", "StoredLeaves", "leaves_between", "offsets_of_views"]

VIEWS_PART = "views"
"""Array of a set of leaves of a light field: `offsets_of_views`."""

_AT_ONCE = 16

Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Rays:
    """The rays that see, and those that are lit.

    Attributes
    ----------
    tree : BlockTree
    seen, lit : ndarray of bool, shape (N,)
        In tree order.
    """

    tree: BlockTree
    seen: Mask
    lit: Mask

    def pass_light(self, level: int, block_a: NDArray[Any], block_b: NDArray[Any]) -> Mask:
        """Tell which pairs of blocks have light to pass between them, one way or the other."""
        starts = self.tree.starts[level][:-1]
        seen, lit = (np.logical_or.reduceat(rays, starts) for rays in (self.seen, self.lit))
        found: Mask = (seen[block_a] & lit[block_b]) | (seen[block_b] & lit[block_a])
        return found


class StoredLeaves(SetsOnDemand[str, LeafSet]):
    """The sets of leaves of a store, read when used, as a whole or in part.

    Parameters
    ----------
    bundle : ArrayBundle
    prefixes : dict
        The names of each set's arrays, by set and by part.
    keep : bool
        Whether they stay in memory.
    """

    def __init__(
        self, bundle: ArrayBundle, prefixes: dict[str, dict[str, str]], *, keep: bool
    ) -> None:
        self._bundle, self._prefixes = bundle, prefixes
        super().__init__(list(prefixes), self._whole, keep=keep)

    def between(self, rays: Rays) -> SetsOnDemand[int, LeafSet]:
        """Return those of the leaves that pass light between some rays, read when used."""
        fetched: dict[int, LeafSet] = {}
        is_afar = self.keep and isinstance(self._bundle.path, Place)

        def read(index: int) -> LeafSet:
            whole = self.kept(index)
            return self._some(self.keys[index], rays) if whole is None else _chosen(whole, rays)

        def some(index: int) -> LeafSet:
            if not is_afar:
                return read(index)
            if not fetched:  # all at once: each waits for several requests, one after the other
                with ThreadPoolExecutor(_AT_ONCE) as pool:
                    fetched.update(enumerate(pool.map(read, range(len(self)))))
            return fetched[index]

        return SetsOnDemand(range(len(self)), some, keep=self.keep)

    def _whole(self, prefix: str) -> LeafSet:
        names = self._prefixes[prefix]
        arrays = {
            part: self._bundle.read(name) for part, name in names.items() if part != VIEWS_PART
        }
        return unpack_leaves(_level(prefix), arrays)

    def _some(self, prefix: str, rays: Rays) -> LeafSet:
        """Read some leaves of a set: first their blocks, of views that are asked for."""
        names, level, tree = self._prefixes[prefix], _level(prefix), rays.tree
        if VIEWS_PART in names:
            offsets = self._bundle.read_runs(names[VIEWS_PART], _all(self._pairs(rays) + 1))
            asked = rays.pass_light(1, *np.triu_indices(tree.n_blocks(1)))
            begin, end = offsets[:, :-1][:, asked], offsets[:, 1:][:, asked]
            leaves = np.stack([begin[0], end[0]], axis=1)
            first_values = begin[1]
        else:
            count = self._bundle.shape(names["block_a"])[0]
            leaves, first_values = _all(count), np.zeros(1, np.int64)
        blocks = [self._bundle.read_runs(names[part], leaves) for part in ("block_a", "block_b")]
        sizes = leaf_sizes(tree, level, *blocks)
        lengths = leaves[:, 1] - leaves[:, 0]
        number = _within(leaves[:, 0], lengths, np.ones(len(sizes), np.int64))
        value = _within(first_values, lengths, sizes)
        chosen = rays.pass_light(level, *blocks)
        arrays = {
            part: self._bundle.read_runs(
                name,
                _joined(value[chosen], sizes[chosen])
                if part in ("values", "codes")
                else _joined(number[chosen], np.ones(chosen.sum(), np.int64)),
            )
            for part, name in names.items()
            if part not in ("block_a", "block_b", VIEWS_PART)
        }
        of_chosen = dict(zip(("block_a", "block_b"), (b[chosen] for b in blocks), strict=True))
        return unpack_leaves(level, arrays | of_chosen)

    @staticmethod
    def _pairs(rays: Rays) -> int:
        views = rays.tree.n_blocks(1)
        return views * (views + 1) // 2


def leaves_between(leaf_sets: Sequence[LeafSet], rays: Rays) -> Sequence[LeafSet]:
    """Return those of the leaves that pass light between some rays."""
    if isinstance(leaf_sets, StoredLeaves):
        return leaf_sets.between(rays)
    return [_chosen(leaves, rays) for leaves in leaf_sets]


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


def _chosen(leaves: LeafSet, rays: Rays) -> LeafSet:
    chosen = rays.pass_light(leaves.level, leaves.block_a, leaves.block_b)
    return leaves.subset(rays.tree, chosen)


def _level(prefix: str) -> int:
    return int(prefix.split("_")[1])


def _all(count: int) -> Index:
    return np.array([[0, count]])


def _within(first: Index, lengths: Index, sizes: Index) -> Index:
    """Return where items of runs begin, each behind those of its run before it.

    Parameters
    ----------
    first
        Where each run begins.
    lengths
        Items of each run.
    sizes
        Of the items.
    """
    ends = np.cumsum(sizes)
    before = ends - sizes
    of_run = np.repeat(np.arange(len(first)), lengths)
    begin = np.append(before, ends[-1:] if len(ends) else 0)[np.cumsum(lengths) - lengths]
    found: Index = before - begin[of_run] + first[of_run]
    return found


def _joined(first: Index, sizes: Index) -> Index:
    """Return runs ``(n, 2)``, those that follow on each other as one."""
    if not len(first):
        return np.empty((0, 2), np.int64)
    ends = first + sizes
    apart = np.flatnonzero(first[1:] != ends[:-1])
    return np.stack([first[np.append(0, apart + 1)], ends[np.append(apart, len(ends) - 1)]], axis=1)
