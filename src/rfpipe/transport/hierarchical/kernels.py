"""Compiled kernels of the hierarchical tensor: products of its leaves with patterns.

A leaf over the blocks a and b is ``T_ab = u v^T`` and, by symmetry, ``T_ba = v u^T``. For a pattern
p it adds, on the diagonal only once::

    image[b] += v (u . p[a])
    image[a] += u (v . p[b])

Images and factors are planar and in tree order: channels first, the rays of a block contiguous.
Factors are float32, or the unsigned codes of rounded ones (`rfpipe.transport.hierarchical.leaves`),
which are squared as they are read: this takes less time than to fetch four times the bytes.

The sums of a task depend neither on the number of threads nor on the other tasks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from rfpipe.array_types import Float, Index

_FAST = {"reassoc", "contract", "nsz", "arcp"}

# Blocks of at most this many rays are processed ray by ray: a vector loop takes longer to set up.
_SHORT = 16
# Number of tasks of about equal work under a partition.
_PARTITION_TASKS = 64
# Products that are summed in float32; their sums are summed in float64.
_RUN = 8192


class Leaves(NamedTuple):
    """Rank-1 leaves of one level.

    Attributes
    ----------
    starts : int64 (n_blocks + 1,)
        First tree position of each block of the level.
    block_a, block_b : int32 (n,)
        Blocks of each leaf; equal on the diagonal.
    values : float32 or unsigned (C, n_values)
        Factors u and v of one leaf after the other, or their codes.
    scales : float32 (C, n)
        Both factors of a leaf are multiplied by its scale.
    """

    starts: Index
    block_a: NDArray[np.int32]
    block_b: NDArray[np.int32]
    values: NDArray[Any]
    scales: Float


class WorkSplit(NamedTuple):
    """Division of leaves into chunks of about equal work, and of these into runs.

    Each chunk has an output image, so that chunks can be processed in parallel. A run stays in the
    cache while a group of patterns is applied.

    Attributes
    ----------
    bounds, offsets : int64 (chunks, runs + 1)
        Leaves ``bounds[s, r]:bounds[s, r + 1]`` are run r of chunk s; their values begin at
        ``offsets[s, r]``.
    patterns : int
        Patterns of a group.
    """

    bounds: Index
    offsets: Index
    patterns: int


class LeafSides(NamedTuple):
    """Leaves by the block that receives light.

    Attributes
    ----------
    starts : int64 (n_blocks + 1,)
        First tree position of each block of the leaves' level.
    block_a, block_b : int32 (n,)
    offset_a, offset_b : int64 (n,)
        First value of the factors u and v; equal on the diagonal.
    values : float32 (C, n_values)
    first_side : int64 (n_blocks + 1,)
        Block k receives light by the sides ``sides[first_side[k]:first_side[k + 1]]``.
    sides : int64 (n_sides,)
        Twice the number of a leaf, plus 1 where the block is its b.
    """

    starts: Index
    block_a: NDArray[np.int32]
    block_b: NDArray[np.int32]
    offset_a: Index
    offset_b: Index
    values: Float
    first_side: Index
    sides: Index


class Partition(NamedTuple):
    """Patterns that light each block of a level at most once; these blocks are the *cells*.

    Attributes
    ----------
    starts : int64 (n_cells + 1,)
        First tree position of each cell.
    pattern : int32 (n_cells,)
        Pattern that lights each cell, counted from the first image.
    lit : int64 (m,)
        The lit cells, ascending.
    first_lit : int64 (n_blocks, 2)
        First and end of the entries of `lit` that overlap each block of the leaves.
    """

    starts: Index
    pattern: NDArray[np.int32]
    lit: Index
    first_lit: Index


def _number(stored: Any) -> Any:
    """Decode a stored number, without its factor's scale; in compiled code."""
    raise NotImplementedError


@overload(_number)
def _overload_number(stored):  # type: ignore[no-untyped-def]
    if isinstance(stored, numba.types.Float):
        return lambda stored: stored
    return lambda stored: np.float32(stored) * np.float32(stored)


@numba.njit(cache=True, fastmath=_FAST)
def summed(values):  # type: ignore[no-untyped-def]
    """Return the sum of values."""
    total = 0.0
    for k in range(values.shape[0]):
        total += np.float64(values[k])
    return total


@numba.njit(cache=True, fastmath=_FAST)
def dot(first, second):  # type: ignore[no-untyped-def]
    """Return the inner product of two arrays."""
    total = 0.0
    for k in range(first.shape[0]):
        total += np.float64(first[k]) * np.float64(second[k])
    return total


@numba.njit(cache=True, fastmath=_FAST)
def _short_dot(factor, weights):  # type: ignore[no-untyped-def]
    total = np.float32(0.0)
    for k in range(factor.shape[0]):
        total += _number(factor[k]) * weights[k]
    return total


@numba.njit(cache=True)
def _factor_dot(factor, weights):  # type: ignore[no-untyped-def]
    """Return the inner product of a factor, without its scale, and weights."""
    total = 0.0
    for k in range(0, factor.shape[0], _RUN):
        total += _short_dot(factor[k : k + _RUN], weights[k : k + _RUN])
    return np.float32(total)


@numba.njit(cache=True, fastmath=_FAST)
def _add_scaled(target, factor, scale):  # type: ignore[no-untyped-def]
    for k in range(factor.shape[0]):
        target[k] += _number(factor[k]) * scale


# Any patterns


@numba.njit(cache=True)
def _apply_short_leaf(extent, values, offset, scale, source, target):  # type: ignore[no-untyped-def]
    """Apply a leaf over two small blocks, ray by ray; arguments as `_apply_leaf`, unsigned."""
    a0, a1, b0, b1 = extent
    of_a = offset - a0
    from_a, from_b = np.float32(0.0), np.float32(0.0)
    for k in range(a0, a1):
        from_a += _number(values[of_a + k]) * source[k]
    from_a = from_a * scale * scale
    if a0 == b0:
        for k in range(a0, a1):
            target[k] += _number(values[of_a + k]) * from_a
        return
    of_b = offset + a1 - a0 - b0
    for k in range(b0, b1):
        from_b += _number(values[of_b + k]) * source[k]
        target[k] += _number(values[of_b + k]) * from_a
    from_b = from_b * scale * scale
    for k in range(a0, a1):
        target[k] += _number(values[of_a + k]) * from_b


@numba.njit(cache=True)
def _apply_leaf(extent, lit, values, offset, scale, source, target):  # type: ignore[no-untyped-def]
    """Apply a leaf to one plane of a pattern.

    `extent` are the first ray and the end of block a, then of block b, `lit` whether the pattern
    lights a and b; `offset` is the first of the leaf's values, which are read from memory once and
    then from the cache.
    """
    a0, a1, b0, b1 = extent
    factor_a = values[offset : offset + a1 - a0]
    if a0 == b0:
        from_a = _factor_dot(factor_a, source[a0:a1]) * scale * scale
        _add_scaled(target[a0:a1], factor_a, from_a)
        return
    factor_b = values[offset + a1 - a0 : offset + a1 - a0 + b1 - b0]
    if lit[0]:
        from_a = _factor_dot(factor_a, source[a0:a1]) * scale * scale
        _add_scaled(target[b0:b1], factor_b, from_a)
    if lit[1]:
        from_b = _factor_dot(factor_b, source[b0:b1]) * scale * scale
        _add_scaled(target[a0:a1], factor_a, from_b)


@numba.njit(cache=True)
def _apply_run(leaves, channel, run, lit, source, target):  # type: ignore[no-untyped-def]
    """Apply a run of leaves, (first, end, first value), to one plane of a pattern."""
    first, last, offset = run
    values, scales = leaves.values[channel], leaves.scales[channel]
    for n in range(first, last):
        a, b = leaves.block_a[n], leaves.block_b[n]
        a0, a1 = leaves.starts[a], leaves.starts[a + 1]
        b0, b1 = leaves.starts[b], leaves.starts[b + 1]
        if lit[a] or lit[b]:
            if max(a1 - a0, b1 - b0) <= _SHORT:
                extent = np.uint64(a0), np.uint64(a1), np.uint64(b0), np.uint64(b1)
                _apply_short_leaf(extent, values, np.uint64(offset), scales[n], source, target)
            else:
                extent = a0, a1, b0, b1
                _apply_leaf(extent, (lit[a], lit[b]), values, offset, scales[n], source, target)
        offset += a1 - a0
        if a != b:
            offset += b1 - b0


@numba.njit(cache=True, parallel=True)
def apply_leaves(leaves, channels, work, patterns, lit, out):  # type: ignore[no-untyped-def]
    """Add ``T p`` of the rank-1 leaves of one level.

    A task is one chunk of the leaves, one plane and a group of patterns.

    Parameters
    ----------
    leaves : Leaves
    channels : int64 (K,)
        The channel of each plane of `out`.
    work : WorkSplit
    patterns : float32 (P, K, N) or (P, 1, N)
        One plane is light of the same weights in all channels.
    lit : bool (P, n_blocks)
        True where a pattern lights a block; leaves between dark blocks are skipped.
    out : float32 (chunks, P, K, N)
        The products are added to it.
    """
    count, planes = out.shape[1], out.shape[2]
    groups = (count + work.patterns - 1) // work.patterns
    for task in numba.prange(work.bounds.shape[0] * planes * groups):
        chunk, plane = task // groups // planes, task // groups % planes
        first = task % groups * work.patterns
        last = min(first + work.patterns, count)
        for run in range(work.bounds.shape[1] - 1):
            extent = (
                work.bounds[chunk, run],
                work.bounds[chunk, run + 1],
                work.offsets[chunk, run],
            )
            for p in range(first, last):
                source = patterns[p, min(plane, patterns.shape[1] - 1)]
                target = out[chunk, p, plane]
                _apply_run(leaves, channels[plane], extent, lit[p], source, target)


@numba.njit(cache=True, parallel=True)
def apply_scalars(leaves, channels, work, patterns, out):  # type: ignore[no-untyped-def]
    """Add ``T p`` of the scalar leaves of the last level; arguments as `apply_leaves`.

    The blocks are tree positions ``a <= b``, the values float32 (C, n).
    """
    count, planes = out.shape[1], out.shape[2]
    groups = (count + work.patterns - 1) // work.patterns
    for task in numba.prange(work.bounds.shape[0] * planes * groups):
        chunk, plane = task // groups // planes, task // groups % planes
        first = task % groups * work.patterns
        run = work.bounds[chunk, 0], work.bounds[chunk, -1]
        for p in range(first, min(first + work.patterns, count)):
            source = patterns[p, min(plane, patterns.shape[1] - 1)]
            _apply_scalar_run(leaves, channels[plane], run, source, out[chunk, p, plane])


@numba.njit(cache=True)
def _apply_scalar_run(leaves, channel, run, source, target):  # type: ignore[no-untyped-def]
    """Apply a run of scalar leaves, (first, end), to one plane of a pattern."""
    scalars = leaves.values[channel]
    for n in range(run[0], run[1]):
        a, b = np.uint64(leaves.block_a[n]), np.uint64(leaves.block_b[n])
        target[a] += scalars[n] * source[b]
        if a != b:
            target[b] += scalars[n] * source[a]


# Patterns that are a partition of the rays


# Sums are not reordered: `contract` allows fused products alone.
@numba.njit(cache=True, fastmath={"contract"})
def _add_in_order(target, factor, scale):  # type: ignore[no-untyped-def]
    for k in range(target.shape[0]):
        target[k] = target[k] + factor[k] * scale


@numba.njit(cache=True, parallel=True)
def apply_to_partition(leaves, tiles, partition, images):  # type: ignore[no-untyped-def]
    """Add ``T p`` of one level's leaves for the patterns of a partition.

    Each tile, some rays that receive light, adds up the leaves of its block in their order: the
    sums don't depend on the number of threads, nor on the other patterns of the call.

    Parameters
    ----------
    leaves : LeafSides
    tiles : int64 (n_tiles, 3)
        A block, and a range of its tree positions: the first and the end.
    partition : Partition
    images : float32 (P, C, N)
        The products are added to it.
    """
    for task in numba.prange(_PARTITION_TASKS):
        light = np.zeros((images.shape[1], images.shape[0]))
        for tile in range(task, tiles.shape[0], _PARTITION_TASKS):
            _add_to_tile(leaves, tiles[tile], partition, light, images)


@numba.njit(cache=True)
def _add_to_tile(leaves, tile, partition, light, images):  # type: ignore[no-untyped-def]
    """Add the light that a tile receives; `light`, float64 (C, P), is 0 before and after."""
    block, ray, end = tile
    for index in range(leaves.first_side[block], leaves.first_side[block + 1]):
        n, is_b = leaves.sides[index] >> 1, leaves.sides[index] & 1
        source = leaves.block_a[n] if is_b else leaves.block_b[n]
        if partition.first_lit[source, 0] == partition.first_lit[source, 1]:
            continue
        sent = (leaves.offset_a[n] if is_b else leaves.offset_b[n]) - leaves.starts[source]
        _sum_sent(leaves, source, sent, partition, light)
        begin = (leaves.offset_b[n] if is_b else leaves.offset_a[n]) + ray - leaves.starts[block]
        for c in range(images.shape[1]):
            factor = leaves.values[c, begin : begin + end - ray]
            _add_factor(factor, light[c], images[:, c, ray:end])
        light[:] = 0.0


@numba.njit(cache=True)
def _add_factor(factor, light, images):  # type: ignore[no-untyped-def]
    """Add a factor, times the light of each pattern, to images (P, rays)."""
    for pattern in range(images.shape[0]):
        scale = np.float32(light[pattern])
        if scale != 0:
            _add_in_order(images[pattern], factor, scale)


@numba.njit(cache=True)
def _sum_sent(leaves, source, offset, partition, light):  # type: ignore[no-untyped-def]
    """Add a factor's sum over the lit cells of its block `source` to the light of each pattern.

    The factor's value of tree position k is at ``offset + k``.
    """
    for index in range(partition.first_lit[source, 0], partition.first_lit[source, 1]):
        cell = partition.lit[index]
        first = offset + max(leaves.starts[source], partition.starts[cell])
        last = offset + min(leaves.starts[source + 1], partition.starts[cell + 1])
        for c in range(light.shape[0]):
            light[c, partition.pattern[cell]] += summed(leaves.values[c, first:last])


@numba.njit(cache=True, parallel=True)
def scalars_to_partition(ray_a, ray_b, values, pattern_of_ray, images):  # type: ignore[no-untyped-def]
    """Add ``T p`` of scalar leaves for the patterns of a partition.

    Parameters
    ----------
    ray_a, ray_b : int32 (n,)
        Tree positions of each scalar.
    values : float32 (C, n)
    pattern_of_ray : int32 (N,)
        Pattern that lights each tree position, counted from the first image.
    images : float32 (P, C, N)
        The products are added to it.
    """
    patterns, channels = images.shape[0], images.shape[1]
    for c in numba.prange(channels):
        for n in range(ray_a.shape[0]):
            a, b = ray_a[n], ray_b[n]
            pattern = pattern_of_ray[b]
            if 0 <= pattern < patterns:
                images[pattern, c, a] += values[c, n]
            pattern = pattern_of_ray[a]
            if a != b and 0 <= pattern < patterns:
                images[pattern, c, b] += values[c, n]
