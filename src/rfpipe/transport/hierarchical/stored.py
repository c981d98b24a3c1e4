"""Leaves in a store, read as a whole or only those between some rays."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools
from rfpipe.blocks import BlockTree
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
_REQUESTS = 16  # to a server at the same time, each of which waits for its answer


@dataclass(frozen=True)
class RayMasks:
    """Selected camera rays and projector rays, bool (N,) in tree order."""

    tree: BlockTree
    camera: Bools
    projector: Bools

    def connected(self, level: int, block_a: NDArray[Any], block_b: NDArray[Any]) -> Bools:
        """Test which pairs of blocks have a camera ray in one and a projector ray in the other."""
        starts = self.tree.starts[level][:-1]
        camera = np.logical_or.reduceat(self.camera, starts)
        projector = np.logical_or.reduceat(self.projector, starts)
        pairs: Bools = (camera[block_a] & projector[block_b]) | (
            camera[block_b] & projector[block_a]
        )
        return pairs

    def select(self, leaves: LeafSet) -> LeafSet:
        """Return the leaves that connect selected rays."""
        connected = self.connected(leaves.level, leaves.block_a, leaves.block_b)
        return leaves.subset(self.tree, connected)


class StoredLeaves(LazySequence[str, LeafSet]):
    """Sets of leaves of a store, read when they are used.

    Parameters
    ----------
    bundle : ArrayBundle
    keep : bool
        Whether the sets stay in memory.
    """

    def __init__(self, bundle: ArrayBundle, *, keep: bool) -> None:
        self._bundle = bundle
        self._sets = names_by_prefix(bundle, (*LEAF_PARTS, *CODED_PARTS))
        super().__init__(list(self._sets), self._read_set, keep=keep)

    def connecting(self, rays: RayMasks) -> Sequence[LeafSet]:
        """Return the leaves that connect selected rays, read when they are used."""

        def read(index: int) -> LeafSet:
            if index in self.kept:
                return rays.select(self.kept[index])
            return self._read_connecting(self.keys[index], rays)

        leaf_sets = LazySequence(range(len(self)), read, keep=self.keep)
        if self.keep and isinstance(self._bundle.path, Place):
            with ThreadPoolExecutor(_REQUESTS) as pool:
                leaf_sets.kept |= enumerate(pool.map(read, leaf_sets.keys))
        return leaf_sets

    def _read_set(self, key: str) -> LeafSet:
        names = self._sets[key]
        arrays = {part: self._bundle.read(name) for part, name in names.items()}
        return unpack_leaves(_level(key), arrays)

    def _read_connecting(self, key: str, rays: RayMasks) -> LeafSet:
        """Read the blocks of a set, and the values of the leaves that connect rays."""
        names, level = self._sets[key], _level(key)
        # exactly: the read-ahead of a zip file on a server would depend on the order of the threads
        blocks = [self._bundle.read(names[part], exactly=True) for part in _BLOCKS]
        chosen = np.flatnonzero(rays.connected(level, *blocks))
        sizes = leaf_sizes(rays.tree, level, *blocks)
        values = ragged_ranges((np.cumsum(sizes) - sizes)[chosen], sizes[chosen])
        arrays = {part: numbers[chosen] for part, numbers in zip(_BLOCKS, blocks, strict=True)}
        for part in names.keys() - set(_BLOCKS):
            items = values if part in ("values", "codes") else chosen
            arrays[part] = self._bundle.take(names[part], items)
        return unpack_leaves(level, arrays)


def _level(key: str) -> int:
    return int(key.split("_")[1])
