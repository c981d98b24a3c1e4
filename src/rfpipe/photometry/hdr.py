"""The maximum-likelihood merge of a bracket, with its variance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["merge_bracket"]

Float = NDArray[np.float32]

ROUNDS = 2
"""Rounds of weights from the pooled estimate; a third changes the result by less than a thousandth
of its standard deviation (RMS), a hundredth at most."""

UNKNOWN_DEVIATION = 0.125
"""Standard deviation of a sample saturated in every exposure, in units of the full scale. That
it is light is known, how much is not: the value is significant, eight deviations among any number
of measurements, and its weight small."""


def merge_bracket(
    electrons: Float,
    usable: NDArray[np.bool_],
    collection: Sequence[float],
    noise: Sequence[Float],
    full_scale: float,
) -> tuple[Float, Float, int]:
    """Merge a bracket into the most likely radiance of each sample.

    Parameters
    ----------
    electrons : ndarray of float32, shape (E, ...)
        Signal of each exposure in electrons, the all-off frame subtracted, response linear.
    usable : ndarray of bool, shape (E, ...)
        False where the raw count was saturated.
    collection : sequence of float, length E
        Electrons that a radiance of 1 gives in each exposure, above 0, ascending.
    noise : sequence of E ndarrays of float32, shape (...) or ()
        Variance in electrons squared of all but the signal's own shot noise, above 0.
    full_scale : float
        Radiance that saturates the shortest exposure, above 0.

    Returns
    -------
    radiance, variance : ndarray of float32, shape (...)
        Finite everywhere.
    saturated : int
        Samples saturated in every exposure: they get the shortest exposure's (clipped) value and
        a standard deviation of `UNKNOWN_DEVIATION`.

    Notes
    -----
    With electrons ``e_i = k_i L + noise`` of variance ``k_i L + n_i``, the estimate is
    ``L = sum(w_i e_i) / sum(w_i k_i)``, ``w_i = k_i / (k_i L + n_i)``, of variance
    ``1 / sum(w_i k_i)``. The ``L`` in the weights is the pooled estimate, never the exposure's
    own noisy count: there, a count that came out low by chance would seem the less noisy and get
    more weight, which biases dark samples towards zero. The first ``L`` is the most likely one
    for shot noise alone, ``sum(e_i) / sum(k_i)``.
    """
    samples = electrons.shape[1:]
    signal = electrons * usable
    lost = ~usable.any(axis=0)
    estimate = np.zeros(samples, np.float32)
    precision = np.zeros(samples, np.float32)
    for k, e, u in zip(collection, signal, usable, strict=True):
        estimate += e
        precision += u * np.float32(k)
    for _ in range(ROUNDS):
        np.divide(estimate, precision, out=estimate, where=~lost)
        np.maximum(estimate, 0, out=estimate)
        pooled = estimate
        estimate = np.zeros(samples, np.float32)
        precision = np.zeros(samples, np.float32)
        for k, n, e, u in zip(collection, noise, signal, usable, strict=True):
            weight = pooled * np.float32(k)
            weight += n
            np.divide(np.float32(k), weight, out=weight)
            estimate += weight * e
            weight *= u * np.float32(k)
            precision += weight
    precision[lost] = 1
    estimate /= precision
    variance = np.reciprocal(precision)
    saturated = int(np.count_nonzero(lost))
    if saturated:
        estimate[lost] = electrons[0][lost] / np.float32(collection[0])
        variance[lost] = np.float32((UNKNOWN_DEVIATION * full_scale) ** 2)
    return estimate, variance, saturated
