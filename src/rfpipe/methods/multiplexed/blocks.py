"""Blocks of the projector that may light each camera pixel: an adaptive subdivision for each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Blocks, Bools, Float, Index
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.transport.hierarchical.leaves import ragged_ranges
from rfpipe.transport.responses import Responses

FEWEST_BLOCKS = 16
"""Least number of blocks of a level."""


class BlockLevels:
    """Levels of a block tree whose blocks are lit, with one numbering of all their blocks.

    Parameters
    ----------
    projector : RayDomain

    Attributes
    ----------
    tree : BlockTree
    levels : tuple of int
        Levels of the tree from at least 16 blocks on, without the last but one, and the single
        rays. Blocks of the last level but one have at most four rays: to determine these blocks
        first takes more patterns than it saves.
    offsets : ndarray of int64, shape (levels + 1,)
        Number of the first block of each of the levels, and of all blocks.
    """

    def __init__(self, projector: RayDomain) -> None:
        self.tree = BlockTree(projector)
        last = self.tree.n_levels - 1
        coarse = [level for level in range(last - 1) if self.tree.n_blocks(level) >= FEWEST_BLOCKS]
        self.levels = (*coarse, last)
        counts = [self.tree.n_blocks(level) for level in self.levels]
        self.offsets: Index = np.cumsum([0, *counts])

    def __len__(self) -> int:
        return len(self.levels)

    def means(self, patterns: NDArray[Any]) -> Float:
        """Average patterns (P, N) over each block, (P, blocks)."""
        in_order = patterns.reshape(len(patterns), -1)[:, self.tree.order].astype(np.float32)
        parts = []
        for level in self.levels:
            starts = self.tree.starts[level]
            sums = np.add.reduceat(in_order, starts[:-1], axis=1)
            parts.append(sums / np.diff(starts).astype(np.float32))
        return np.concatenate(parts, axis=1)

    @cached_property
    def children(self) -> Index:
        """First child of each block that isn't a single ray, and the end of the last one's.

        The children of block b are ``children[b]:children[b + 1]``.
        """
        starts = self.tree.starts
        first = [
            np.searchsorted(starts[fine], starts[coarse][:-1]) + offset
            for coarse, fine, offset in zip(
                self.levels[:-1], self.levels[1:], self.offsets[1:-1], strict=True
            )
        ]
        return np.concatenate([*first, self.offsets[-1:]])

    def patterns(self, index: int, lit: Bools) -> Float:
        """Return the patterns (P, *shape) that light the blocks `lit` (P, blocks) of a level."""
        labels = self.tree.labels(self.levels[index])
        return lit[:, labels].astype(np.float32)


@lru_cache(maxsize=2)
def block_levels(projector: RayDomain) -> BlockLevels:
    """Return the levels of a projector, which forecasts and each round need."""
    return BlockLevels(projector)


@dataclass(frozen=True)
class PixelBlocks:
    """Light that camera pixels receive from blocks of several levels, a sparse matrix by pixel.

    The blocks of a pixel don't overlap.

    Attributes
    ----------
    starts : ndarray of int64, shape (M + 1,)
        First entry of each pixel, and the number of entries.
    block : ndarray of int32, shape (n,)
        Number of a block, see `BlockLevels`.
    expected : ndarray of float32, shape (n,)
        Expected light, by the fit to the coarser blocks, summed over the channels, radiance.
    light : ndarray of float32, shape (C, n)
        Fitted radiance of the pixel when the whole block is lit, at least 0.
    """

    starts: Index
    block: Blocks
    expected: Float
    light: Float

    @property
    def pixel(self) -> Index:
        """Camera pixel of each entry, (n,)."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    @classmethod
    def coarsest(cls, levels: BlockLevels, floodlit: Float, is_lit: Bools) -> PixelBlocks:
        """Return all blocks of the coarsest level for the lit pixels.

        `floodlit` is the floodlit image (C, M); its light is distributed evenly.
        """
        count = int(levels.offsets[1])
        starts = np.concatenate([[0], np.cumsum(np.where(is_lit, count, 0))])
        block = np.tile(np.arange(count, dtype=np.int32), np.count_nonzero(is_lit))
        light = np.repeat(floodlit[:, is_lit] / np.float32(count), count, axis=1)
        expected = light.sum(axis=0) * np.float32(np.sqrt(count))
        return cls(starts, block, expected, light)

    def subdivided(self, levels: BlockLevels, finest: int, thresholds: Float) -> PixelBlocks:
        """Replace bright blocks by their children of the next level.

        Parameters
        ----------
        levels : BlockLevels
        finest : int
            Index of the finest level of the children in `BlockLevels.levels`.
        thresholds : ndarray of float32, shape (M,)
            Radiance, summed over the channels, above which a pixel's block is subdivided.
        """
        grey = self.light.sum(axis=0)
        is_open = (grey > thresholds[self.pixel]) & (self.block < levels.offsets[finest])
        begin, counts = self.block.astype(np.int64), np.ones(len(self.block), np.int64)
        children = levels.children
        begin[is_open] = children[self.block[is_open]]
        counts[is_open] = children[self.block[is_open] + 1] - children[self.block[is_open]]
        ends = np.concatenate([[0], np.cumsum(counts)])
        expected = np.where(is_open, grey / np.sqrt(counts.astype(np.float32)), self.expected)
        return PixelBlocks(
            ends[self.starts],
            ragged_ranges(begin, counts).astype(np.int32),
            np.repeat(expected, counts),
            np.repeat(self.light / counts.astype(np.float32), counts, axis=1),
        )

    def responses(self, levels: BlockLevels) -> list[Responses]:
        """Return the entries with light as responses of each level, by block and pixel."""
        pixel, parts = self.pixel, []
        bounds = zip(levels.levels, levels.offsets[:-1], levels.offsets[1:], strict=True)
        for level, first, last in bounds:
            chosen = (first <= self.block) & (self.block < last) & self.light.any(axis=0)
            block, pixels = self.block[chosen] - first, pixel[chosen]
            order = np.lexsort((pixels, block))
            parts.append(
                Responses(
                    level,
                    block[order].astype(np.int32),
                    pixels[order].astype(np.int32),
                    np.ascontiguousarray(self.light[:, chosen][:, order]),
                )
            )
        return parts
