"""Responses of the camera (linearity, photon transfer) and of the projector (light of codes)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.calibration.context import StepContext
from rfpipe.calibration.verdicts import Findings, with_error
from rfpipe.errors import CaptureError

_LEVELS = (1.0, 0.25, 1 / 16)  # weights of the flat pictures whose exposures are compared
_SIGNIFICANCE = 4.0  # standard errors beyond which exposures differ in one of many bins
_BINS = 12
_LEAST_PIXELS = 100  # smallest number of photosites in a bin that is compared
_EXPONENT_NOISE = 0.03  # accepted uncertainty of an exponent, and least difference from 1

_DITHERED = 0.35
# Variance, in squared steps of the converter, above which rounding is dithered by the noise and
# adds a variance of 1/12.

_RATIO = 1.12  # ratio of the edges of a bin
_CLIP = 6.0  # standard deviations beyond which a difference is an outlier


def measure_linearity(context: StepContext) -> Findings:
    """Compare each exposure with the next longer one, at all levels of counts.

    Each flat picture is taken twice: photosites are sorted into bins by their counts in one
    bracket, and compared in the other, so that the noise of the sorted counts causes no bias.

    Returns
    -------
    Findings
        Arrays (n,) over bins: ``level``, counts of the longer exposure as a fraction of full scale;
        ``deviation``, light measured in the shorter exposure, relative to the longer one, minus 1;
        ``error``, standard error of the deviation.

    Notes
    -----
    Only the black level is subtracted, since the light of the all-off picture is also proportional
    to the exposure time. For a response counts ~ light^(1/g), the counts of two exposures with the
    ratio r have the ratio ``r^(1/g)`` at all levels, which determines g.
    """
    model, dark, tolerance = context.model, context.findings["dark"], context.settings.tolerance / 2
    black, good = dark["black_level_counts"], ~dark["hot"]
    span, times = model.white_level - black, model.exposures[:2]
    # fixed pattern: counts of each photosite, extrapolated to an exposure time of 0
    fixed = np.polyfit(times, dark["black"][: len(times), good], len(times) - 1)[-1]
    fixed -= fixed.mean()
    ratios = np.divide(model.exposures[1:], model.exposures[:-1])
    sums = np.zeros((4, len(ratios), _BINS))
    pictures = [context.flat_picture(level) for level in _LEVELS for _ in range(2)]
    frames = context.brackets(pictures, len(pictures))
    for compared, sorting in zip(frames, frames, strict=False):
        signal, level = compared[:, good] - black - fixed, (sorting[:, good] - black) / span
        for k, ratio in enumerate(ratios):
            index = np.searchsorted(_edges(level[k + 1]), level[k + 1]) - 1
            inside = (index >= 0) & (index < _BINS)
            shorter, longer = signal[k : k + 2, inside]
            difference = shorter * ratio - longer  # fixed differences between photosites cancel
            sums[:, k] += _binned(index[inside], _BINS, shorter, longer, difference**2)
    filled = (sums[0] >= _LEAST_PIXELS) & (sums[1:3] > 0).all(axis=0)
    ratio = np.broadcast_to(ratios[:, None], filled.shape)[filled]
    count, short, long, squares = sums[:, filled]
    scatter = np.maximum(squares - (short * ratio - long) ** 2 / count, 0)
    error = (np.sqrt(scatter) + _rounding_offset(scatter / count, ratio, dark) * count) / long
    arrays = {"level": long / span / count, "deviation": short * ratio / long - 1, "error": error}
    # agreement needs precise levels; a disagreement may show at any level
    known = int((error < max(tolerance, 1e-3)).sum())
    facts = _exponent(short, long, ratio, error, tolerance) if filled.any() else {}
    linear = {"kind": "Linear", "response_gamma": 1.0, "compared_levels": known}
    return Findings.of("linearity", {**linear, **facts, "tolerance": tolerance}, arrays)


def _rounding_offset(variance: Double, ratio: Double, dark: Findings) -> Double:
    """Systematic error of a bin's mean counts by rounding, in counts, over `_SIGNIFICANCE`.

    Noise dithers the rounding. Without noise, means and black level are off by up to half a count,
    all in the same direction. Up to 1/4 of the measured variance may itself be due to rounding.
    """
    dither, dark_dither = (
        np.exp(-2 * np.pi**2 * np.maximum(noise - 1 / 4, 0)) / 2
        for noise in (variance / ratio**2, dark["variance_counts2"][0])
    )
    of_black = dark["black_level_error"] + dark_dither / _SIGNIFICANCE
    return np.asarray(dither / _SIGNIFICANCE * (ratio + 1) + of_black * (ratio - 1))


def _edges(level: Double) -> Double:
    """Edges of bins, (_BINS + 1,) fractions of full scale, at levels with few photosites.

    An edge through a frequent level would bias the bins: noise common to both brackets would be
    positive in the upper part of that level, and negative in the lower part.
    """
    # noise and black level dominate below this range, saturation above
    fine = np.geomspace(0.02, 0.9, 16 * (_BINS + 1) + 2)
    count = np.histogram(level, fine)[0]
    adjacent = (count[1:] + count[:-1]).reshape(_BINS + 1, 16)[:, 2:14]
    return np.asarray(fine[1:-1].reshape(_BINS + 1, 16)[range(_BINS + 1), adjacent.argmin(1) + 2])


def _exponent(
    short: Double, long: Double, ratio: Double, error: Double, tolerance: float
) -> dict[str, Any]:
    """Fit a power law to sums of counts of exposures, whose times have the given ratios."""

    def beyond(gamma: float) -> float:
        """Largest deviation beyond its error, after a power law is undone."""
        deviation = short**gamma * ratio / long**gamma - 1
        return float(np.maximum(np.abs(deviation) - _SIGNIFICANCE * error, 0).max())

    # one exponent for pairs of all ratios
    times, counts = (np.average(np.log(x), weights=error**-2) for x in (ratio, long / short))
    gamma, worst = float(times / max(counts, 1e-9)), beyond(1.0)
    facts: dict[str, Any] = {"worst_deviation": worst, "deviation": worst}
    uncertainty = np.average(error, weights=error**-2) / times
    is_known = uncertainty < _EXPONENT_NOISE < abs(gamma - 1)
    if worst > tolerance and is_known and 0.2 <= gamma <= 5 and beyond(gamma) <= tolerance:
        kind = f"Linear after a power law of exponent {gamma:.3g} is undone"
        facts |= {"response_gamma": gamma, "deviation": beyond(gamma), "kind": kind}
        facts["compared_levels"] = len(error)
    return facts


def measure_light(context: StepContext) -> Findings:
    """Measure the light of the projector's codes, from dark to bright, with full light before.

    Returns
    -------
    Findings
        Arrays: ``light`` (256,), monotone from 0 to 1, an interpolation of the ``measured`` medians
        of lit camera pixels at ``codes``, with standard errors ``error``.

    Raises
    ------
    CaptureError
        When no pixel is lit by code 255.
    """
    from scipy.interpolate import PchipInterpolator
    from scipy.optimize import isotonic_regression

    tolerance = context.settings.tolerance / 2
    codes = np.unique(np.rint(np.linspace(0, 255, context.settings.codes)).astype(np.int64))
    images = context.radiance([context.flat_picture(code / 255) for code in (255, *codes)])
    full, variance = next(images)
    lit = full > 10 * np.sqrt(variance)
    if not lit.any():
        raise CaptureError(
            "no camera pixel is lit by the projector's full light",
            remedy="check lamp, lens cap and exposures",
        )
    lit &= full > 0.5 * np.percentile(full[lit], 90)  # darker pixels would add noise only
    ratios = np.array([image[lit] / full[lit] for image, _ in images])
    measured = np.median(ratios, axis=1)
    # the standard error of a median is 1.2533 times the one of a mean
    error = 1.2533 * ratios.std(axis=1) / np.sqrt(ratios.shape[1])
    drift = float(measured[-1] - 1)
    measured /= measured[-1]  # relative to full light at the end, after the other codes
    monotone = isotonic_regression(measured, weights=np.maximum(error, 1e-6) ** -2.0).x
    monotone = (monotone - monotone[0]) / max(monotone[-1] - monotone[0], 1e-9)
    light = PchipInterpolator(codes, monotone)(np.arange(256))
    light = np.maximum.accumulate(np.clip(light, 0, 1))
    falls = np.diff(measured) + 4 * np.hypot(error[1:], error[:-1])
    over_noise = float(np.median(full[lit] / np.sqrt(variance[lit])))
    beyond = max(abs(drift) - 3 * float(error[-1]), 0.0)
    rises = measured[-1] - measured[0] >= 0.5
    facts = {
        "tolerance": tolerance,
        "over_noise": over_noise,
        "drift": drift,
        "drift_beyond_noise": None if over_noise < 30 else beyond,
        "falls_at_code": int(codes[1:][np.argmin(falls)]) if (falls < 0).any() else None,
        "usable_codes": int(np.count_nonzero(np.diff(light) > 1e-5)) if rises else 0,
        "code_of_half_light": float(np.interp(0.5, light, np.arange(256))),
    }
    arrays = {"codes": codes, "measured": measured, "error": error, "light": light}
    return Findings.of("light", facts, arrays)


def measure_transfer(context: StepContext) -> Findings:
    """Measure the photon-transfer curve: gain, read noise and full well, from pairs of pictures.

    The pictures' weights go from 1/256 to 1.

    Returns
    -------
    Findings
        Parameters of the camera model; arrays over bins: ``signal``, ``variance``, ``error`` and
        the ``model``'s variance in counts, and the mask ``used`` of fitted bins.

    Raises
    ------
    CaptureError
        When there is no light between darkness and saturation.

    Notes
    -----
    The variance of a pair's difference is twice the variance of one picture [EMVA 1288]. Photosites
    of all exposures and levels are sorted by their mean signal into bins; the mean difference of a
    bin is subtracted, so that flicker between the two pictures adds no noise. Bins in which
    rounding hides the noise are excluded; if dark frames are excluded by this, the read noise
    follows from the curve's lower end, and is negligible. Counts of a camera with a gamma are
    linearised first.
    """
    model, dark = context.model, context.findings["dark"]
    span, gamma = model.white_level - dark["black_level_counts"], model.response_gamma
    pairs, signal, variance, error = _transfer_curve(context)
    # step of the converter at each signal, in linear counts
    step = gamma * np.maximum(signal / span, 1e-9) ** (1 - 1 / gamma)
    used = _fitted_bins(pairs, signal, variance, step, span)
    if used.sum() < 2:
        raise CaptureError(
            "the flat pictures have no light between darkness and saturation",
            remedy="check projector and lens, or choose other exposures",
        )
    bins = [values[used] for values in (signal, variance, pairs, step)]
    if gamma == 1:
        dark_bins = _dark_bins(dark, model.exposures, span)
        bins = [np.append(*parts) for parts in zip(bins, dark_bins, strict=True)]
    fit = _fit_noise(*bins)
    electrons = fit.gain * np.sqrt(fit.read)
    electrons_error = fit.gain * fit.read_error / (2 * np.sqrt(max(fit.read, fit.read_error)))
    # relative error of the noise of darkness, which includes rounding
    dark_error = fit.read_error / (2 * (fit.read + 1 / 12))
    facts = {
        "electrons_per_count": fit.gain,
        "electrons_per_count_error": fit.gain_error,
        "full_well_electrons": fit.gain * span,
        "read_noise_electrons": electrons,
        "read_noise_error": electrons_error,
        "dark_current_electrons": max(0.0, dark["current_counts_per_s"] * fit.gain),
        "misfit": fit.misfit,
        "known_within": 2 * max(fit.gain_error / fit.gain, dark_error),
        "numbers": _numbers(fit.gain, fit.gain_error, electrons, electrons_error),
    }
    curve = fit.read + signal / fit.gain + step**2 / 12
    arrays = {
        "signal": signal, "variance": variance, "error": error, "model": curve, "used": used
    }  # fmt: skip
    return Findings.of("transfer", facts, arrays)


def _transfer_curve(context: StepContext) -> tuple[Double, Double, Double, Double]:
    """Take pairs of flat pictures, and sort their photosites into bins of the signal.

    Returns
    -------
    pairs, signal, variance, error : ndarray of float64, shape (bins,)
        Number of pairs, mean signal, variance of a picture and its standard error, in linear
        counts.
    """
    model, dark = context.model, context.findings["dark"]
    black, good = dark["black_level_counts"], ~dark["hot"]
    span, gamma = model.white_level - black, model.response_gamma
    edges = [1.25]
    while edges[-1] < span:
        # at least two counts wide, at 0.25 above integers, so that a bin has all rounding errors
        edges.append(np.floor(max(edges[-1] * _RATIO, edges[-1] + 2)) + 0.25)
    sums = np.zeros((4, len(edges) - 1))
    levels = np.geomspace(1 / 256, 1, context.settings.levels).repeat(2)
    pictures = [context.flat_picture(level) for level in levels]
    frames = context.brackets(pictures, len(pictures), linear=True)
    for brackets in zip(frames, frames, strict=False):
        for pair in zip(*(bracket[:, good] for bracket in brackets), strict=True):
            first, second = _linear(np.stack(pair) - black, span, gamma)
            sums += _spread(first, second, np.array(edges))
    pairs, signals, squares, fourths = sums
    filled = np.maximum(pairs, 1)
    variance = squares / filled
    error = np.sqrt(np.maximum(fourths / filled - variance**2, 0) / filled)
    return pairs, signals / filled, variance, error


def _fitted_bins(
    pairs: Double, signal: Double, variance: Double, step: Double, span: float
) -> NDArray[np.bool_]:
    """Select bins with enough pairs, neither too dark, nor saturated, nor dominated by rounding."""
    noise = np.sqrt(variance)
    # in dark bins, noise lifts darker photosites with less noise into a bin
    used = (pairs >= 10) & (signal > 4 * noise) & (signal * _RATIO + _CLIP * noise < span)
    # from the largest variance on, saturation clips the noise
    used &= signal <= signal[np.argmax(np.where(used, variance, 0))]
    return np.asarray(used & (variance > _DITHERED * step**2))


def _dark_bins(
    dark: Findings, exposures: Sequence[float], span: float
) -> tuple[Double, Double, Double, Double]:
    """Signal, variance, pairs and step of the dark frames, except those that light fills."""
    signal = dark["current_counts_per_s"] * np.asarray(exposures, float)
    variance = np.asarray(dark["variance_counts2"])
    usable = (signal < 0.1 * span) & (variance > _DITHERED)
    pairs = np.full(len(signal), float((dark["frames"] - 1) * (~dark["hot"]).sum()))
    return signal[usable], variance[usable], pairs[usable], np.ones(len(signal))[usable]


def _numbers(gain: float, gain_error: float, electrons: float, electrons_error: float) -> str:
    """Format gain and read noise with their errors; not a gain with an error above 100 %."""
    if gain_error >= gain:
        return "gain and read noise are unknown"
    read = with_error(electrons, electrons_error, "{:.3g}")
    return f"{gain:.3g} +- {gain_error:.2g} electrons per count, read noise {read} electrons"


class NoiseFit(NamedTuple):
    """Fit of a photon-transfer curve.

    Attributes
    ----------
    gain, gain_error : float
        Electrons per count.
    read, read_error : float
        Variance of the read noise in squared counts.
    misfit : float
        RMS of the relative difference between measured and fitted variances, beyond the noise.
    """

    gain: float
    gain_error: float
    read: float
    read_error: float
    misfit: float


def _fit_noise(signal: Double, variance: Double, pairs: Double, step: Double) -> NoiseFit:
    """Fit gain and read noise to bins (n,): variance = read noise^2 + signal / gain + step^2 / 12.

    Parameters
    ----------
    signal, variance : ndarray of float64, shape (n,)
    pairs : ndarray of float64, shape (n,)
        Number of differences in each variance.
    step : ndarray of float64, shape (n,)
        Step of the converter in linear counts, 1 for a linear camera.

    Notes
    -----
    Least squares, each bin weighted by the spread that the model expects: the measured spread is
    correlated with the measured variance and would bias the fit. Errors are scaled by the misfit
    where it exceeds the noise.
    """
    from scipy.optimize import nnls

    model = variance
    for _ in range(20):
        expected = model * np.sqrt(2 / pairs)
        line = np.stack([signal, np.ones_like(signal)], axis=1) / expected[:, None]
        (slope, read), _ = nnls(line, (variance - step**2 / 12) / expected)
        slope = max(slope, 1e-9)
        model = read + slope * signal + step**2 / 12
    chi = np.square((variance - model) / expected)
    covariance = np.linalg.inv(line.T @ line) * max(1.0, float(chi.sum()) / max(1, len(chi) - 2))
    relative = np.square(variance / model - 1) - 2 / pairs
    misfit = np.sqrt(max(0.0, np.average(relative, weights=pairs)))
    slope_error, read_error = np.sqrt(np.diag(covariance))
    return NoiseFit(1 / slope, slope_error / slope**2, read, read_error, float(misfit))


def _linear(counts: Double, span: float, gamma: float) -> Double:
    """Undo the camera's gamma for counts above black."""
    if gamma == 1:
        return counts
    return np.asarray(span * np.copysign(np.abs(counts / span) ** gamma, counts))


def _binned(index: NDArray[np.int64], bins: int, *values: Double) -> Double:
    """Number of items in each bin, and the sums of their values, (1 + values, bins)."""
    columns = [np.bincount(index, weights, bins) for weights in (None, *values)]
    return np.stack(columns).astype(float)


def _spread(first: Double, second: Double, edges: Double) -> Double:
    """Sum up a pair of pictures (n,) in bins of their mean.

    Returns
    -------
    ndarray of float64, shape (4, bins)
        Number of pairs, and sums of the signal, of the variance (half the squared difference), and
        of the squared variance.
    """
    bins, signal = len(edges) - 1, (first + second) / 2
    index = np.searchsorted(edges, signal) - 1
    inside = (index >= 0) & (index < bins)
    index, signal, difference = index[inside], signal[inside], (second - first)[inside]
    for _ in range(2):
        pairs, total = _binned(index, bins, difference)
        difference = difference - (total / np.maximum(pairs, 1))[index]
        noise = np.sqrt(_binned(index, bins, difference**2)[1] / np.maximum(pairs, 1))
        inlier = np.abs(difference) <= _CLIP * noise[index]
        index, signal, difference = index[inlier], signal[inlier], difference[inlier]
    pairs = np.bincount(index, minlength=bins)
    # subtracting the mean difference takes one degree of freedom
    squares = difference**2 / 2 * (pairs / np.maximum(pairs - 1, 1))[index]
    return _binned(index, bins, signal, squares, squares**2) * (pairs > 1)
