"""Compiled kernels of the hierarchical tensor: applying leaves, and truncating them.

All images and factors are planar and in tree order: channels first, rays contiguous.

The sums of a task don't depend on the number of threads, nor on the other tasks.
"""

from __future__ import annotations

import numba
import numpy as np

_FAST = {"reassoc", "contract", "nsz", "arcp"}

# Up to this many rays a block is worked off ray by ray: setting up a vector loop takes longer.
_SHORT = 16

# Rays of a task that goes through images.
_PART = 2**14


@numba.njit(cache=True, fastmath=_FAST)
def _dot(factor, weights):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(factor.shape[0]):
        total += np.float64(factor[k]) * np.float64(weights[k])
    return np.float32(total)


@numba.njit(cache=True, fastmath=_FAST)
def _add_scaled(target, factor, scale):  # type: ignore[no-untyped-def]
    for k in range(factor.shape[0]):
        target[k] += factor[k] * scale


@numba.njit(cache=True, fastmath=_FAST)
def _add_scaled_and_dot(target, factor, scale, weights):  # type: ignore[no-untyped-def]
    """Do both in one pass over the factor."""
    total = 0.0
    for k in range(factor.shape[0]):
        total += np.float64(factor[k]) * np.float64(weights[k])
        target[k] += factor[k] * scale
    return np.float32(total)


@numba.njit(cache=True)
def _apply_short_leaf(a0, a1, b0, b1, values, at, source, target):  # type: ignore[no-untyped-def]
    """Apply a leaf over two small blocks; its values begin at `at`.

    All indices are unsigned, which saves a test for negative ones in each use.
    """
    of_a = at - a0
    if a0 == b0:
        scale = np.float32(0.0)
        for k in range(a0, a1):
            scale += values[of_a + k] * source[k]
        for k in range(a0, a1):
            target[k] += values[of_a + k] * scale
        return
    of_b = at + a1 - a0 - b0
    scale_a, scale_b = np.float32(0.0), np.float32(0.0)
    for k in range(b0, b1):
        scale_a += values[of_b + k] * source[k]
    for k in range(a0, a1):
        scale_b += values[of_a + k] * source[k]
        target[k] += values[of_a + k] * scale_a
    for k in range(b0, b1):
        target[k] += values[of_b + k] * scale_b


@numba.njit(cache=True)
def _apply_leaf(a0, a1, b0, b1, lit_a, lit_b, values, at, source, target):  # type: ignore[no-untyped-def]
    """Apply a leaf, its values from `at` on; they come from memory once, then from the cache."""
    factor_a = values[at : at + a1 - a0]
    if a0 == b0:
        _add_scaled(target[a0:a1], factor_a, _dot(factor_a, source[a0:a1]))
        return
    factor_b = values[at + a1 - a0 : at + a1 - a0 + b1 - b0]
    if not lit_a:
        _add_scaled(target[a0:a1], factor_a, _dot(factor_b, source[b0:b1]))
        return
    scale = _dot(factor_a, source[a0:a1])
    if not lit_b:
        _add_scaled(target[b0:b1], factor_b, scale)
        return
    scale = _add_scaled_and_dot(target[b0:b1], factor_b, scale, source[b0:b1])
    _add_scaled(target[a0:a1], factor_a, scale)


@numba.njit(cache=True)
def _apply_run(starts, block_a, block_b, first, last, values, at, lit, source, target):  # type: ignore[no-untyped-def]
    """Apply leaves ``first:last``, whose values begin at `at`, to one plane of one pattern."""
    for n in range(first, last):
        a, b = block_a[n], block_b[n]
        a0, a1, b0, b1 = starts[a], starts[a + 1], starts[b], starts[b + 1]
        if lit[a] or lit[b]:
            if a1 - a0 <= _SHORT and b1 - b0 <= _SHORT:
                _apply_short_leaf(
                    np.uint64(a0), np.uint64(a1), np.uint64(b0), np.uint64(b1), values,
                    np.uint64(at), source, target,
                )  # fmt: skip
            else:
                _apply_leaf(a0, a1, b0, b1, lit[a], lit[b], values, at, source, target)
        at += a1 - a0
        if a != b:
            at += b1 - b0


@numba.njit(cache=True, parallel=True)
def apply_leaves(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, values, channels, bounds, offsets, group, patterns, lit, out
):
    """Add ``T p`` of the rank-1 leaves of one level.

    A task is one share of the leaves, one plane and a group of patterns.

    Parameters
    ----------
    starts : int64 (n_blocks + 1,)
        First tree position of each block of the level.
    block_a, block_b : int32 (n,)
        The two blocks of each leaf; equal on the diagonal.
    values : float32 (C, n_values)
    channels : int64 (K,)
        The channel of each plane of the patterns.
    bounds, offsets : int64 (shares + 1, runs + 1)
        Leaves ``bounds[s, r]:bounds[s, r + 1]`` are run ``r`` of share ``s``; their values begin
        at ``offsets[s, r]``. A run is small enough to stay in the cache for a group of patterns.
    group : int
        Patterns of a task: a leaf's factors are fetched once for all of them.
    patterns : float32 (P, K, N)
    lit : uint8 (P, n_blocks)
        Whether a pattern lights a block; leaves between dark blocks aren't read.
    out : float32 (shares, P, K, N)
        Added to in place.
    """
    count, planes = patterns.shape[0], patterns.shape[1]
    groups = (count + group - 1) // group
    for task in numba.prange(bounds.shape[0] * planes * groups):
        share, plane = task // groups // planes, task // groups % planes
        first = task % groups * group
        factors = values[channels[plane]]
        for run in range(bounds.shape[1] - 1):
            for p in range(first, min(first + group, count)):
                _apply_run(
                    starts, block_a, block_b, bounds[share, run], bounds[share, run + 1], factors,
                    offsets[share, run], lit[p], patterns[p, plane], out[share, p, plane],
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
    count, planes = patterns.shape[0], patterns.shape[1]
    groups = (count + group - 1) // group
    for task in numba.prange(bounds.shape[0] * planes * groups):
        share, plane = task // groups // planes, task // groups % planes
        first = task % groups * group
        scalars = values[channels[plane]]
        for p in range(first, min(first + group, count)):
            source, target = patterns[p, plane], out[share, p, plane]
            for n in range(bounds[share, 0], bounds[share, -1]):
                a, b = np.uint64(ray_a[n]), np.uint64(ray_b[n])
                target[a] += scalars[n] * source[b]
                if a != b:
                    target[b] += scalars[n] * source[a]


@numba.njit(cache=True, parallel=True)
def lit_rays(patterns, out):  # type: ignore[no-untyped-def]
    """Tell which rays a pattern (P, K, N) lights in any plane, as uint8 (P, N)."""
    count, planes, rays = patterns.shape
    parts = (rays + _PART - 1) // _PART
    for task in numba.prange(count * parts):
        p, first = task // parts, task % parts * _PART
        lit = out[p, first : first + _PART]
        lit[:] = 0
        for plane in range(planes):
            light = patterns[p, plane, first : first + _PART]
            for n in range(lit.shape[0]):
                lit[n] |= np.uint8(light[n] != 0)


@numba.njit(cache=True, parallel=True)
def lit_parents(child_starts, lit, out):  # type: ignore[no-untyped-def]
    """Tell which blocks have a lit child: uint8 (P, children) to uint8 (P, blocks)."""
    for b in numba.prange(out.shape[1]):
        for p in range(lit.shape[0]):
            found = np.uint8(0)
            for child in range(child_starts[b], child_starts[b + 1]):
                found |= lit[p, child]
            out[p, b] = found


@numba.njit(cache=True, parallel=True)
def clear(images):  # type: ignore[no-untyped-def]
    """Set float32 (rows, N) to zero."""
    for row in numba.prange(images.shape[0]):
        images[row] = np.float32(0.0)


@numba.njit(cache=True, parallel=True)
def add_shares(sums, out):  # type: ignore[no-untyped-def]
    """Write the sum of the shares' images: float32 (shares, rows, N) to (rows, N)."""
    for row in numba.prange(out.shape[0]):
        target = out[row]
        target[:] = sums[0, row]
        for share in range(1, sums.shape[0]):
            _add_scaled(target, sums[share, row], np.float32(1.0))


@numba.njit(cache=True, parallel=True)
def reorder(images, index, out):  # type: ignore[no-untyped-def]
    """Write ``images[..., index]``: float32 (P, K, N) to contiguous (P, K, N)."""
    planes = images.shape[1]
    for row in numba.prange(images.shape[0] * planes):
        source, target = images[row // planes, row % planes], out[row // planes, row % planes]
        for n in range(index.shape[0]):
            target[n] = source[index[n]]


@numba.njit(cache=True)
def add_marginals(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, offset_a, offset_b, values, node, first_a, first_b, marginals
):
    """Add each leaf's row and column sums to those of the node above it.

    Parameters
    ----------
    starts, block_a, block_b, offset_a, offset_b, values
        As in `apply_leaves`.
    node : int64 (n,)
        The node above each leaf.
    first_a, first_b : int64 (n_nodes,)
        What to add to a tree position to find it in the node's two marginals; equal on the
        diagonal.
    marginals : float64 (C, n_marginals)
        Added to in place.
    """
    for n in range(block_a.shape[0]):
        a0, a1 = starts[block_a[n]], starts[block_a[n] + 1]
        b0, b1 = starts[block_b[n]], starts[block_b[n] + 1]
        for c in range(values.shape[0]):
            factor_a = values[c, offset_a[n] : offset_a[n] + a1 - a0]
            factor_b = values[c, offset_b[n] : offset_b[n] + b1 - b0]
            sum_a, sum_b = 0.0, 0.0
            for k in range(factor_a.shape[0]):
                sum_a += factor_a[k]
            for k in range(factor_b.shape[0]):
                sum_b += factor_b[k]
            at = first_a[node[n]] + a0
            for k in range(factor_a.shape[0]):
                marginals[c, at + k] += factor_a[k] * sum_b
            if block_a[n] != block_b[n]:
                at = first_b[node[n]] + b0
                for k in range(factor_b.shape[0]):
                    marginals[c, at + k] += factor_b[k] * sum_a
