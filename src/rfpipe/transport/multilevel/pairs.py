"""Responses of camera pixels to projector blocks, level by level (thesis §3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.base import Float

PAIR_PARTS = ("block", "pixel", "values")
"""The arrays of a `PairSet`, by which stores name them."""


@dataclass(frozen=True)
class PairSet:
    """Responses of camera pixels to projector blocks of one level, ordered by block, then pixel.

    Attributes
    ----------
    level : int
    block, pixel : ndarray of int32, shape (n,)
        A block of the level and a camera ray (C order); no pair comes twice.
    values : ndarray of float32, shape (channels, n)
        Radiance of the pixel when the whole block is lit.
    """

    level: int
    block: NDArray[np.int32]
    pixel: NDArray[np.int32]
    values: Float

    def __len__(self) -> int:
        return len(self.block)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return self.block.nbytes + self.pixel.nbytes + self.values.nbytes


def no_pairs(level: int, channels: int) -> PairSet:
    """Return an empty set of pairs."""
    none = np.empty(0, np.int32)
    return PairSet(level, none, none, np.empty((channels, 0), np.float32))


def fold(
    tree: BlockTree, level: int, pair_sets: Sequence[PairSet], channels: int, pixels: int
) -> PairSet:
    """Add up pairs of `level` and of finer levels over their blocks of `level`."""
    if not any(len(pairs) for pairs in pair_sets):
        return no_pairs(level, channels)
    key = np.concatenate(
        [
            tree.ancestors(pairs.level, level)[pairs.block] * pixels + pairs.pixel
            for pairs in pair_sets
        ]
    )
    values = np.concatenate([pairs.values for pairs in pair_sets], axis=1)
    kept, index = np.unique(key, return_inverse=True)
    sums = np.stack([np.bincount(index, plane, len(kept)) for plane in values])
    block, pixel = np.divmod(kept, pixels)
    return PairSet(level, block.astype(np.int32), pixel.astype(np.int32), sums.astype(np.float32))
