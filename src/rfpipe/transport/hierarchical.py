"""The hierarchical tensor of a coaxial rig: rank-1 leaves over pairs of blocks (thesis ch. 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.errors import InputError
from rfpipe.transport.base import Float, Transport

# Leaves are summed in this many shares whatever the machine, so that results are the same
# everywhere; enough to keep a dozen cores busy.
_SHARES = 16
# Patterns relit together: a leaf's factors are read once for all of them.
_BATCH = 16


LEAF_PARTS = ("block_a", "block_b", "values")
"""The arrays of a `LeafSet`, by which stores name them."""


@dataclass(frozen=True)
class LeafSet:
    """Rank-1 leaves of one level: ``T_ab = factor_a x factor_b`` and, by symmetry, ``T_ba``.

    Attributes
    ----------
    level : int
    block_a, block_b : ndarray of int32, shape (n,)
        ``block_a <= block_b``. At the last level a leaf is a scalar.
    values : ndarray of float32, shape (channels, n_values)
        The factors one leaf after the other: over block a, then over block b unless it is the
        same; one value a scalar.
    """

    level: int
    block_a: NDArray[np.int32]
    block_b: NDArray[np.int32]
    values: Float

    def __len__(self) -> int:
        return len(self.block_a)


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


def ragged_ranges(begin: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the indices of runs ``begin[i] : begin[i] + lengths[i]``, one after the other."""
    ends = np.cumsum(lengths)
    return np.arange(int(ends[-1]) if len(ends) else 0) + np.repeat(begin - ends + lengths, lengths)


def _shares(work: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut items into runs of about equal work."""
    total = np.cumsum(work)
    aims = np.arange(1, _SHARES) * (total[-1] / _SHARES) if len(total) else np.zeros(_SHARES - 1)
    inner = np.searchsorted(total, aims)
    return np.concatenate([[0], inner, [len(work)]]).astype(np.int64)


def apply_leaf_sets(
    tree: BlockTree, leaf_sets: Sequence[LeafSet], patterns: Float, channels: Sequence[int]
) -> Float:
    """Return what the leaves make of patterns, all in tree order.

    Parameters
    ----------
    tree : BlockTree
    leaf_sets : sequence of LeafSet
    patterns : ndarray of float32, shape (P, K, N)
        One plane for each of `channels`.
    channels : sequence of int
        Which channels of the leaves to use.

    Returns
    -------
    ndarray of float32, shape (P, K, N)
    """
    result = np.zeros(patterns.shape, np.float32)
    filled = [leaves for leaves in leaf_sets if len(leaves)]
    if not filled or not patterns.size:
        return result
    from rfpipe.transport import kernels

    chosen = list(channels)
    for first in range(0, len(patterns), _BATCH):
        part = np.ascontiguousarray(patterns[first : first + _BATCH])
        sums = np.zeros((_SHARES, *part.shape), np.float32)
        for leaves in filled:
            every = chosen == list(range(len(leaves.values)))
            values = leaves.values if every else np.ascontiguousarray(leaves.values[chosen])
            if leaves.level == tree.n_levels - 1:
                bounds = _shares(np.ones(len(leaves), np.int64))
                kernels.apply_scalars(leaves.block_a, leaves.block_b, values, bounds, part, sums)
            else:
                starts = tree.starts[leaves.level]
                offset_a, offset_b, _ = factor_offsets(starts, leaves.block_a, leaves.block_b)
                sizes = np.diff(starts)
                bounds = _shares(sizes[leaves.block_a] + sizes[leaves.block_b])
                kernels.apply_leaves(
                    starts, leaves.block_a, leaves.block_b, offset_a, offset_b,
                    values, bounds, part, sums,
                )  # fmt: skip
        result[first : first + _BATCH] = sums.sum(axis=0)
    return result


def merge_leaf_sets(leaf_sets: Sequence[LeafSet], tree: BlockTree) -> list[LeafSet]:
    """Return one leaf set a level, ordered by block, from sets found one after the other."""
    merged = []
    for level in sorted({leaves.level for leaves in leaf_sets if len(leaves)}):
        parts = [leaves for leaves in leaf_sets if leaves.level == level and len(leaves)]
        if len(parts) == 1:
            merged.append(parts[0])
            continue
        block_a = np.concatenate([leaves.block_a for leaves in parts])
        block_b = np.concatenate([leaves.block_b for leaves in parts])
        values = np.concatenate([leaves.values for leaves in parts], axis=1)
        order = np.lexsort((block_b, block_a))
        if level < tree.n_levels - 1:
            first, _, _ = factor_offsets(tree.starts[level], block_a, block_b)
            length = np.diff(np.append(first, values.shape[1]))
            values = values[:, ragged_ranges(first[order], length[order])]
        else:
            values = values[:, order]
        merged.append(LeafSet(level, block_a[order], block_b[order], np.ascontiguousarray(values)))
    return merged


class HierarchicalTransport(Transport):
    """Symmetric transport as a hierarchical tensor with rank-1 and scalar leaves.

    Parameters
    ----------
    shape : tuple of int
        The ray domain that camera and projector share.
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    arrays : mapping of str to ndarray
        ``level_{l:02d}_block_a``, ``..._block_b``, ``..._values`` of each level that has leaves;
        may be read lazily.
    nbytes : int, optional
        Bytes on disk; by default the bytes of the arrays.
    """

    kind = "hierarchical"

    def __init__(
        self,
        shape: tuple[int, ...],
        channels: int,
        level_rows: list[dict[str, Any]],
        arrays: Mapping[str, NDArray[Any]],
        nbytes: int | None = None,
    ) -> None:
        self.camera_shape = self.projector_shape = tuple(shape)
        self.channels = channels
        self._rows = level_rows
        self._arrays = arrays
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
        arrays: dict[str, NDArray[Any]] = {}
        for leaves in merge_leaf_sets(leaf_sets, tree):
            prefix = f"level_{leaves.level:02d}"
            arrays |= {f"{prefix}_{part}": getattr(leaves, part) for part in LEAF_PARTS}
        return cls(tree.domain.shape, channels, level_rows, arrays)

    @cached_property
    def tree(self) -> BlockTree:
        """The block tree of the ray domain."""
        return BlockTree(RayDomain(self.camera_shape))

    @cached_property
    def leaf_sets(self) -> list[LeafSet]:
        """The leaves, one set a level, coarsest first."""
        levels = sorted({int(name.split("_")[1]) for name in self._arrays})
        return [
            LeafSet(level, *(self._arrays[f"level_{level:02d}_{part}"] for part in LEAF_PARTS))
            for level in levels
        ]

    @property
    def nbytes(self) -> int:
        """Bytes on disk if opened from a store, else of the arrays in memory."""
        if self._nbytes is not None:
            return self._nbytes
        return sum(self._arrays[name].nbytes for name in self._arrays)

    @property
    def level_rows(self) -> list[dict[str, Any]]:
        """Per level: patterns, nodes, empty, rank1, scalar, subdivided."""
        return self._rows

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)`` in image order."""
        ordered = np.ascontiguousarray(patterns[..., self.tree.order])
        return apply_leaf_sets(self.tree, self.leaf_sets, ordered, channels)[..., self.tree.inverse]

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c``; the transport is symmetric."""
        return self.forward(images, channels)

    def pack(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the arrays and attributes that a store keeps."""
        attributes = {
            "kind": self.kind,
            "shape": list(self.camera_shape),
            "channels": self.channels,
            "levels": self._rows,
        }
        return {name: self._arrays[name] for name in self._arrays}, attributes

    @classmethod
    def unpack(
        cls, arrays: Mapping[str, NDArray[Any]], attributes: Mapping[str, Any], nbytes: int | None
    ) -> HierarchicalTransport:
        """Build a transport from a store's arrays and attributes."""
        shape = tuple(attributes["shape"])
        return cls(shape, attributes["channels"], attributes["levels"], arrays, nbytes)

    def truncate(self, level: int) -> HierarchicalTransport:
        """Return the transport as if the acquisition had stopped after `level` (Fig. 5.7).

        Nodes that were subdivided at `level` become rank-1 leaves again, made of their row and
        column sums, which is what the patterns of that level measured.
        """
        if not 0 <= level < self.tree.n_levels:
            raise InputError(
                f"level {level} of a transport with levels 0..{self.tree.n_levels - 1}"
            )
        kept = [leaves for leaves in self.leaf_sets if leaves.level <= level]
        deeper = [leaves for leaves in self.leaf_sets if leaves.level > level]
        if deeper:
            kept.append(_collapse(self.tree, deeper, level, self.channels))
        rows = [row for row in self._rows if row["level"] <= level]
        return self.from_leaf_sets(self.tree, self.channels, rows, kept)


def _collapse(tree: BlockTree, leaf_sets: Sequence[LeafSet], level: int, channels: int) -> LeafSet:
    """Sum leaves below `level` into rank-1 leaves of that level."""
    from rfpipe.transport import kernels

    n_blocks = tree.n_blocks(level)
    keys = []
    for leaves in leaf_sets:
        above = tree.ancestors(leaves.level, level)
        keys.append(above[leaves.block_a] * n_blocks + above[leaves.block_b])
    nodes = np.unique(np.concatenate(keys))
    block_a = (nodes // n_blocks).astype(np.int32)
    block_b = (nodes % n_blocks).astype(np.int32)
    starts = tree.starts[level]
    offset_a, offset_b, n_values = factor_offsets(starts, block_a, block_b)
    marginals = np.zeros((channels, n_values))
    first_a, first_b = offset_a - starts[block_a], offset_b - starts[block_b]
    for leaves, key in zip(leaf_sets, keys, strict=True):
        own_starts = tree.starts[leaves.level]
        leaf_a, leaf_b, values = leaves.block_a, leaves.block_b, leaves.values
        if leaves.level == tree.n_levels - 1:
            # A scalar is the leaf x * 1: give it a second factor of one.
            ones = np.ones_like(values)
            values = np.stack([values, ones], axis=2).reshape(channels, -1)
            own_a = 2 * np.arange(len(leaves), dtype=np.int64)
            own_b = own_a + 1
        else:
            own_a, own_b, _ = factor_offsets(own_starts, leaf_a, leaf_b)
        node = np.searchsorted(nodes, key)
        kernels.add_marginals(
            own_starts, leaf_a, leaf_b, own_a, own_b, values, node, first_a, first_b, marginals
        )
    sizes = np.diff(starts)
    over_a = marginals[:, ragged_ranges(offset_a, sizes[block_a])]
    boundaries = np.cumsum(sizes[block_a]) - sizes[block_a]
    total = np.add.reduceat(over_a, boundaries, axis=1)
    lengths = np.where(block_a == block_b, sizes[block_a], sizes[block_a] + sizes[block_b])
    per_value = np.repeat(np.maximum(total, 0.0), lengths, axis=1)
    root = np.sqrt(per_value, where=per_value > 0, out=np.ones_like(per_value))
    values = np.where(per_value > 0, marginals / root, 0.0).astype(np.float32)
    return LeafSet(level, block_a, block_b, values)
