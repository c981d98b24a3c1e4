"""Responses of camera pixels to projector blocks, level by level, and how they are spread [§3.2].

A pixel i's response to a block b says nothing of the rays in b. Where ``T = T^T`` [eq. 2.10] the
pixels of b do, in their responses to the block a of the same level that i lies in: ``T_ij`` is
taken to be in proportion to what pixel j sees of a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.transport.base import Float
from rfpipe.transport.hierarchical.leaves import ragged_ranges

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Double = NDArray[np.float64]

# Coaxial rigs' transposes differed by 0.01 to 0.08 of their norm, those of unrelated random ones by
# 0.7.
_LEAST_DIFFERENCE = 0.5

RESPONSE_ARRAYS = ("block", "pixel", "values")
"""The arrays of a `Responses`, by which stores name them."""


@dataclass(frozen=True)
class Responses:
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


def by_level(level_responses: Sequence[Responses]) -> list[Responses]:
    """Return the sets that aren't empty, the coarsest first."""
    return sorted(filter(len, level_responses), key=lambda pairs: pairs.level)


def no_responses(level: int, channels: int) -> Responses:
    """Return an empty set of pairs."""
    none = np.empty(0, np.int32)
    return Responses(level, none, none, np.empty((channels, 0), np.float32))


def fold(
    tree: BlockTree, level: int, level_responses: Sequence[Responses], channels: int, pixels: int
) -> Responses:
    """Add up pairs of `level` and of finer levels over their blocks of `level`."""
    if not any(len(pairs) for pairs in level_responses):
        return no_responses(level, channels)
    keys = [
        tree.ancestors(pairs.level, level)[pairs.block] * pixels + pairs.pixel
        for pairs in level_responses
    ]
    values = np.concatenate([pairs.values for pairs in level_responses], axis=1)
    kept, sums = _summed(np.concatenate(keys), values)
    block, pixel = np.divmod(kept, pixels)
    return Responses(level, block.astype(np.int32), pixel.astype(np.int32), sums.astype(np.float32))


def _summed(keys: NDArray[np.int64], values: Float) -> tuple[NDArray[np.int64], Double]:
    """Return the keys that there are, ascending, and the sums (C, keys) of their values."""
    kept, index = np.unique(keys, return_inverse=True)
    return kept, np.stack([np.bincount(index, plane, len(kept)) for plane in values])


@dataclass(frozen=True)
class Spread:
    """Shares of rays in the nodes that the pairs of a level belong to.

    Attributes
    ----------
    node : ndarray of int32, shape (n,)
        Each pair's row of the shares.
    shares : list of csr_array, each (nodes, N)
        One a channel, or one for all: rows add up to 1; columns are rays in tree order.
    """

    node: NDArray[np.int32]
    shares: list[csr_array]

    def of(self, channels: Sequence[int]) -> list[csr_array]:
        """Return the shares of some channels."""
        return [self.shares[channel % len(self.shares)] for channel in channels]


def spread_evenly(tree: BlockTree, pairs: Responses) -> Spread:
    """Spread each response evenly over its block [eq. 3.2]."""
    from scipy.sparse import csr_array

    starts = tree.starts[pairs.level]
    sizes = np.diff(starts)
    shares = np.repeat(1.0 / sizes, sizes)
    rays = np.arange(tree.domain.size)
    return Spread(pairs.block, [csr_array((shares, rays, starts), (len(sizes), len(rays)))])


def spread_by_transpose(
    tree: BlockTree, level_responses: Sequence[Responses], index: int
) -> Spread:
    """Spread the responses of the set `index` in proportion to the transpose's estimate.

    The tree is that of both the camera's and the projector's rays.
    """
    from scipy.sparse import csr_array

    pairs = level_responses[index]
    starts, level = tree.starts[pairs.level], pairs.level
    blocks, pixels, channels = tree.n_blocks(level), tree.domain.size, len(pairs.values)
    block_of_pixel = tree.labels(level).ravel().astype(np.int64)
    nodes, node = np.unique(
        pairs.block * np.int64(blocks) + block_of_pixel[pairs.pixel], return_inverse=True
    )
    source, viewer = np.divmod(nodes, blocks)
    sizes = np.diff(starts)[source]
    position = ragged_ranges(starts[source], sizes)
    ray, lit = tree.order[position], np.repeat(viewer, sizes)
    shares = np.zeros((channels, len(ray)))
    for other in level_responses:
        _add_responses(tree, level, other, lit, ray, shares)
    ends = np.append(0, np.cumsum(sizes))
    sums = np.repeat(np.add.reduceat(shares, ends[:-1], axis=1), sizes, axis=1)
    even = np.repeat(1.0 / sizes, sizes)
    shares = np.where(sums > 0, shares / np.where(sums > 0, sums, 1), even)
    return Spread(
        node.astype(np.int32),
        [csr_array((plane, position, ends), (len(nodes), pixels)) for plane in shares],
    )


def looks_symmetric(
    tree: BlockTree, camera: RayDomain, level_responses: Sequence[Responses]
) -> bool:
    """Tell whether single rays' responses agree with those of their transpose.

    Direct light, on the diagonal of a coaxial rig's transport, says nothing. Of the rest, two
    matrices that have nothing to do with each other differ by 0.7 of their norm or more.
    """
    if camera.shape != tree.domain.shape or not level_responses:
        return False
    finest = level_responses[-1]
    lit = tree.order[tree.starts[finest.level][finest.block]]
    indirect = lit != finest.pixel
    if finest.level < tree.n_levels - 1 or not indirect.any():
        return False
    back = np.zeros((len(finest.values), int(np.count_nonzero(indirect))))
    viewer = tree.inverse[finest.pixel[indirect]]
    for pairs in level_responses:
        if len(pairs):
            _add_responses(tree, finest.level, pairs, viewer, lit[indirect], back)
    there = finest.values[:, indirect]
    return agree(there, back)


def agree(there: NDArray[np.floating[Any]], back: Double) -> bool:
    """Tell whether parts of a matrix and of its transpose are the same, but for errors."""
    return bool(np.linalg.norm(there - back) < _LEAST_DIFFERENCE * np.linalg.norm(there))


def _add_responses(
    tree: BlockTree,
    level: int,
    pairs: Responses,
    block: NDArray[np.int64],
    pixel: NDArray[np.int64],
    out: Double,
) -> None:
    """Add what pixels saw of blocks of `level`: the sum of finer blocks, or a share of coarser."""
    count = tree.domain.size
    if pairs.level >= level:
        coarse = tree.ancestors(pairs.level, level)[pairs.block]
        keys, values = _summed(coarse * np.int64(count) + pairs.pixel, pairs.values)
        blocks, share = block, np.ones(1)
    else:
        keys, values = pairs.block * np.int64(count) + pairs.pixel, pairs.values.astype(float)
        above = tree.ancestors(level, pairs.level)
        share = np.diff(tree.starts[level]) / np.diff(tree.starts[pairs.level])[above]
        blocks, share = above[block], share[block]
    key = blocks * np.int64(count) + pixel
    place = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    out += np.where(keys[place] == key, values[:, place] * share, 0.0)
