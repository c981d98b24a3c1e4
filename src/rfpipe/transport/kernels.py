"""Compiled kernels of the hierarchical tensor: applying leaves, and truncating them.

All images and factors are planar and in tree order: channels first, rays contiguous.
"""

from __future__ import annotations

import numba
import numpy as np

_FAST = {"reassoc", "contract", "nsz", "arcp"}


@numba.njit(cache=True, fastmath=_FAST)
def _dot(factor, weights):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(factor.shape[0]):
        total += np.float64(factor[k]) * np.float64(weights[k])
    return total


@numba.njit(cache=True, fastmath=_FAST)
def _add_scaled(target, factor, scale):  # type: ignore[no-untyped-def]
    for k in range(factor.shape[0]):
        target[k] += factor[k] * scale


@numba.njit(cache=True, parallel=True)
def apply_leaves(starts, block_a, block_b, offset_a, offset_b, values, bounds, patterns, out):  # type: ignore[no-untyped-def]
    """Add ``T p`` of the rank-1 leaves of one level to private images, one set a share of leaves.

    Parameters
    ----------
    starts : int64 (n_blocks + 1,)
        First tree position of each block of the level.
    block_a, block_b : int32 (n,)
        The two blocks of each leaf; equal on the diagonal.
    offset_a, offset_b : int64 (n,)
        Where the leaf's two factors begin in `values`.
    values : float32 (C, n_values)
    bounds : int64 (shares + 1,)
        Leaves ``bounds[s]:bounds[s + 1]`` belong to share ``s``. The shares do not depend on the
        number of threads, so the sums are the same on every machine.
    patterns : float32 (P, C, N)
    out : float32 (shares, P, C, N)
        Added to in place.
    """
    for share in numba.prange(bounds.shape[0] - 1):
        for n in range(bounds[share], bounds[share + 1]):
            a0, a1 = starts[block_a[n]], starts[block_a[n] + 1]
            b0, b1 = starts[block_b[n]], starts[block_b[n] + 1]
            for c in range(values.shape[0]):
                factor_a = values[c, offset_a[n] : offset_a[n] + a1 - a0]
                factor_b = values[c, offset_b[n] : offset_b[n] + b1 - b0]
                for p in range(patterns.shape[0]):
                    scale = _dot(factor_b, patterns[p, c, b0:b1])
                    if scale != 0.0:
                        _add_scaled(out[share, p, c, a0:a1], factor_a, np.float32(scale))
                    if block_a[n] != block_b[n]:
                        scale = _dot(factor_a, patterns[p, c, a0:a1])
                        if scale != 0.0:
                            _add_scaled(out[share, p, c, b0:b1], factor_b, np.float32(scale))


@numba.njit(cache=True, parallel=True)
def apply_scalars(ray_a, ray_b, values, bounds, patterns, out):  # type: ignore[no-untyped-def]
    """Add ``T p`` of the scalar leaves to private images; arguments as in `apply_leaves`.

    Parameters
    ----------
    ray_a, ray_b : int32 (n,)
        Tree positions of each scalar; ``ray_a <= ray_b``, each off-diagonal one counts both ways.
    values : float32 (C, n)
    """
    for share in numba.prange(bounds.shape[0] - 1):
        for p in range(patterns.shape[0]):
            for c in range(values.shape[0]):
                source = patterns[p, c]
                target = out[share, p, c]
                for n in range(bounds[share], bounds[share + 1]):
                    a, b = ray_a[n], ray_b[n]
                    target[a] += values[c, n] * source[b]
                    if a != b:
                        target[b] += values[c, n] * source[a]


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
