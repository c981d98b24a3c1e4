"""Compiled kernels of the hierarchical tensor: what its leaves make of patterns.

All images and factors are planar and in tree order: channels first, rays contiguous. Factors are
float32, or unsigned codes of rounded ones (see ``leaves.py``), which are squared as they are
read: it takes less time than fetching four times the bytes.

The sums of a task don't depend on the number of threads, nor on the other tasks.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba.extending import overload

_FAST = {"reassoc", "contract", "nsz", "arcp"}

# Up to this many rays a block is worked off ray by ray: setting up a vector loop takes longer.
_SHORT = 16
# The work under a partition is dealt out to this many tasks, for about equal shares.
_PARTITION_TASKS = 64
# Products that are added up in float32; their sums are added up in float64.
_RUN = 8192


def _number(stored: Any) -> Any:
    """Return what a stored number stands for, to the scale of its factor; in compiled code."""
    raise NotImplementedError


@overload(_number)
def _overload_number(stored):  # type: ignore[no-untyped-def]
    if isinstance(stored, numba.types.Float):
        return lambda stored: stored
    return lambda stored: np.float32(stored) * np.float32(stored)


@numba.njit(cache=True, fastmath=_FAST)
def _short_dot(factor, weights):  # type: ignore[no-untyped-def]
    total = np.float32(0.0)
    for k in range(factor.shape[0]):
        total += _number(factor[k]) * weights[k]
    return total


@numba.njit(cache=True)
def _dot(factor, weights):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(0, factor.shape[0], _RUN):
        total += _short_dot(factor[k : k + _RUN], weights[k : k + _RUN])
    return np.float32(total)


@numba.njit(cache=True, fastmath=_FAST)
def _add_scaled(target, factor, scale):  # type: ignore[no-untyped-def]
    for k in range(factor.shape[0]):
        target[k] += _number(factor[k]) * scale


@numba.njit(cache=True)
def _apply_short_leaf(a0, a1, b0, b1, values, at, scale, source, target):  # type: ignore[no-untyped-def]
    """Apply a leaf over two small blocks; its values begin at `at`."""
    of_a = at - a0
    from_a, from_b = np.float32(0.0), np.float32(0.0)
    for k in range(a0, a1):
        from_a += _number(values[of_a + k]) * source[k]
    from_a = from_a * scale * scale
    if a0 == b0:
        for k in range(a0, a1):
            target[k] += _number(values[of_a + k]) * from_a
        return
    of_b = at + a1 - a0 - b0
    for k in range(b0, b1):
        from_b += _number(values[of_b + k]) * source[k]
        target[k] += _number(values[of_b + k]) * from_a
    from_b = from_b * scale * scale
    for k in range(a0, a1):
        target[k] += _number(values[of_a + k]) * from_b


@numba.njit(cache=True)
def _apply_leaf(a0, a1, b0, b1, lit_a, lit_b, values, at, scale, source, target):  # type: ignore[no-untyped-def]
    """Apply a leaf, its values from `at` on; they come from memory once, then from the cache."""
    factor_a = values[at : at + a1 - a0]
    if a0 == b0:
        from_a = _dot(factor_a, source[a0:a1]) * scale * scale
        _add_scaled(target[a0:a1], factor_a, from_a)
        return
    factor_b = values[at + a1 - a0 : at + a1 - a0 + b1 - b0]
    if lit_a:
        from_a = _dot(factor_a, source[a0:a1]) * scale * scale
        _add_scaled(target[b0:b1], factor_b, from_a)
    if lit_b:
        from_b = _dot(factor_b, source[b0:b1]) * scale * scale
        _add_scaled(target[a0:a1], factor_a, from_b)


@numba.njit(cache=True)
def _apply_run(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, first, last, values, scales, at, lit, source, target
):
    """Apply leaves ``first:last``, whose values begin at `at`, to one plane of one pattern."""
    for n in range(first, last):
        a, b = block_a[n], block_b[n]
        a0, a1, b0, b1 = starts[a], starts[a + 1], starts[b], starts[b + 1]
        if lit[a] or lit[b]:
            if max(a1 - a0, b1 - b0) <= _SHORT:
                _apply_short_leaf(
                    np.uint64(a0), np.uint64(a1), np.uint64(b0), np.uint64(b1), values,
                    np.uint64(at), scales[n], source, target,
                )  # fmt: skip
            else:
                _apply_leaf(
                    a0, a1, b0, b1, lit[a], lit[b], values, at, scales[n], source, target
                )  # fmt: skip
        at += a1 - a0
        if a != b:
            at += b1 - b0


@numba.njit(cache=True, parallel=True)
def apply_leaves(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, values, scales, channels, bounds, offsets, group, patterns, lit, out
):
    """Add ``T p`` of the rank-1 leaves of one level.

    A task is one share of the leaves, one plane and a group of patterns.

    Parameters
    ----------
    starts : int64 (n_blocks + 1,)
        First tree position of each block of the level.
    block_a, block_b : int32 (n,)
        The two blocks of each leaf; equal on the diagonal.
    values : float32 or unsigned (C, n_values)
        Factors, or codes of them.
    scales : float32 (C, n)
        By which both factors of a leaf are multiplied.
    channels : int64 (K,)
        The channel of each plane of `out`.
    bounds, offsets : int64 (shares, runs + 1)
        Leaves ``bounds[s, r]:bounds[s, r + 1]`` are run ``r`` of share ``s``; their values begin
        at ``offsets[s, r]``. A run is small enough to stay in the cache for a group of patterns.
    group : int
        Patterns of a task: a leaf's factors are fetched once for all of them.
    patterns : float32 (P, K, N) or (P, 1, N)
        The same light for all planes if there is one.
    lit : uint8 (P, n_blocks)
        Whether a pattern lights a block; leaves between dark blocks aren't read.
    out : float32 (shares, P, K, N)
        Added to in place.
    """
    count, planes = out.shape[1], out.shape[2]
    groups = (count + group - 1) // group
    for task in numba.prange(bounds.shape[0] * planes * groups):
        share, plane = task // groups // planes, task // groups % planes
        first = task % groups * group
        light = min(plane, patterns.shape[1] - 1)
        factors, factor_scales = values[channels[plane]], scales[channels[plane]]
        for run in range(bounds.shape[1] - 1):
            for p in range(first, min(first + group, count)):
                _apply_run(
                    starts, block_a, block_b, bounds[share, run], bounds[share, run + 1], factors,
                    factor_scales, offsets[share, run], lit[p], patterns[p, light],
                    out[share, p, plane],
                )  # fmt: skip


@numba.njit(cache=True, parallel=True)
def apply_scalars(ray_a, ray_b, values, channels, bounds, group, patterns, out):  # type: ignore[no-untyped-def]
    """Add ``T p`` of the scalar leaves; arguments and tasks as in `apply_leaves`.

    Parameters
    ----------
    ray_a, ray_b : int32 (n,)
        Tree positions of each scalar; ``ray_a <= ray_b``, each off-diagonal one counts both ways.
    values : float32 (C, n)
    """
    count, planes = out.shape[1], out.shape[2]
    groups = (count + group - 1) // group
    for task in numba.prange(bounds.shape[0] * planes * groups):
        share, plane = task // groups // planes, task // groups % planes
        first = task % groups * group
        scalars = values[channels[plane]]
        for p in range(first, min(first + group, count)):
            source = patterns[p, min(plane, patterns.shape[1] - 1)]
            target = out[share, p, plane]
            for n in range(bounds[share, 0], bounds[share, -1]):
                a, b = np.uint64(ray_a[n]), np.uint64(ray_b[n])
                target[a] += scalars[n] * source[b]
                if a != b:
                    target[b] += scalars[n] * source[a]


@numba.njit(cache=True, fastmath=_FAST)
def summed(values):  # type: ignore[no-untyped-def]
    """Return the sum of values."""
    total = 0.0
    for k in range(values.shape[0]):
        total += np.float64(values[k])
    return total


@numba.njit(cache=True, fastmath=_FAST)
def dot(first, second):  # type: ignore[no-untyped-def]
    """Return the inner product of two runs of values."""
    total = 0.0
    for k in range(first.shape[0]):
        total += np.float64(first[k]) * np.float64(second[k])
    return total


# Sums keep their order: `contract` allows fused products alone.
@numba.njit(cache=True, fastmath={"contract"})
def _add_exactly(target, factor, scale):  # type: ignore[no-untyped-def]
    for k in range(target.shape[0]):
        target[k] = target[k] + factor[k] * scale


@numba.njit(cache=True, parallel=True)
def apply_to_partition(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, offset_a, offset_b, values, first_side, sides, tiles, lit_parts,
    first_lit, part_starts, pattern_of_part, images,
):  # fmt: skip
    """Add ``T p`` of one level's leaves for patterns that share out the blocks of a level.

    Goes through the rays that see light, a tile at a time, and for each through the leaves that
    may light it, in their order: sums don't depend on the number of threads, nor on which patterns
    stand together.

    Parameters
    ----------
    starts, block_a, block_b, values
        As in `apply_leaves`.
    offset_a, offset_b : int64 (n,)
        Where the leaves' two factors begin; the same on the diagonal.
    first_side, sides
        The leaves of each block, see `rfpipe.transport.hierarchical.apply`.
    tiles : int64 (n_tiles, 3)
        A block, and a run of its tree positions: the first and the end.
    lit_parts : int64 (m,)
        The blocks that the patterns light, by position.
    first_lit : int64 (n_blocks, 2)
        Which of `lit_parts` each of the leaves' blocks meets: the first and the end.
    part_starts : int64 (n_parts + 1,)
        First tree positions of the blocks that the patterns share out.
    pattern_of_part : int32 (n_parts,)
        Pattern that lights each, counted from the first of `images`.
    images : float32 (P, C, N)
        Added to.
    """
    patterns, channels = images.shape[0], images.shape[1]
    for task in numba.prange(_PARTITION_TASKS):
        scales = np.zeros((channels, patterns))
        for tile in range(task, tiles.shape[0], _PARTITION_TASKS):
            block, ray, end = tiles[tile, 0], tiles[tile, 1], tiles[tile, 2]
            for place in range(first_side[block], first_side[block + 1]):
                n, is_b = sides[place] >> 1, sides[place] & 1
                source = block_a[n] if is_b else block_b[n]
                low, high = first_lit[source, 0], first_lit[source, 1]
                if low == high:
                    continue
                of_source = (offset_a[n] if is_b else offset_b[n]) - starts[source]
                begin = (offset_b[n] if is_b else offset_a[n]) + ray - starts[block]
                for index in range(low, high):
                    part = lit_parts[index]
                    p0 = of_source + max(starts[source], part_starts[part])
                    p1 = of_source + min(starts[source + 1], part_starts[part + 1])
                    for c in range(channels):
                        scales[c, pattern_of_part[part]] += summed(values[c, p0:p1])
                for c in range(channels):
                    factor = values[c, begin : begin + end - ray]
                    for pattern in range(patterns):
                        scale = np.float32(scales[c, pattern])
                        if scale != 0:
                            _add_exactly(images[pattern, c, ray:end], factor, scale)
                scales[:] = 0.0


@numba.njit(cache=True, parallel=True)
def scalars_to_partition(ray_a, ray_b, values, pattern_of_ray, images):  # type: ignore[no-untyped-def]
    """Add ``T p`` of scalar leaves; see `apply_to_partition`.

    Scalars as in `apply_scalars`; `pattern_of_ray`, int32 (N,), is the pattern that lights each
    tree position.
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
