"""Compiled kernel of the bracket merge: the arithmetic of `rfpipe.photometry.hdr`, in one pass."""

from __future__ import annotations

import numba
import numpy as np

_SAMPLES = 1024  # a block's intermediates stay in the first-level cache


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _to_electrons(  # type: ignore[no-untyped-def]
    counts, dark, fixed, table, steps, gain, signal, noise
):
    """Turn counts into electrons above the all-off frame, with the noise that isn't theirs."""
    if table.shape[0] == 0:
        for i in range(counts.shape[0]):
            signal[i] = (np.float32(counts[i]) - dark[i]) * gain
            noise[i] = fixed[i]
    else:
        for i in range(counts.shape[0]):
            signal[i] = table[counts[i]] - dark[i]
            noise[i] = fixed[i] + steps[counts[i]]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _weigh(  # type: ignore[no-untyped-def]
    electrons, collected, variances, collection, length, pooled, estimate, precision
):
    """Do a round of weights from the pooled estimate; see `hdr.merge_bracket`."""
    zero, one = np.float32(0), np.float32(1)
    for i in range(length):
        known = precision[i] if precision[i] > zero else one
        pooled[i] = max(estimate[i] / known, zero)
        estimate[i] = zero
        precision[i] = zero
    for k in range(collection.shape[0]):
        signal, used, noise, collects = electrons[k], collected[k], variances[k], collection[k]
        for i in range(length):
            weight = collects / (pooled[i] * collects + noise[i])
            estimate[i] += weight * signal[i]
            precision[i] += weight * used[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def merge_counts(  # type: ignore[no-untyped-def]
    frames, background, noise, table, steps, gain, usable_below, collection, lost_variance, rounds,
    radiance, variance,
):  # fmt: skip
    """Merge brackets of counts; the same bits as `hdr.merge_bracket`, sample by sample.

    Parameters
    ----------
    frames : uint16 (B, E, n)
    background, noise : float32 (E, n)
        Of the all-off frame: counts for a linear camera (an empty `table`), else electrons; and
        the variance in electrons squared that doesn't come from the signal.
    table, steps : float32, one entry a count
        Electrons behind a count, and the variance of the converter's step there.
    gain : float32
        Electrons a count of a linear camera.
    usable_below : uint16
        Counts from here on are saturated.
    collection : float32 (E,)
    lost_variance : float32
        Of samples that are saturated in every exposure.
    rounds : int
        Rounds of weights.
    radiance, variance : float32 (B, n)
        The result.

    Returns
    -------
    int
        Samples saturated in every exposure.
    """
    zero, one = np.float32(0), np.float32(1)
    count, exposures, size = frames.shape
    # each an array of its own: the compiler then knows that they don't overlap, and vectorises
    electrons = np.empty((exposures, _SAMPLES), np.float32)
    collected = np.empty((exposures, _SAMPLES), np.float32)
    variances = np.empty((exposures, _SAMPLES), np.float32)
    estimate = np.empty(_SAMPLES, np.float32)
    precision = np.empty(_SAMPLES, np.float32)
    pooled = np.empty(_SAMPLES, np.float32)
    saturated = 0
    for first in range(0, size, _SAMPLES):
        length = min(_SAMPLES, size - first)
        block = slice(first, first + length)
        for p in range(count):
            for i in range(length):
                estimate[i] = zero
                precision[i] = zero
            for k in range(exposures):
                counts, signal, used, collects = (
                    frames[p, k, block], electrons[k], collected[k], collection[k],
                )  # fmt: skip
                _to_electrons(
                    counts, background[k, block], noise[k, block], table, steps, gain, signal,
                    variances[k],
                )  # fmt: skip
                for i in range(length):
                    signal[i] = signal[i] if counts[i] < usable_below else zero
                    used[i] = collects if counts[i] < usable_below else zero
                    estimate[i] += signal[i]
                    precision[i] += used[i]
            for _ in range(rounds):
                _weigh(
                    electrons, collected, variances, collection, length, pooled, estimate, precision
                )
            result, spread = radiance[p, block], variance[p, block]
            lost = 0
            for i in range(length):
                lost += precision[i] == zero
                known = precision[i] if precision[i] > zero else one
                result[i] = estimate[i] / known
                spread[i] = one / known
            if lost:
                saturated += lost
                _to_electrons(
                    frames[p, 0, block], background[0, block], noise[0, block], table, steps, gain,
                    pooled, variances[0],
                )  # fmt: skip
                for i in range(length):
                    if precision[i] == zero:
                        result[i] = pooled[i] / collection[0]
                        spread[i] = lost_variance
    return saturated
