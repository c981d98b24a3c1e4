"""Fitting the noise of a camera to binned variances, rounding included."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bins", "NoiseFit", "fit_noise", "rounded_variance"]

Double = NDArray[np.float64]

TERMS = 200
"""Terms of the series for rounding; enough for noise above a thousandth of a count."""

DITHERED = 0.3
"""Variance in steps squared from which on noise itself spreads what is rounded; darkness, which
has the same fraction of a count everywhere, is not used below."""

ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Bins:
    """Pairs of photosites, sorted by signal; counts.

    Attributes
    ----------
    pairs, signals, squares, fourths : ndarray of float64, shape (n,)
        Number of pairs; sums over them of the signal, of half the squared difference, and of its
        square.
    steps : ndarray of float64, shape (n,)
        The converter's step: 1 count, or more or less where a response was linearised.
    """

    pairs: Double
    signals: Double
    squares: Double
    fourths: Double
    steps: Double

    @classmethod
    def none(cls, count: int) -> Bins:
        """Return bins without pairs."""
        pairs, signals, squares, fourths = np.zeros((4, count))
        return cls(pairs, signals, squares, fourths, np.ones(count))

    def plus(self, other: Bins) -> Bins:
        """Return the pairs of both."""
        return replace(self._each(np.add, other), steps=self.steps)

    def joined(self, other: Bins | None) -> Bins:
        """Return the bins of both, one after the other."""
        return self if other is None else self._each(np.append, other)

    def chosen(self, mask: NDArray[np.bool_]) -> Bins:
        """Return some of the bins."""
        return self._each(lambda values: values[mask])

    def replaced_by(self, other: Bins, mask: NDArray[np.bool_]) -> Bins:
        """Return the bins with another's where masked."""
        return self._each(lambda own, others: np.choose(mask, (own, others)), other)

    def averaged(self, group: int) -> Bins:
        """Return bins of `group` neighbours each, all with one weight; empty where one lacks."""
        pairs = self.pairs.reshape(-1, group)
        # the mean of unequal ones spreads like that of as many as their harmonic mean
        least = np.maximum(pairs, 1)
        whole = np.where((pairs > 1).all(axis=1), group**2 / (1 / least).sum(axis=1), 0)

        def mean(sums: Double) -> Double:
            values = sums.reshape(-1, group) / least
            return np.asarray(whole * values.mean(axis=1))

        return replace(self._each(mean), pairs=whole, steps=np.ones_like(whole))

    @property
    def signal(self) -> Double:
        """Mean signal of each bin."""
        return np.asarray(self.signals / np.maximum(self.pairs, 1))

    @property
    def variance(self) -> Double:
        """Variance of one picture in each bin."""
        return np.asarray(self.squares / np.maximum(self.pairs, 1))

    @property
    def error(self) -> Double:
        """Standard error of that variance, from its own spread."""
        spread = self.fourths / np.maximum(self.pairs, 1) - self.variance**2
        return np.sqrt(np.maximum(spread, 0) / np.maximum(self.pairs, 1))

    def _each(self, change: Callable[..., NDArray[Any]], *others: Bins) -> Bins:
        """Return what becomes of each array, together with those of other bins."""
        names = [field.name for field in fields(self)]
        return Bins(*(change(*(getattr(bins, n) for bins in (self, *others))) for n in names))


@dataclass(frozen=True)
class NoiseFit:
    """Noise of a camera.

    Attributes
    ----------
    gain, gain_error : float
        Electrons a count.
    read_noise, read_noise_error : float
        Electrons.
    misfit : float
        RMS of the relative difference between the curve and its fit, beyond the noise.
    """

    gain: float
    gain_error: float
    read_noise: float
    read_noise_error: float
    misfit: float

    def predicted(self, bins: Bins) -> Double:
        """Return the variance of each bin, in counts squared."""
        counts = (self.read_noise / self.gain) ** 2 + bins.signal / self.gain
        return rounded_variance(np.maximum(counts, 0), bins.steps)[0]


def rounded_variance(variance: Double, steps: Double) -> tuple[Double, Double]:
    """Return the expected variance after rounding, and its derivative by that before.

    Parameters
    ----------
    variance : ndarray of float64
        Before rounding, at least 0.
    steps : ndarray of float64
        What is rounded to.

    Notes
    -----
    Half the mean squared difference of two rounded pictures, over photosites whose means have all
    fractions of a step alike: with a difference d of whole part k and fraction f it is
    ``k^2 (1 - f) + (k + 1)^2 f = d^2 + f (1 - f)``. With the Fourier series of ``f (1 - f)`` and a
    Gaussian d: ``v + 1/12 - sum(exp(-4 pi^2 k^2 v) / k^2) / (2 pi^2)``. For much noise that is
    the usual 1/12; for little, deviation over the root of pi, far more than the variance.
    """
    level = variance / steps**2
    k = np.arange(1, TERMS + 1)[:, None] ** 2
    decay = np.exp(-4 * np.pi**2 * k * level)
    rounded = level + 1 / 12 - (decay / k).sum(axis=0) / (2 * np.pi**2)
    # the series cut off adds what its other terms would take away at no noise at all
    rounded -= 1 / 12 - (1 / k).sum() / (2 * np.pi**2)
    return rounded * steps**2, 1 + 2 * decay.sum(axis=0)


def fit_noise(bins: Bins, dark: Bins | None = None) -> NoiseFit:
    """Fit gain and read noise: variance = read noise^2 + signal / gain, then rounded.

    Parameters
    ----------
    bins : Bins
        Two or more with light.
    dark : Bins, optional
        Of dark frames; used where their noise is not hidden by the converter's steps.

    Returns
    -------
    NoiseFit

    Notes
    -----
    Least squares, each bin weighted with its expected spread, by Fisher scoring; errors grow with
    the misfit where it is more than noise.
    """
    if dark is not None:
        dark = dark.chosen(dark.variance > DITHERED)
    joined = bins.joined(dark)
    signal, measured, pairs = joined.signal, joined.variance, joined.pairs
    slope = max(float(np.median(measured / np.maximum(signal, 0.1))), 1e-9)
    read = max(float(measured[np.argmin(signal)]) - float(signal.min()) * slope, 1e-4)
    for _ in range(ROUNDS):
        model, derivative = rounded_variance(read + slope * signal, joined.steps)
        # half the squares of differences that are 0 or 1, of mean v, spread by v / 2 - v^2; those
        # of Gaussian ones by 2 v^2. The expected spread: the measured one goes with the measured
        # variance, and would pull the fit down
        weight = pairs / np.maximum(2 * model**2, joined.steps**2 * model / 2 - model**2)
        design = derivative[:, None] * np.stack([signal, np.ones_like(signal)], axis=1)
        covariance = np.linalg.pinv(design.T @ (weight[:, None] * design), hermitian=True)
        change = covariance @ design.T @ (weight * (measured - model))
        slope = float(np.clip(slope + change[0], slope / 2, 2 * slope))
        read = float(np.clip(read + change[1], read / 4, 4 * read + slope))
    misses = weight * (measured - model) ** 2
    freedom = max(1, len(misses) - 2)
    covariance = covariance * max(1.0, float(misses.sum()) / freedom)
    relative = np.square(measured / model - 1) - 1 / (weight * model**2)
    misfit = float(np.sqrt(max(0.0, np.average(relative, weights=pairs))))
    gain, deviation = 1 / slope, np.sqrt(read)
    # read noise in electrons is sqrt(read) / slope
    by = np.array([-deviation / slope**2, 1 / (2 * deviation * slope)])
    return NoiseFit(
        gain,
        float(np.sqrt(covariance[0, 0])) / slope**2,
        float(deviation * gain),
        float(np.sqrt(by @ covariance @ by)),
        misfit,
    )
