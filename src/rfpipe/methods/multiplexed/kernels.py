"""Compiled sparse Bayesian regression of the blocks that light a camera pixel."""

from __future__ import annotations

import numba
import numpy as np

from rfpipe.array_types import Double, Float, Index, Numbers


@numba.njit(cache=True, nogil=True, fastmath=True)
def fit_pixels(
    means: Float,
    starts: Index,
    blocks: Numbers,
    radiance: Double,
    noise: Double,
    variance: Double,
    iterations: int,
    light: Double,
) -> None:
    """Fit the light of the blocks of each pixel; write `light` and `variance`.

    For the radiance c of a pixel in all pictures, with the noise variances N, means A of the
    patterns over the pixel's blocks, and prior variances V of their light t,

        S = A V A^T + N,    t = V A^T S^-1 c,    var(t) = V - V A^T S^-1 A V

    Each iteration then replaces V by ``max(t, 0)^2 + var(t)``. Shapes: means (P, blocks of all
    levels); starts (pixels + 1,); blocks, variance and light (n,); radiance and noise (pixels, P).
    """
    for pixel in range(len(starts) - 1):
        first, last = starts[pixel], starts[pixel + 1]
        if first == last:
            continue
        A = _columns(means, blocks[first:last])
        V, t = variance[first:last], light[first:last]
        S, Y = np.empty((len(A), len(A))), np.empty_like(A)
        z = np.empty(len(A))
        for _ in range(iterations):
            Y[:] = A * V
            for p in range(len(A)):
                for q in range(p + 1):
                    S[p, q] = np.dot(Y[p], A[q])
                S[p, p] += noise[pixel, p]
            _solve_lower(S, Y, radiance[pixel], z)
            for k in range(len(t)):
                total, known = 0.0, 0.0
                for p in range(len(z)):
                    total += Y[p, k] * z[p]
                    known += Y[p, k] * Y[p, k]
                t[k] = total
                V[k] = max(total, 0.0) ** 2 + max(V[k] - known, 0.0)


@numba.njit(cache=True, nogil=True)
def _columns(means: Float, blocks: Numbers) -> Double:
    """Select columns of the means, (P, blocks)."""
    columns = np.empty((len(means), len(blocks)))
    for p in range(len(means)):
        for k in range(len(blocks)):
            columns[p, k] = means[p, blocks[k]]
    return columns


@numba.njit(cache=True, nogil=True, fastmath=True)
def _solve_lower(S: Double, Y: Double, c: Double, z: Double) -> None:
    """Factor ``S = L L^T`` in place, replace Y by ``L^-1 Y``, and write ``z = L^-1 c``."""
    for p in range(len(S)):
        z[p] = c[p]
        for q in range(p):
            total = S[p, q]
            for r in range(q):
                total -= S[p, r] * S[q, r]
            S[p, q] = total / S[q, q]
            z[p] -= S[p, q] * z[q]
            for k in range(Y.shape[1]):
                Y[p, k] -= S[p, q] * Y[q, k]
        total = S[p, p]
        for r in range(p):
            total -= S[p, r] * S[p, r]
        S[p, p] = np.sqrt(total)
        z[p] /= S[p, p]
        for k in range(Y.shape[1]):
            Y[p, k] /= S[p, p]
