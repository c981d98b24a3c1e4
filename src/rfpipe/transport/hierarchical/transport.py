"""The hierarchical tensor of a coaxial rig: leaves of low rank over pairs of blocks [ch. 4]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.store.arrays import ArrayBundle
from rfpipe.transport.array_transport import CoaxialTransport
from rfpipe.transport.base import Float, Transport
from rfpipe.transport.hierarchical.apply import apply_leaf_sets
from rfpipe.transport.hierarchical.leaves import (
    LeafSet,
    decoded,
    leaf_entries,
    merge_leaf_sets,
    pack_leaves,
)
from rfpipe.transport.hierarchical.stored import Rays, StoredLeaves
from rfpipe.transport.hierarchical.truncation import collapse
from rfpipe.transport.lazy import LazySequence
from rfpipe.transport.level_transport import LevelTransport
from rfpipe.units import NumberFormat


class HierarchicalTransport(CoaxialTransport, LevelTransport):
    """Symmetric transport as a hierarchical tensor with rank-1 and scalar leaves.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.Transport`; one shape twice.
    content : sequence of LeafSet
        By level, the coarsest first; may be rounded, and may be read when used.
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
        """Build a transport from leaf sets in any order."""
        merged = merge_leaf_sets(leaf_sets, tree)
        return cls(tree.domain.shape, tree.domain.shape, channels, level_rows, merged)

    @property
    def leaf_sets(self) -> Sequence[LeafSet]:
        """The leaves with float32 factors, by level, the coarsest first."""
        return LazySequence(self._content, lambda leaves: decoded(self.tree, leaves), keep=False)

    @property
    def stored_leaf_sets(self) -> Sequence[LeafSet]:
        """The leaves as they are held, by level: rounded factors as codes, see `LeafSet`."""
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

    def restricted(self, seen: NDArray[np.bool_], lit: NDArray[np.bool_]) -> Transport:
        """Return the leaves that pass light between some rays, see `Relightable.restricted`."""
        rays = Rays(self.tree, seen[self.tree.order], lit[self.tree.order])
        held = self._content
        if isinstance(held, StoredLeaves):
            return self.with_content(self.level_rows, held.between(rays))
        return self.with_content(self.level_rows, [rays.chosen(leaves) for leaves in held])

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return what each ray sees under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        pairs = patterns.tocoo()
        # T = T^T, and the blocks of rays in order are in order
        rays = np.sort(self.tree.inverse[np.stack([pairs.row, pairs.col])], axis=0)
        entries = sum(leaf_entries(self.tree, each, rays, channel) for each in self.leaf_sets)
        seen = np.bincount(pairs.row, entries * pairs.data, pairs.shape[0])
        return seen.astype(np.float32)

    def _truncated(self, level: int) -> Sequence[LeafSet]:
        """Make leaves of what was subdivided at `level` of the blocks."""
        held: list[LeafSet] = [*self._content]
        kept = [leaves for leaves in held if leaves.level <= level]
        below = [leaves for leaves in held if leaves.level > level]
        return [*kept, *collapse(self.tree, below, level, self.channels)]
