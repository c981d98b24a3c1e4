"""The hierarchical tensor of a coaxial rig: leaves of low rank over pairs of blocks [ch. 4]."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Self

from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.errors import InputError
from rfpipe.transport.base import Float, Transport
from rfpipe.transport.hierarchical.apply import apply_leaf_sets
from rfpipe.transport.hierarchical.codes import (
    CODED_PARTS,
    decoded,
    pack_leaves,
    signed_apart,
    unpack_leaves,
)
from rfpipe.transport.hierarchical.leaves import LEAF_PARTS, LeafSet, merge_leaf_sets
from rfpipe.transport.hierarchical.truncation import collapse, found_later
from rfpipe.transport.stored import Bundle, SetsOnDemand, by_prefix, fits
from rfpipe.units import NumberFormat


class HierarchicalTransport(Transport):
    """Symmetric transport as a hierarchical tensor with rank-1, rank-k and scalar leaves.

    A leaf of rank k is k rank-1 leaves over the same pair of blocks, see `LeafSet`.

    Parameters
    ----------
    shape : tuple of int
        The ray domain that camera and projector share.
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    leaf_sets : sequence of LeafSet
        By level, the coarsest first; may be rounded, and may be read when used.
    nbytes : int, optional
        Bytes on disk; by default the bytes of the leaves.
    """

    kind = "hierarchical"

    def __init__(
        self,
        shape: tuple[int, ...],
        channels: int,
        level_rows: list[dict[str, Any]],
        leaf_sets: Sequence[LeafSet],
        nbytes: int | None = None,
    ) -> None:
        self.camera_shape = self.projector_shape = tuple(shape)
        self.channels = channels
        self._leaf_sets = leaf_sets
        self._rows = level_rows
        self._nbytes = nbytes

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
        return cls(tree.domain.shape, channels, level_rows, merged)

    @cached_property
    def tree(self) -> BlockTree:
        """The block tree of the ray domain."""
        return BlockTree(RayDomain(self.camera_shape))

    @property
    def leaf_sets(self) -> Sequence[LeafSet]:
        """The leaves with float32 factors, by level, the coarsest first."""
        return SetsOnDemand(self._leaf_sets, lambda leaves: decoded(self.tree, leaves), keep=False)

    @property
    def nbytes(self) -> int:
        """Bytes on disk if opened from a store, else of the arrays in memory."""
        if self._nbytes is not None:
            return self._nbytes
        return sum(leaves.nbytes for leaves in self._leaf_sets)

    @property
    def last_level(self) -> int:
        """Finest level that `truncate` tells apart: single rays."""
        return self.tree.n_levels - 1

    @property
    def level_rows(self) -> list[dict[str, Any]]:
        """Per level: patterns, nodes, empty, rank1, scalar, subdivided."""
        return self._rows

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)`` in image order."""
        return apply_leaf_sets(self.tree, self._leaf_sets, patterns, channels)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c``; the transport is symmetric."""
        return self.forward(images, channels)

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the arrays and attributes that a store keeps."""
        attributes = {
            "kind": self.kind,
            "number_format": number_format,
            "shape": list(self.camera_shape),
            "channels": self.channels,
            "levels": self._rows,
        }
        arrays: dict[str, NDArray[Any]] = {}
        alike = (
            part
            for leaves in self._leaf_sets
            for part in signed_apart(self.tree, leaves, number_format)
        )
        for index, leaves in enumerate(alike):
            packed = pack_leaves(self.tree, leaves, number_format)
            prefix = f"level_{leaves.level:02d}_{index:04d}"
            arrays |= {f"{prefix}_{part}": array for part, array in packed.items()}
        return arrays, attributes

    @classmethod
    def unpack(cls, bundle: Bundle, memory_budget: int) -> Self:
        """Build a transport from a store; its leaves are read when first used."""
        about = bundle.attributes
        prefixes = by_prefix(bundle, (*LEAF_PARTS, "signs", *CODED_PARTS))

        def read(prefix: str) -> LeafSet:
            names = prefixes[prefix]
            arrays = {part: bundle.read(name) for part, name in names.items()}
            return unpack_leaves(int(prefix.split("_")[1]), arrays)

        return cls(
            tuple(about["shape"]),
            about["channels"],
            about["levels"],
            SetsOnDemand(list(prefixes), read, keep=fits(bundle, memory_budget)),
            bundle.nbytes_stored,
        )

    def truncate(self, level: int) -> HierarchicalTransport:
        """Return the transport as if the acquisition had stopped after `level` (Fig. 5.7).

        Nodes that were subdivided at `level` become rank-1 leaves again, made of their row and
        column sums, which is what the patterns of that level measured. So do its leaves of rank k
        off the diagonal, which take the images of the level after.
        """
        if not 0 <= level < self.tree.n_levels:
            raise InputError(
                f"level {level} of a transport with levels 0..{self.tree.n_levels - 1}"
            )
        if level == self.tree.n_levels - 1:
            return self
        held = self._leaf_sets
        levels = [leaves.level for leaves in held]
        of_level = [index for index, found in enumerate(levels) if found == level]
        later = found_later(self.tree, SetsOnDemand(of_level, lambda n: held[n], keep=False))
        split = {index: terms for index, terms in zip(of_level, later, strict=True) if terms.any()}
        deeper = [index for index, found in enumerate(levels) if found > level]
        below = SetsOnDemand(
            [*split, *deeper],
            lambda n: held[n].subset(self.tree, split[n]) if n in split else held[n],
            keep=False,
        )
        either: list[int | LeafSet] = [
            *(n for n, found in enumerate(levels) if found <= level and n not in split),
            *(held[n].subset(self.tree, ~terms) for n, terms in split.items()),
            *collapse(self.tree, below, level, self.channels),
        ]
        leaf_sets = SetsOnDemand(
            either, lambda found: held[found] if isinstance(found, int) else found, keep=False
        )
        rows = [row for row in self._rows if row["level"] <= level]
        return type(self)(self.camera_shape, self.channels, rows, leaf_sets)
