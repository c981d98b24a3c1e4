"""The leaves that pass light between some rays, read without the others."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.errors import StoreError
from rfpipe.store.arrays import ArrayBundle
from rfpipe.store.places import Place
from rfpipe.transport.hierarchical.leaves import (
    CODED_PARTS,
    LEAF_PARTS,
    LeafSet,
    leaf_sizes,
    ragged_ranges,
    unpack_leaves,
)
from rfpipe.transport.lazy import LazySequence, names_by_prefix

_BLOCKS = ("block_a", "block_b")
_AT_ONCE = 16  # requests to a server: each waits for the way there and back

Mask = NDArray[np.bool_]


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
        pairs: Mask = (seen[block_a] & lit[block_b]) | (seen[block_b] & lit[block_a])
        return pairs

    def chosen(self, leaves: LeafSet) -> LeafSet:
        """Return the leaves that pass light between the rays."""
        passing = self.pass_light(leaves.level, leaves.block_a, leaves.block_b)
        return leaves.subset(self.tree, passing)


class StoredLeaves(LazySequence[str, LeafSet]):
    """The sets of leaves of a store, read when used, as a whole or in part."""

    def __init__(self, bundle: ArrayBundle, *, keep: bool) -> None:
        self._bundle = bundle
        if any(name.endswith("_signs") for name in bundle.names):
            raise StoreError(f"{bundle.path}: leaves with signs are no longer read; acquire anew")
        self._sets = names_by_prefix(bundle, (*LEAF_PARTS, *CODED_PARTS))
        super().__init__(list(self._sets), self._whole, keep=keep)

    def between(self, rays: Rays) -> Sequence[LeafSet]:
        """Return those of the leaves that pass light between some rays, read when used."""

        def read(index: int) -> LeafSet:
            if index in self.kept:
                return rays.chosen(self.kept[index])
            return self._some(self.keys[index], rays)

        some = LazySequence(range(len(self)), read, keep=self.keep)
        if self.keep and isinstance(self._bundle.path, Place):
            with ThreadPoolExecutor(_AT_ONCE) as pool:
                some.kept |= enumerate(pool.map(read, some.keys))
        return some

    def _whole(self, key: str) -> LeafSet:
        names = self._sets[key]
        arrays = {part: self._bundle.read(name) for part, name in names.items()}
        return unpack_leaves(_level(key), arrays)

    def _some(self, key: str, rays: Rays) -> LeafSet:
        """Read the blocks of a set, and the values of the leaves that pass light."""
        names, level = self._sets[key], _level(key)
        # of a zip behind an address, what is read ahead would depend on the order of the threads
        blocks = [self._bundle.read(names[part], exactly=True) for part in _BLOCKS]
        chosen = np.flatnonzero(rays.pass_light(level, *blocks))
        sizes = leaf_sizes(rays.tree, level, *blocks)
        values = ragged_ranges((np.cumsum(sizes) - sizes)[chosen], sizes[chosen])
        arrays = {part: numbers[chosen] for part, numbers in zip(_BLOCKS, blocks, strict=True)}
        for part in names.keys() - set(_BLOCKS):
            items = values if part in ("values", "codes") else chosen
            arrays[part] = self._bundle.take(names[part], items)
        return unpack_leaves(level, arrays)


def _level(key: str) -> int:
    return int(key.split("_")[1])
