"""Kernels of footprint acquisition: over camera pixels' candidates, and over pairs of functions.

A camera pixel's candidates are the projector pixels that may light it directly:
``rays[starts[i] : starts[i + 1]]``. `lit` are the patterns, float32 (projector pixels, M): a
candidate's row is what it shows over time.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from rfpipe.methods.footprints.typed import Double, Float, Int32, Int64

# Weights are found to this part of the largest, in so many sweeps at most.
_FINE, _SWEEPS = 1e-4, 300


@njit(cache=True, nogil=True)
def _gram(rays: Int32, lit: Float, certainty: Float) -> Double:
    """Return ``A^T W A`` of a pixel's candidates."""
    count = len(rays)
    gram = np.empty((count, count))
    for a in range(count):
        for b in range(a + 1):
            total = 0.0
            for m in range(lit.shape[1]):
                total += certainty[m] * lit[rays[a], m] * lit[rays[b], m]
            gram[a, b] = gram[b, a] = total
    return gram


@njit(cache=True, nogil=True)
def solve_weights(
    starts: Int64,
    rays: Int32,
    ridge: Float,
    expected: Float,
    lit: Float,
    certainty: Float,
    seen: Float,
    least: float,
) -> Float:
    """Return each pixel's non-negative least-squares weights, by coordinate descent.

    Parameters
    ----------
    starts, rays
        Candidates.
    ridge, expected : ndarray of float32, shape (candidates,)
        Inverse variance of each weight, and about what.
    lit : ndarray of float32, shape (projector pixels, M)
    certainty, seen : ndarray of float32, shape (pixels, M)
        Inverse variances of the pictures, and the pictures.
    least : float
        Weights that explain less than this of a pixel's squared standard deviations are 0.
    """
    weights = np.zeros(len(rays), np.float32)
    for pixel in range(len(starts) - 1):
        first, last = starts[pixel], starts[pixel + 1]
        count = last - first
        if count == 0:
            continue
        own = rays[first:last]
        gram = _gram(own, lit, certainty[pixel])
        goal = np.zeros(count)
        for a in range(count):
            for m in range(lit.shape[1]):
                goal[a] += certainty[pixel, m] * lit[own[a], m] * seen[pixel, m]
        found, rest = np.zeros(count), goal.copy()
        for _ in range(_SWEEPS):
            change, largest = 0.0, 0.0
            for a in range(count):
                stiff = gram[a, a] + ridge[first + a]
                pulled = ridge[first + a] * (expected[first + a] - found[a])
                new = max(0.0, found[a] + (rest[a] + pulled) / stiff)
                step = new - found[a]
                if step != 0.0:
                    found[a] = new
                    for b in range(count):
                        rest[b] -= gram[a, b] * step
                change, largest = max(change, abs(step)), max(largest, new)
            if change <= _FINE * largest:
                break
        gain = 0.0
        for a in range(count):
            gain += found[a] * (goal[a] + rest[a])
        if gain >= least:
            weights[first:last] = found
    return weights


@njit(cache=True, nogil=True)
def marginal(
    starts: Int64, rays: Int32, variance: Float, lit: Float, certainty: Float, places: Int64
) -> tuple[Double, Float]:
    """Return what takes unknown weights out of each pixel's pictures, and its precision's trace.

    The precision of pixel i is ``W - W A H A^T W`` with ``H = (G^-1 + A^T W A)^-1``, G the weights'
    variances.

    Parameters
    ----------
    starts, rays
        Candidates.
    variance : ndarray of float32, shape (candidates,)
        Of each weight.
    lit, certainty
        As for `solve_weights`.
    places : ndarray of int64, shape (pixels + 1,)
        Where each pixel's H begins.

    Returns
    -------
    ndarray of float64, shape (places[-1],)
        H of all pixels. In float32 the precision would not be positive where pictures are exact.
    ndarray of float32, shape (pixels,)
    """
    inverses = np.empty(places[-1])
    trace = np.empty(len(starts) - 1, np.float32)
    for pixel in range(len(starts) - 1):
        first, last = starts[pixel], starts[pixel + 1]
        own, count = rays[first:last], last - first
        total = 0.0
        for m in range(lit.shape[1]):
            total += certainty[pixel, m]
        if count:
            gram = _gram(own, lit, certainty[pixel])
            for a in range(count):
                gram[a, a] += 1 / variance[first + a]
            inverse = np.linalg.inv(gram)
            squares = _gram(own, lit, certainty[pixel] * certainty[pixel])
            for a in range(count):
                for b in range(count):
                    total -= inverse[a, b] * squares[a, b]
            inverses[places[pixel] : places[pixel + 1]] = inverse.ravel()
        trace[pixel] = max(total, 0.0)
    return inverses, trace


@njit(cache=True, nogil=True, fastmath=True)
def apply_precision(
    starts: Int64,
    rays: Int32,
    inverses: Double,
    places: Int64,
    lit: Float,
    certainty: Float,
    seen: Float,
) -> Float:
    """Return each pixel's precision times its pictures, (pixels, M)."""
    out = np.empty_like(seen)
    count_all = seen.shape[1]
    for pixel in range(len(starts) - 1):
        first, last = starts[pixel], starts[pixel + 1]
        count = last - first
        for m in range(count_all):
            out[pixel, m] = certainty[pixel, m] * seen[pixel, m]
        if count == 0:
            continue
        told = np.empty(count)
        for a in range(count):
            total = 0.0
            for m in range(count_all):
                total += np.float64(lit[rays[first + a], m]) * certainty[pixel, m] * seen[pixel, m]
            told[a] = total
        back = np.zeros(count_all)
        for a in range(count):
            weight = 0.0
            row = places[pixel] + a * count
            for b in range(count):
                weight += inverses[row + b] * told[b]
            for m in range(count_all):
                back[m] += weight * lit[rays[first + a], m]
        for m in range(count_all):
            out[pixel, m] = certainty[pixel, m] * (seen[pixel, m] - back[m])
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
def couple_one_way(first: Int32, second: Int32, cores: Float, light: Float, out: Float) -> None:
    """Add to `out` what functions of one side send to those of the other."""
    for pair in range(len(first)):
        a, b = first[pair], second[pair]
        for m in range(light.shape[1]):
            out[a, m] += cores[pair] * light[b, m]


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


@njit(cache=True, nogil=True, fastmath=True)
def correlate_one_way(first: Int32, second: Int32, seen: Float, light: Float, out: Float) -> None:
    """Write the adjoint of `couple_one_way` by cores."""
    for pair in range(len(first)):
        total = np.float32(0)
        for m in range(light.shape[1]):
            total += seen[first[pair], m] * light[second[pair], m]
        out[pair] = total
