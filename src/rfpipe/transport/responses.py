"""Responses of camera pixels to projector blocks, and their distribution over the rays (§3.2).

A response is the radiance of a pixel i while a block b is lit, the sum of ``T_ij`` over the rays j
of b. It doesn't determine the ``T_ij``, which get shares s_j that add up to 1 in b::

    T_ij = s_j response(i, b)

The shares are even, s_j = 1 / |b| [eq. 3.2]. Of a coaxial rig, ``T = T^T`` [eq. 2.10], they are in
proportion to the responses of the pixels j to the block a of the same level that contains ray i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float, Index
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.transport.hierarchical.leaves import ragged_ranges

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Relative norm of the difference between a transport and its transpose below which they agree. It
# is 0.01 to 0.08 on coaxial rigs, and 0.7 for unrelated random matrices.
_SYMMETRIC_DIFFERENCE = 0.5

RESPONSE_ARRAYS = ("block", "pixel", "values")
"""Names of the arrays of `Responses` in stores."""


@dataclass(frozen=True)
class Responses:
    """Responses of camera pixels to projector blocks of one level: a sparse matrix.

    Ordered by block, then pixel.

    Attributes
    ----------
    level : int
    block, pixel : ndarray of int32, shape (n,)
        A block of the level and a camera ray (C order); pairs are unique.
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
    """Sort responses that aren't empty by level, the coarsest first."""
    return sorted(filter(len, level_responses), key=lambda responses: responses.level)


def no_responses(level: int, channels: int) -> Responses:
    """Return a level without responses."""
    none = np.empty(0, np.int32)
    return Responses(level, none, none, np.empty((channels, 0), np.float32))


def fold(
    tree: BlockTree, level: int, level_responses: Sequence[Responses], channels: int, pixels: int
) -> Responses:
    """Sum the responses of `level` and of finer levels over the blocks of `level`."""
    if not any(len(pairs) for pairs in level_responses):
        return no_responses(level, channels)
    keys = [
        tree.ancestors(pairs.level, level)[pairs.block] * pixels + pairs.pixel
        for pairs in level_responses
    ]
    values = np.concatenate([pairs.values for pairs in level_responses], axis=1)
    unique, sums = _sum_by_key(np.concatenate(keys), values)
    block, pixel = np.divmod(unique, pixels)
    return Responses(level, block.astype(np.int32), pixel.astype(np.int32), sums.astype(np.float32))


def _sum_by_key(keys: Index, values: Float) -> tuple[Index, Double]:
    """Return the unique keys, ascending, and the sums (C, keys) of their values."""
    unique, index = np.unique(keys, return_inverse=True)
    return unique, np.stack([np.bincount(index, plane, len(unique)) for plane in values])


@dataclass(frozen=True)
class Spread:
    """Shares of rays in the responses of a level.

    Attributes
    ----------
    node : ndarray of int32, shape (n,)
        Row of the shares for each response.
    shares : list of csr_array, each (nodes, N)
        One per channel, or one for all; rows add up to 1, columns are rays in tree order.
    """

    node: NDArray[np.int32]
    shares: list[csr_array]

    def of(self, channels: Sequence[int]) -> list[csr_array]:
        """Return the shares of some channels."""
        return [self.shares[channel % len(self.shares)] for channel in channels]


def spread_evenly(tree: BlockTree, pairs: Responses) -> Spread:
    """Distribute each response evenly over its block [eq. 3.2]."""
    from scipy.sparse import csr_array

    starts = tree.starts[pairs.level]
    sizes = np.diff(starts)
    shares = np.repeat(1.0 / sizes, sizes)
    rays = np.arange(tree.domain.size)
    return Spread(pairs.block, [csr_array((shares, rays, starts), (len(sizes), len(rays)))])


def spread_by_transpose(
    tree: BlockTree, level_responses: Sequence[Responses], index: int
) -> Spread:
    """Distribute responses in proportion to the transpose, for a coaxial rig.

    Parameters
    ----------
    tree : BlockTree
        Of the ray domain that camera and projector share.
    level_responses : sequence of Responses
    index : int
        Number of the level in `level_responses`.
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
    for responses in level_responses:
        _add_responses(tree, level, responses, lit, ray, shares)
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
    """Test whether responses to single rays agree with the transpose.

    The diagonal, direct light of a coaxial rig, is left out, since it is its own transpose.
    """
    if camera.shape != tree.domain.shape or not level_responses:
        return False
    finest = level_responses[-1]
    lit = tree.order[tree.starts[finest.level][finest.block]]
    indirect = lit != finest.pixel
    if finest.level < tree.n_levels - 1 or not indirect.any():
        return False
    transposed = np.zeros((len(finest.values), int(np.count_nonzero(indirect))))
    viewer = tree.inverse[finest.pixel[indirect]]
    for pairs in level_responses:
        if len(pairs):
            _add_responses(tree, finest.level, pairs, viewer, lit[indirect], transposed)
    return agree(finest.values[:, indirect], transposed)


def agree(entries: NDArray[np.floating[Any]], transposed: Double) -> bool:
    """Test whether entries of a matrix and of its transpose are equal up to errors."""
    difference = np.linalg.norm(entries - transposed)
    return bool(difference < _SYMMETRIC_DIFFERENCE * np.linalg.norm(entries))


def _add_responses(
    tree: BlockTree,
    level: int,
    pairs: Responses,
    block: Index,
    pixel: Index,
    out: Double,
) -> None:
    """Add responses of pixels to blocks of `level`, in place.

    Responses to finer blocks are summed, those to coarser ones are divided by area.
    """
    count = tree.domain.size
    if pairs.level >= level:
        coarse = tree.ancestors(pairs.level, level)[pairs.block]
        keys, values = _sum_by_key(coarse * np.int64(count) + pairs.pixel, pairs.values)
        blocks, share = block, np.ones(1)
    else:
        keys, values = pairs.block * np.int64(count) + pairs.pixel, pairs.values.astype(float)
        ancestor = tree.ancestors(level, pairs.level)
        share = np.diff(tree.starts[level]) / np.diff(tree.starts[pairs.level])[ancestor]
        blocks, share = ancestor[block], share[block]
    key = blocks * np.int64(count) + pixel
    index = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    out += np.where(keys[index] == key, values[:, index] * share, 0.0)
