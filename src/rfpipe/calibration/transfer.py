"""The photon-transfer curve: gain, read noise and full well, from pairs of pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError

Double = NDArray[np.float64]

_DITHERED = 0.35
# Variance in squared steps of the converter from which on noise itself evens out rounding, which
# then adds a twelfth.

_RATIO = 1.12  # width of a bin: its upper edge over its lower one
_CLIP = 6.0  # standard deviations from which on a difference is no noise


class NoiseFit(NamedTuple):
    """Noise of a camera.

    Attributes
    ----------
    gain, gain_error : float
        Electrons a count.
    read, read_error : float
        Variance of the read noise in counts squared.
    misfit : float
        RMS of the relative difference between measured and fitted variances, beyond the noise.
    """

    gain: float
    gain_error: float
    read: float
    read_error: float
    misfit: float


def levels_of(count: int) -> list[float]:
    """Return weights of flat pictures, geometric from 1/256 to 1: few counts up to all of them."""
    return np.geomspace(1 / 256, 1, count).tolist() if count > 1 else [1.0]


def measure_transfer(
    levels: Iterable[NDArray[Any]],
    dark: Findings,
    exposures: Sequence[float],
    white_level: int,
    gamma: float = 1.0,
) -> Findings:
    """Measure gain and read noise.

    Parameters
    ----------
    levels : iterable of ndarray of uint16, shape (K, E, ...)
        K pictures each, two or more, of the same light; what is seen need not be flat, for fixed
        differences between photosites cancel in a pair's difference.
    dark : Findings
    exposures : sequence of float
        Seconds.
    white_level : int
        Full scale in counts.
    gamma : float
        Exponent of the camera's response: the curve is that of linearised counts.

    Returns
    -------
    Findings
        Numbers for the camera model; arrays of bins: ``signal``, ``variance``, ``error`` and the
        ``model``'s variance in counts, and which bins the fit ``used``.

    Raises
    ------
    CaptureError
        When there is no pair, or no light between darkness and saturation.

    Notes
    -----
    The variance of a pair's difference is twice that of one picture [EMVA 1288]. Photosites of all
    exposures and levels are sorted by their mean signal into bins; the mean difference of a bin is
    subtracted, so that a lamp that flickers between the two pictures adds no noise. Bins where
    rounding hides the noise are left out: where darkness is such a bin, the read noise is known
    by the curve's foot alone, and hardly matters.
    """
    black, good = dark["black_level_counts"], ~dark["hot"]
    span = white_level - black
    edges = [1.25]
    while edges[-1] < span:
        # two counts wide at least, a quarter above whole ones: rounding meets all fractions in it
        edges.append(np.floor(max(edges[-1] * _RATIO, edges[-1] + 2)) + 0.25)
    sums = np.zeros((4, len(edges) - 1))
    counts = np.zeros(white_level + 1, np.int64)
    for frames in levels:
        if len(frames) < 2:
            raise CaptureError(f"a level holds {len(frames)} picture; expected pairs, 2 or more")
        raw = frames[:, :, good]
        counts += np.bincount(raw.ravel(), minlength=len(counts))[: len(counts)]
        light = _linear(raw - black, span, gamma)
        for one, two in zip(light[::2], light[1::2], strict=False):
            for first, second in zip(one, two, strict=True):
                sums += _binned(first, second, np.array(edges))
    pairs, signals, squares, fourths = sums
    filled = np.maximum(pairs, 1)
    signal, variance = signals / filled, squares / filled
    error = np.sqrt(np.maximum(fourths / filled - variance**2, 0) / filled)
    step = _steps(signal, span, gamma)
    top, saturated = _saturation(counts, white_level)
    limit = float(_linear(np.array(top - black), span, gamma))
    noise = np.sqrt(variance)
    # darker photosites that noise lifted into a bin have less noise than its signal says
    used = (pairs >= 10) & (signal > 4 * noise) & (signal * _RATIO + _CLIP * noise < limit)
    used &= variance > _DITHERED * step**2
    if used.sum() < 2:
        raise CaptureError(
            "the flat pictures hold no light between darkness and saturation; check projector and "
            "lens, or choose other exposures"
        )
    bins = [values[used] for values in (signal, variance, pairs, step)]
    if gamma == 1:
        # dark frames, but those that light fills
        current = dark["current_counts_per_s"] * np.asarray(exposures, float)
        spread = np.asarray(dark["variance_counts2"])
        bare = (current < 0.1 * span) & (spread > _DITHERED)
        weight = np.full(len(current), float((dark["frames"] - 1) * good.sum()))
        added = current, spread, weight, np.ones(len(current))
        bins = [np.append(old, new[bare]) for old, new in zip(bins, added, strict=True)]
    fit = fit_noise(*bins)
    read_noise = fit.gain * np.sqrt(fit.read)
    read_error = fit.gain * fit.read_error / (2 * np.sqrt(max(fit.read, fit.read_error)))
    # what counts is the noise of darkness, to which the converter's steps belong
    of_darkness = fit.read_error / (2 * (fit.read + 1 / 12))
    numbers = (
        f"{fit.gain:.3g} +- {fit.gain_error:.2g} electrons a count, read noise {read_noise:.3g} +- "
        f"{read_error:.2g} electrons"
    )
    facts = {
        "electrons_per_count": fit.gain,
        "electrons_per_count_error": fit.gain_error,
        "read_noise_electrons": read_noise,
        "read_noise_error": read_error,
        "full_well_electrons": fit.gain * span,
        "dark_current_electrons": max(0.0, dark["current_counts_per_s"] * fit.gain),
        "dark_current_error": dark["current_error"] * fit.gain,
        "saturation_counts": top,
        "saturated": saturated,
        "misfit": fit.misfit,
        "known_within": 2 * max(fit.gain_error / fit.gain, of_darkness),
        "pairs": int(pairs.sum()),
        "numbers": numbers,
    }
    model = fit.read + signal / fit.gain + step**2 / 12
    arrays = {
        "signal": signal, "variance": variance, "error": error, "model": model, "used": used
    }  # fmt: skip
    return Findings.of("transfer", facts, arrays)


def fit_noise(signal: Double, variance: Double, pairs: Double, step: Double) -> NoiseFit:
    """Fit gain and read noise: variance = read noise^2 + signal / gain + step^2 / 12.

    Parameters
    ----------
    signal, variance : ndarray of float64, shape (n,)
        Of bins, n at least 2, in counts.
    pairs : ndarray of float64, shape (n,)
        Differences that each variance is of.
    step : ndarray of float64, shape (n,)
        The converter's step: 1, or more or less where a response was linearised.

    Notes
    -----
    Least squares, each bin weighted with its expected spread: the measured one goes with the
    measured variance, and would pull the fit down. Errors grow with the misfit where it is more
    than noise.
    """
    model = variance
    for _ in range(20):
        expected = model * np.sqrt(2 / pairs)
        (slope, read), covariance = np.polyfit(
            signal, variance - step**2 / 12, 1, w=1 / expected, cov="unscaled"
        )
        if read < 0:  # the best without any
            weight = signal / expected**2
            slope, read = float(weight @ (variance - step**2 / 12) / (weight @ signal)), 0.0
        slope = max(slope, 1e-9)
        model = read + slope * signal + step**2 / 12
    chi = np.square((variance - model) / expected)
    covariance *= max(1.0, float(chi.sum()) / max(1, len(chi) - 2))
    relative = np.square(variance / model - 1) - 2 / pairs
    misfit = np.sqrt(max(0.0, np.average(relative, weights=pairs)))
    slope_error, read_error = np.sqrt(np.diag(covariance))
    return NoiseFit(1 / slope, slope_error / slope**2, read, read_error, float(misfit))


def _linear(counts: Double, span: float, gamma: float) -> Double:
    """Return the signal of counts above black, in linear counts."""
    if gamma == 1:
        return counts
    return np.asarray(span * np.copysign(np.abs(counts / span) ** gamma, counts))


def _steps(signal: Double, span: float, gamma: float) -> Double:
    """Return the converter's step at a signal, in linear counts."""
    return gamma * np.maximum(signal / span, 1e-9) ** (1 - 1 / gamma)


def _binned(first: Double, second: Double, edges: Double) -> Double:
    """Gather a pair of pictures (n,) in bins of its mean.

    Returns
    -------
    ndarray of float64, shape (4, bins)
        Number of pairs; sums of the signal, of half the squared difference, and of its square.
    """
    bins, signal = len(edges) - 1, (first + second) / 2
    at = np.searchsorted(edges, signal) - 1
    kept = (at >= 0) & (at < bins)
    at, signal, rest = at[kept], signal[kept], (second - first)[kept]
    for _ in range(2):
        pairs = np.bincount(at, minlength=bins)
        rest = rest - (np.bincount(at, rest, bins) / np.maximum(pairs, 1))[at]
        noise = np.sqrt(np.bincount(at, rest**2, bins) / np.maximum(pairs, 1))
        kept = np.abs(rest) <= _CLIP * noise[at]
        at, signal, rest = at[kept], signal[kept], rest[kept]
    pairs = np.bincount(at, minlength=bins).astype(np.float64)
    # the mean difference takes one of the pairs' degrees of freedom
    squares = rest**2 / 2 * (pairs / np.maximum(pairs - 1, 1))[at]
    sums = (np.bincount(at, values, bins) for values in (signal, squares, squares**2))
    return np.stack([pairs, *sums]) * (pairs > 1)


def _saturation(counts: NDArray[np.int64], white_level: int) -> tuple[float, bool]:
    """Return the count at which photosites pile up, or full scale, and whether they do."""
    top = int(np.flatnonzero(counts)[-1])
    below = counts[max(0, top - 40) : max(1, top - 8)]
    piled = int(counts[max(0, top - 8) :].sum())
    if top >= white_level or piled > 10 * max(1.0, 8 * float(below.mean())):
        return float(top), True
    return float(white_level), False
