"""Compiled kernels of the hierarchical tensor under a partition of its rays into patterns."""

from __future__ import annotations

import numba
import numpy as np

from rfpipe.transport.hierarchical.kernels import summed

# The work is dealt out to this many tasks, so that threads have about equal shares.
_TASKS = 64
# Leaves whose light is added to an image at a time: it is read and written once for them.
_TOGETHER = 4


# Sums keep their order, whichever leaves stand together: `contract` allows fused products alone.
@numba.njit(cache=True, fastmath={"contract"})
def _add_four(target, values, begin, scales):  # type: ignore[no-untyped-def]
    scale_0, scale_1, scale_2, scale_3 = scales
    count = np.int64(target.shape[0])
    factor_0 = values[begin[0] : begin[0] + count]
    factor_1 = values[begin[1] : begin[1] + count]
    factor_2 = values[begin[2] : begin[2] + count]
    factor_3 = values[begin[3] : begin[3] + count]
    for k in range(count):
        light = target[k] + factor_0[k] * scale_0
        light = light + factor_1[k] * scale_1
        light = light + factor_2[k] * scale_2
        target[k] = light + factor_3[k] * scale_3


@numba.njit(cache=True, fastmath={"contract"})
def _add_one(target, values, begin, scale):  # type: ignore[no-untyped-def]
    count = np.int64(target.shape[0])
    factor = values[begin : begin + count]
    for k in range(count):
        target[k] = target[k] + factor[k] * scale


@numba.njit(cache=True)
def _add_leaves(images, c, ray, end, values, begin, scales, count):  # type: ignore[no-untyped-def]
    """Add `count` leaves' light to some rays of the images of channel `c`; clear the scales."""
    for pattern in range(images.shape[0]):
        # a slice of one axis, which is known to be contiguous
        target = images[pattern, c, ray:end]
        s0 = np.float32(scales[pattern, 0])
        s1 = np.float32(scales[pattern, 1])
        s2 = np.float32(scales[pattern, 2])
        s3 = np.float32(scales[pattern, 3])
        lit = (s0 != 0) + (s1 != 0) + (s2 != 0) + (s3 != 0)
        if lit > 1 and count == _TOGETHER:
            _add_four(target, values, begin, (s0, s1, s2, s3))
        elif lit:
            for n in range(count):
                scale = np.float32(scales[pattern, n])
                if scale != 0:
                    _add_one(target, values, begin[n], scale)
    scales[:] = 0.0


@numba.njit(cache=True, parallel=True)
def apply_to_partition(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, offset_a, offset_b, values, signs, first_side, sides, tiles,
    lit_parts, first_lit, part_starts, pattern_of_part, images,
):  # fmt: skip
    """Add ``T p`` of one level's leaves for patterns that share out the blocks of a level.

    Goes through the rays that see light, a tile at a time, and for each through the leaves that
    may light it, in their order: sums don't depend on the number of threads, nor on which patterns
    stand together.

    Parameters
    ----------
    starts : int64 (n_blocks + 1,)
        First tree positions of the leaves' blocks.
    block_a, block_b, offset_a, offset_b : (n,)
        The leaves and where their two factors begin; the same on the diagonal.
    values : float32 (C, n_values)
    signs : int8 (C, n) or (C, 0)
        Of the leaves; none if all are positive.
    first_side, sides
        The leaves of each block, see `rfpipe.transport.hierarchical.partition`.
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
    for task in numba.prange(_TASKS):
        scales = np.zeros((channels, patterns, _TOGETHER))
        begin = np.zeros(_TOGETHER, np.int64)
        for tile in range(task, tiles.shape[0], _TASKS):
            seen, ray, end = tiles[tile, 0], tiles[tile, 1], tiles[tile, 2]
            count = 0
            for place in range(first_side[seen], first_side[seen + 1]):
                n, is_b = sides[place] >> 1, sides[place] & 1
                lit = block_a[n] if is_b else block_b[n]
                low, high = first_lit[lit, 0], first_lit[lit, 1]
                if low == high:
                    continue
                of_lit = (offset_a[n] if is_b else offset_b[n]) - starts[lit]
                begin[count] = (offset_b[n] if is_b else offset_a[n]) + ray - starts[seen]
                for index in range(low, high):
                    part = lit_parts[index]
                    pattern = pattern_of_part[part]
                    p0 = of_lit + max(starts[lit], part_starts[part])
                    p1 = of_lit + min(starts[lit + 1], part_starts[part + 1])
                    for c in range(channels):
                        light = summed(values[c, p0:p1])
                        if signs.shape[1] and signs[c, n] < 0:
                            light = -light
                        scales[c, pattern, count] += light
                count += 1
                if count == _TOGETHER:
                    for c in range(channels):
                        _add_leaves(images, c, ray, end, values[c], begin, scales[c], count)
                    count = 0
            if count:
                for c in range(channels):
                    _add_leaves(images, c, ray, end, values[c], begin, scales[c], count)


@numba.njit(cache=True, parallel=True)
def scalars_to_partition(ray_a, ray_b, values, pattern_of_ray, images):  # type: ignore[no-untyped-def]
    """Add ``T p`` of scalar leaves; see `apply_to_partition`.

    Parameters
    ----------
    ray_a, ray_b : int32 (n,)
        Tree positions of each scalar; ``ray_a <= ray_b``, each off-diagonal one counts both ways.
    values : float32 (C, n)
    pattern_of_ray : int32 (N,)
        Pattern that lights each tree position.
    images : float32 (P, C, N)
        Added to.
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
