"""Compiled kernel of the hierarchical tensor under a partition of its rays into patterns."""

from __future__ import annotations

import numba
import numpy as np

_FAST = {"reassoc", "contract", "nsz", "arcp"}

TOGETHER = 8
"""Patterns that one task of `apply_to_partition` sums up, reading the factors once for them."""


@numba.njit(cache=True, fastmath=_FAST)
def _sum(values):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(values.shape[0]):
        total += np.float64(values[k])
    return total


@numba.njit(cache=True, fastmath=_FAST)
def _add_scaled(target, factor, scale):  # type: ignore[no-untyped-def]
    for k in range(factor.shape[0]):
        target[k] += factor[k] * scale


@numba.njit(cache=True)
def _add_side(  # type: ignore[no-untyped-def]
    seen, lit, factor_seen, factor_lit, starts, parts, part_starts, pattern_of_part, first, last,
    scales, images, c,
):  # fmt: skip
    """Add what one block of a leaf sends to the other, pattern by pattern."""
    scales[:] = 0.0
    found = False
    begin, end = starts[lit], starts[lit + 1]
    for part in range(parts[lit, 0], parts[lit, 1]):
        pattern = pattern_of_part[part]
        if first <= pattern < last:
            low, high = max(begin, part_starts[part]), min(end, part_starts[part + 1])
            scales[pattern - first] += _sum(factor_lit[low - begin : high - begin])
            found = True
    if found:
        for pattern in range(first, last):
            scale = np.float32(scales[pattern - first])
            if scale != 0:
                _add_scaled(images[pattern, c, starts[seen] : starts[seen + 1]], factor_seen, scale)


@numba.njit(cache=True, parallel=True)
def apply_to_partition(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, offset_a, offset_b, values, parts, part_starts, pattern_of_part,
    images,
):  # fmt: skip
    """Add ``T p`` of one level's leaves for patterns that share out the blocks of a level.

    Each task has some patterns of one channel for itself and goes through the leaves in their
    order, so that sums don't depend on the number of threads, nor on which patterns stand
    together.

    Parameters
    ----------
    starts : int64 (n_blocks + 1,)
        First tree positions of the leaves' blocks.
    block_a, block_b, offset_a, offset_b : (n,)
        The leaves and where their two factors begin; the same on the diagonal.
    values : float32 (C, n_values)
    parts : int64 (n_blocks, 2)
        The parts that each of the leaves' blocks meets: from the first to before the second.
    part_starts : int64 (n_parts + 1,)
        First tree positions of the blocks that the patterns share out.
    pattern_of_part : int32 (n_parts,)
        Pattern that lights each, counted from the first of `images`; others where not in range.
    images : float32 (P, C, N)
        Added to.
    """
    patterns, channels = images.shape[0], images.shape[1]
    groups = (patterns + TOGETHER - 1) // TOGETHER
    for task in numba.prange(groups * channels):
        c, first = task % channels, task // channels * TOGETHER
        last = min(first + TOGETHER, patterns)
        scales = np.zeros(TOGETHER)
        for n in range(block_a.shape[0]):
            a, b = block_a[n], block_b[n]
            factor_a = values[c, offset_a[n] : offset_a[n] + starts[a + 1] - starts[a]]
            factor_b = values[c, offset_b[n] : offset_b[n] + starts[b + 1] - starts[b]]
            _add_side(
                a, b, factor_a, factor_b, starts, parts, part_starts, pattern_of_part, first, last,
                scales, images, c,
            )  # fmt: skip
            if a != b:
                _add_side(
                    b, a, factor_b, factor_a, starts, parts, part_starts, pattern_of_part, first,
                    last, scales, images, c,
                )  # fmt: skip


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
    groups = (patterns + TOGETHER - 1) // TOGETHER
    for task in numba.prange(groups * channels):
        c, first = task % channels, task // channels * TOGETHER
        last = min(first + TOGETHER, patterns)
        for n in range(ray_a.shape[0]):
            a, b = ray_a[n], ray_b[n]
            pattern = pattern_of_ray[b]
            if first <= pattern < last:
                images[pattern, c, a] += values[c, n]
            pattern = pattern_of_ray[a]
            if a != b and first <= pattern < last:
                images[pattern, c, b] += values[c, n]
