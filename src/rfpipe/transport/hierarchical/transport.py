"""Hierarchical tensor of a coaxial rig: rank-1 leaves over pairs of blocks (thesis ch. 4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float
from rfpipe.blocks import BlockTree
from rfpipe.store.arrays import ArrayBundle
from rfpipe.transport.array_transport import CoaxialTransport
from rfpipe.transport.base import Transport
from rfpipe.transport.hierarchical.apply import apply_leaf_sets
from rfpipe.transport.hierarchical.leaves import (
    LeafSet,
    decoded,
    leaf_entries,
    merge_leaf_sets,
    pack_leaves,
)
from rfpipe.transport.hierarchical.stored import RayMasks, StoredLeaves
from rfpipe.transport.hierarchical.truncation import collapse
from rfpipe.transport.lazy import LazySequence
from rfpipe.transport.level_transport import LevelTransport
from rfpipe.units import NumberFormat


class HierarchicalTransport(CoaxialTransport, LevelTransport):
    """Symmetric transport as a hierarchical tensor with rank-1 and scalar leaves.

    The tensor is a sedectree: a node is a pair of blocks of one level, and has up to 16 children.
    Its leaves are a partition of ``T``: each entry is in exactly one leaf, or in none if it is 0.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.Transport`; one shape twice.
    content : sequence of LeafSet
        By level, the coarsest first; rounded or not, in memory or read when used.
    """

    kind = "hierarchical"

    @classmethod
    def from_leaf_sets(
        cls,
        tree: BlockTree,
        channels: int,
        level_rows: list[dict[str, Any]],
        leaf_sets: Sequence[LeafSet],
    ) -> HierarchicalTransport:
        """Build a transport from sets of leaves in any order."""
        merged = merge_leaf_sets(leaf_sets, tree)
        return cls(tree.domain.shape, tree.domain.shape, channels, level_rows, merged)

    @property
    def leaf_sets(self) -> Sequence[LeafSet]:
        """The leaves with float32 factors, by level, the coarsest first."""
        return LazySequence(self._content, lambda leaves: decoded(self.tree, leaves), keep=False)

    @property
    def stored_leaf_sets(self) -> Sequence[LeafSet]:
        """The leaves by level, rounded factors as codes, see `LeafSet`."""
        return self._content

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)`` in image order."""
        return apply_leaf_sets(self.tree, self._content, patterns, channels)

    def _to_arrays(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:
        arrays: dict[str, NDArray[Any]] = {}
        for index, leaves in enumerate(self._content):
            packed = pack_leaves(self.tree, leaves, number_format)
            prefix = f"level_{leaves.level:02d}_{index:04d}"
            arrays |= {f"{prefix}_{part}": array for part, array in packed.items()}
        return arrays

    @classmethod
    def _open(cls, bundle: ArrayBundle, keep: bool) -> Sequence[LeafSet]:
        return StoredLeaves(bundle, keep=keep)

    def restricted(self, camera_rays: Bools, projector_rays: Bools) -> Transport:
        """Return the leaves that connect selected rays, see `Relightable.restricted`."""
        rays = RayMasks(self.tree, camera_rays[self.tree.order], projector_rays[self.tree.order])
        leaf_sets = self._content
        if isinstance(leaf_sets, StoredLeaves):
            return self.with_content(self.level_rows, leaf_sets.connecting(rays))
        return self.with_content(self.level_rows, [rays.select(leaves) for leaves in leaf_sets])

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return each ray under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        pairs = patterns.tocoo()
        # T = T^T; sorted rays have sorted blocks
        rays = np.sort(self.tree.inverse[np.stack([pairs.row, pairs.col])], axis=0)
        entries = sum(leaf_entries(self.tree, leaves, rays, channel) for leaves in self.leaf_sets)
        image = np.bincount(pairs.row, entries * pairs.data, pairs.shape[0])
        return image.astype(np.float32)

    def _truncated(self, level: int) -> Sequence[LeafSet]:
        """Replace the subdivided nodes of `level` by rank-1 leaves."""
        leaf_sets: list[LeafSet] = [*self._content]
        coarser = [leaves for leaves in leaf_sets if leaves.level <= level]
        finer = [leaves for leaves in leaf_sets if leaves.level > level]
        return [*coarser, *collapse(self.tree, finer, level, self.channels)]
