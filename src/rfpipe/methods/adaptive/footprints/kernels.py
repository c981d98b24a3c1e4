"""Kernels of footprint acquisition: over camera pixels' candidates, and over pairs of functions.

A camera pixel's candidates are the projector pixels that may light it directly:
``rays[starts[i] : starts[i + 1]]``. `lit` are the patterns, float32 (projector pixels, M): a
candidate's row is what it shows over time.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from rfpipe.methods.adaptive.footprints.series import Double, Float, Int32, Int64

# What a weight would gain beyond this part of the most is not nothing.
_FINE = 1e-8


@njit(cache=True, nogil=True, fastmath=True)
def _gram(rays: Int32, lit: Float, certainty: Float) -> Double:
    """Return ``A^T W A`` of a pixel's candidates."""
    count = len(rays)
    gram, weighed = np.empty((count, count)), np.empty(lit.shape[1])
    for a in range(count):
        for m in range(len(weighed)):
            weighed[m] = certainty[m] * lit[rays[a], m]
        for b in range(a + 1):
            total, other = 0.0, lit[rays[b]]
            for m in range(len(weighed)):
                total += weighed[m] * other[m]
            gram[a, b] = gram[b, a] = total
    return gram


@njit(cache=True, nogil=True)
def solve_weights(
    starts: Int64,
    rays: Int32,
    ridge: Float,
    expected: Float,
    start: Float,
    lit: Float,
    certainty: Float,
    seen: Float,
    least: float,
) -> Float:
    """Return each pixel's non-negative least-squares weights, the sooner the better their `start`.

    Weights lie about what is `expected`, with inverse variances `ridge`, (candidates,) each.
    Pictures are what is `seen`, with inverse variances `certainty`, (pixels, M). Weights that
    explain less than `least` of a pixel's squared standard deviations are 0.
    """
    weights = np.zeros(len(rays), np.float32)
    for pixel in range(len(starts) - 1):
        first, last = starts[pixel], starts[pixel + 1]
        count = last - first
        if count == 0:
            continue
        pixel_rays = rays[first:last]
        gram = _gram(pixel_rays, lit, certainty[pixel])
        wanted, seen_goal = certainty[pixel] * seen[pixel], np.zeros(count)
        for a in range(count):
            for m in range(lit.shape[1]):
                seen_goal[a] += lit[pixel_rays[a], m] * wanted[m]
        stiff, goal = gram.copy(), seen_goal.copy()
        for a in range(count):
            stiff[a, a] += ridge[first + a]
            goal[a] += ridge[first + a] * expected[first + a]
        estimate = _not_negative(stiff, goal, start[first:last].astype(np.float64))
        if estimate @ (2 * seen_goal - gram @ estimate) >= least:
            weights[first:last] = estimate
    return weights


@njit(cache=True, nogil=True)
def _not_negative(stiff: Double, goal: Double, estimate: Double) -> Double:
    """Solve ``stiff x = goal`` for x of at least 0, from an `estimate` that is written over.

    By active sets (Lawson and Hanson, 1974): descent by coordinates would leave all to the first of
    places whose patterns are the same.
    """
    free = estimate > 0
    for _ in range(3 * len(goal)):
        while free.any():
            where = np.flatnonzero(free)
            before = estimate[where]
            after = np.linalg.solve(stiff[where][:, where], goal[where])
            share = np.ones(len(where))
            for k in range(len(where)):
                if after[k] <= 0:
                    share[k] = before[k] / (before[k] - after[k]) if before[k] > 0 else 0.0
            step = share.min()
            estimate[where] = before + step * (after - before)
            if step == 1.0:
                break
            estimate[where[share == step]] = 0
            free[where[share == step]] = False
        slope = goal - stiff @ estimate
        slope[free] = 0
        best = np.argmax(slope)
        if slope[best] <= _FINE * goal.max():
            break
        free[best] = True
    return estimate


@njit(cache=True, nogil=True)
def marginal(
    starts: Int64, rays: Int32, variance: Float, lit: Float, certainty: Float
) -> tuple[Double, Float]:
    """Return what takes unknown weights out of each pixel's pictures, and its precision's trace.

    The precision of pixel i is ``W - W A H A^T W`` with ``H = (G^-1 + A^T W A)^-1``, G the weights'
    variances: ``W - U^T U`` with ``U = C^-1 A^T W``, C the Cholesky factor of H's inverse. The U of
    all pixels are float64 (candidates, M): in float32 the precision would not be positive where
    pictures are exact.
    """
    factors = np.empty((len(rays), lit.shape[1]))
    trace = np.empty(len(starts) - 1, np.float32)
    for pixel in range(len(starts) - 1):
        first, last = starts[pixel], starts[pixel + 1]
        pixel_rays, count = rays[first:last], last - first
        total = 0.0
        for m in range(lit.shape[1]):
            total += certainty[pixel, m]
        if count:
            gram = _gram(pixel_rays, lit, certainty[pixel])
            for a in range(count):
                gram[a, a] += 1 / variance[first + a]
            lower = np.linalg.cholesky(gram)
            for a in range(count):
                row = factors[first + a]
                for m in range(lit.shape[1]):
                    row[m] = np.float64(lit[pixel_rays[a], m]) * certainty[pixel, m]
                for b in range(a):
                    for m in range(lit.shape[1]):
                        row[m] -= lower[a, b] * factors[first + b, m]
                for m in range(lit.shape[1]):
                    row[m] /= lower[a, a]
                    total -= row[m] * row[m]
        trace[pixel] = max(total, 0.0)
    return factors, trace


@njit(cache=True, nogil=True, fastmath=True)
def match_near(
    own: Float, boxes: Float, guesses: Double, reach: float, per_width: int, across: int
) -> tuple[Int64, Float]:
    """Find the box that each series resembles most among those near some places.

    Series and boxes, (n, M) and (widths x per_width, M), have length 1; boxes lie at half-pixel
    positions from 1/2, `across` of them in a row. `guesses` are rows and columns, (n, places, 2),
    NaN for none; a box is at most `reach` pixels from one along either axis. Returns the boxes'
    numbers and correlations, 0 where there is no place.
    """
    best, score = np.zeros(len(own), np.int64), np.zeros(len(own), np.float32)
    down = per_width // across
    for pixel in range(len(own)):
        for place in range(guesses.shape[1]):
            row, column = guesses[pixel, place]
            if np.isnan(row):
                continue
            top = max(0, int(np.ceil(2 * (row - reach) - 1)))
            bottom = min(down - 1, int(np.floor(2 * (row + reach) - 1)))
            left = max(0, int(np.ceil(2 * (column - reach) - 1)))
            right = min(across - 1, int(np.floor(2 * (column + reach) - 1)))
            for first in range(0, len(boxes), per_width):
                for y in range(top, bottom + 1):
                    for box in range(first + y * across + left, first + y * across + right + 1):
                        alike = np.float32(0)
                        for m in range(own.shape[1]):
                            alike += own[pixel, m] * boxes[box, m]
                        if alike > score[pixel]:
                            best[pixel], score[pixel] = box, alike
    return best, score


@njit(cache=True, nogil=True, fastmath=True)
def apply_precision(starts: Int64, factors: Double, certainty: Float, seen: Float) -> Float:
    """Return each pixel's precision, as `marginal` has it, times its pictures, (pixels, M)."""
    out = np.empty_like(seen)
    count = seen.shape[1]
    back = np.empty(count)
    for pixel in range(len(starts) - 1):
        back[:] = 0
        for candidate in range(starts[pixel], starts[pixel + 1]):
            total = 0.0
            for m in range(count):
                total += factors[candidate, m] * seen[pixel, m]
            for m in range(count):
                back[m] += total * factors[candidate, m]
        for m in range(count):
            out[pixel, m] = np.float64(certainty[pixel, m]) * seen[pixel, m] - back[m]
    return out


@njit(cache=True, nogil=True, fastmath=True)
def couple(first: Int32, second: Int32, even: Float, odd: Float, light: Float, out: Float) -> None:
    """Add ``S light`` to `out`: S has ``even + odd`` at (first, second), else ``even - odd``."""
    for pair in range(len(first)):
        a, b = first[pair], second[pair]
        there, back = even[pair] + odd[pair], even[pair] - odd[pair]
        for m in range(light.shape[1]):
            out[a, m] += there * light[b, m]
        if a != b:
            for m in range(light.shape[1]):
                out[b, m] += back * light[a, m]


@njit(cache=True, nogil=True, fastmath=True)
def correlate(
    first: Int32, second: Int32, seen: Float, light: Float, even: Float, odd: Float
) -> None:
    """Write the adjoint of `couple` by cores."""
    for pair in range(len(first)):
        a, b = first[pair], second[pair]
        there, back = np.float32(0), np.float32(0)
        for m in range(light.shape[1]):
            there += seen[a, m] * light[b, m]
            back += seen[b, m] * light[a, m]
        even[pair] = there if a == b else there + back
        odd[pair] = 0 if a == b else there - back
