"""Responses: counts of the camera's light with their noise, and light of the projector's codes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.bench import Bench
from rfpipe.calibration.verdicts import Findings, with_error
from rfpipe.errors import CaptureError

Double = NDArray[np.float64]

_LEVELS = (1.0, 0.25, 1 / 16)  # weights of the flat pictures whose exposures are compared
_SURE = 4.0  # standard errors beyond which exposures differ in one of many bins
_BINS = 12
_LEAST_PIXELS = 100  # photosites in a bin that is compared
_STRAIGHT = 0.03  # by how much noise bends the exponent of a linear camera

_DITHERED = 0.35
# Variance in squared steps of the converter from which on noise itself evens out rounding, which
# then adds a twelfth.

_RATIO = 1.12  # width of a bin: its upper edge over its lower one
_CLIP = 6.0  # standard deviations from which on a difference is no noise


def measure_linearity(bench: Bench) -> Findings:
    """Compare each exposure with the next longer one, over the levels that they count.

    Each flat picture is taken twice: the one tells a photosite's level, the other is compared, so
    that noise which lifts a count past a bin's edge has no part in it.

    Returns
    -------
    Findings
        Arrays (n,) of bins: ``level``, counts of the longer exposure as a fraction of full scale;
        ``deviation``, light by the shorter exposure over that by the longer one, less 1;
        ``error``, its standard error.

    Notes
    -----
    The light of the all-off picture grows with the exposure time, too: only the black level is
    subtracted. Of a response counts ~ light^(1/g), the counts of exposures r apart are
    ``r^(1/g)`` apart at all levels, which gives g.
    """
    model, dark, tolerance = bench.model, bench.found["dark"], bench.settings.tolerance / 2
    black, good = dark["black_level_counts"], ~dark["hot"]
    span, times = model.white_level - black, model.exposures[:2]
    # of each photosite at no exposure
    fixed = np.polyfit(times, dark["black"][: len(times), good], len(times) - 1)[-1]
    fixed -= fixed.mean()
    ratios = np.divide(model.exposures[1:], model.exposures[:-1])
    sums = np.zeros((4, len(ratios), _BINS))
    frames = bench.take([bench.flat(level) for level in _LEVELS for _ in range(2)])
    for first, other in zip(frames, frames, strict=False):
        signal, level = first[:, good] - black - fixed, (other[:, good] - black) / span
        for k, ratio in enumerate(ratios):
            at = np.searchsorted(_edges(level[k + 1]), level[k + 1]) - 1
            inside = (at >= 0) & (at < _BINS)
            less, more = signal[k : k + 2, inside]
            rest = less * ratio - more  # fixed differences between photosites cancel
            sums[:, k] += _binned(at[inside], _BINS, less, more, rest**2)
    there = (sums[0] >= _LEAST_PIXELS) & (sums[1:3] > 0).all(axis=0)
    ratio = np.broadcast_to(ratios[:, None], there.shape)[there]
    count, short, long, squares = sums[:, there]
    scatter = np.maximum(squares - (short * ratio - long) ** 2 / count, 0)
    # rounding is no chance: without noise, of which it may feign a quarter, means and black level
    # are up to half a step off, all the same way
    dither, dark_dither = (
        np.exp(-2 * np.pi**2 * np.maximum(noise - 1 / 4, 0)) / 2
        for noise in (scatter / count / ratio**2, dark["variance_counts2"][0])
    )
    of_black = dark["black_level_error"] + dark_dither / _SURE
    offset = dither / _SURE * (ratio + 1) + of_black * (ratio - 1)
    error = (np.sqrt(scatter) + offset * count) / long
    arrays = {"level": long / span / count, "deviation": short * ratio / long - 1, "error": error}
    # that exposures agree is told by levels that are well known, that they don't by any
    known = int((error < max(tolerance, 1e-3)).sum())
    facts = _exponent(short, long, ratio, error, tolerance) if there.any() else {}
    linear = {"kind": "Linear", "response_gamma": 1.0, "compared_levels": known}
    return Findings.of("linearity", {**linear, **facts, "tolerance": tolerance}, arrays)


def _edges(level: Double) -> Double:
    """Return bins' edges, (_BINS + 1,) fractions of full scale, between tones where there are few.

    Noise that pictures share lies above in the one part of a tone that an edge parts, and below in
    the other.
    """
    # below, noise and black level rule; above, saturation
    fine = np.geomspace(0.02, 0.9, 16 * (_BINS + 1) + 2)
    count = np.histogram(level, fine)[0]
    beside = (count[1:] + count[:-1]).reshape(_BINS + 1, 16)[:, 2:14]
    return np.asarray(fine[1:-1].reshape(_BINS + 1, 16)[range(_BINS + 1), beside.argmin(1) + 2])


def _exponent(
    short: Double, long: Double, ratio: Double, error: Double, tolerance: float
) -> dict[str, Any]:
    """Judge sums of counts by the exponent that makes exposures of each pair `ratio` apart."""

    def beyond(gamma: float) -> float:
        """Return the largest deviation beyond its error, an exponent undone."""
        deviation = short**gamma * ratio / long**gamma - 1
        return float(np.maximum(np.abs(deviation) - _SURE * error, 0).max())

    # one exponent for pairs of all ratios
    apart, steps = (np.average(np.log(x), weights=error**-2) for x in (ratio, long / short))
    gamma, worst = float(apart / max(steps, 1e-9)), beyond(1.0)
    facts: dict[str, Any] = {"worst_deviation": worst, "deviation": worst}
    is_known = np.average(error, weights=error**-2) / apart < _STRAIGHT < abs(gamma - 1)
    if worst > tolerance and is_known and 0.2 <= gamma <= 5 and beyond(gamma) <= tolerance:
        kind = f"Undone as a power law of exponent {gamma:.3g}"
        facts |= {"response_gamma": gamma, "deviation": beyond(gamma), "kind": kind}
        facts["compared_levels"] = len(error)
    return facts


def measure_light(bench: Bench) -> Findings:
    """Measure the light of codes: full light first and last, and between them dark to bright.

    Returns
    -------
    Findings
        Arrays: ``light`` (256,), monotone from 0 to 1, through the ``measured`` median of lit
        camera pixels at ``codes``, with its ``error``.

    Raises
    ------
    CaptureError
        When no pixel is lit by code 255.
    """
    from scipy.interpolate import PchipInterpolator
    from scipy.optimize import isotonic_regression

    tolerance = bench.settings.tolerance / 2
    codes = np.unique(np.rint(np.linspace(0, 255, bench.settings.codes)).astype(np.int64))
    images = bench.radiance([bench.flat(code / 255) for code in (255, *codes)])
    full, variance = next(images)
    lit = full > 10 * np.sqrt(variance)
    if not lit.any():
        raise CaptureError(
            "no camera pixel is lit by the projector's full light; check lamp, lens cap and "
            "exposures"
        )
    lit &= full > 0.5 * np.percentile(full[lit], 90)  # darker ones add more noise than knowledge
    ratios = np.array([image[lit] / full[lit] for image, _ in images])
    measured = np.median(ratios, axis=1)
    # the median's standard error is 1.2533 times the mean's
    error = 1.2533 * ratios.std(axis=1) / np.sqrt(ratios.shape[1])
    drift = float(measured[-1] - 1)
    measured /= measured[-1]  # full light at the end is that of the curve's own time
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


def measure_transfer(bench: Bench) -> Findings:
    """Measure the photon-transfer curve: gain, read noise and full well, from pairs of pictures.

    The pictures' weights go from 1/256 to 1: few counts up to all of them.

    Returns
    -------
    Findings
        Numbers for the camera model; arrays of bins: ``signal``, ``variance``, ``error`` and the
        ``model``'s variance in counts, and which bins the fit ``used``.

    Raises
    ------
    CaptureError
        When there is no light between darkness and saturation.

    Notes
    -----
    The variance of a pair's difference is twice that of one picture [EMVA 1288]. Photosites of all
    exposures and levels are sorted by their mean signal into bins; the mean difference of a bin is
    subtracted, so that a lamp that flickers between the two pictures adds no noise. Bins where
    rounding hides the noise are left out: where darkness is such a bin, the read noise is known
    by the curve's foot alone, and hardly matters. The curve of a camera with a gamma is that of
    linearised counts.
    """
    model, dark, settings = bench.model, bench.found["dark"], bench.settings
    black, good = dark["black_level_counts"], ~dark["hot"]
    span, gamma = model.white_level - black, model.response_gamma
    edges = [1.25]
    while edges[-1] < span:
        # two counts wide at least, a quarter above whole ones: rounding meets all fractions in it
        edges.append(np.floor(max(edges[-1] * _RATIO, edges[-1] + 2)) + 0.25)
    sums = np.zeros((4, len(edges) - 1))
    levels = np.geomspace(1 / 256, 1, settings.levels).repeat(2)
    frames = bench.take([bench.flat(level) for level in levels], linear=True)
    for pair in zip(frames, frames, strict=False):
        one, two = (bracket[:, good] for bracket in pair)
        for first, second in zip(one, two, strict=True):
            light = _linear(np.stack([first, second]) - black, span, gamma)
            sums += _spread(light[0], light[1], np.array(edges))
    pairs, signals, squares, fourths = sums
    filled = np.maximum(pairs, 1)
    signal, variance = signals / filled, squares / filled
    error = np.sqrt(np.maximum(fourths / filled - variance**2, 0) / filled)
    # the converter's step at a signal, in linear counts
    step = gamma * np.maximum(signal / span, 1e-9) ** (1 - 1 / gamma)
    noise = np.sqrt(variance)
    # darker photosites that noise lifted into a bin have less noise than its signal says
    used = (pairs >= 10) & (signal > 4 * noise) & (signal * _RATIO + _CLIP * noise < span)
    # where photosites saturate, wherever that is, their noise is cut off
    used &= signal <= signal[np.argmax(np.where(used, variance, 0))]
    used &= variance > _DITHERED * step**2
    if used.sum() < 2:
        raise CaptureError(
            "the flat pictures hold no light between darkness and saturation; check projector and "
            "lens, or choose other exposures"
        )
    bins = [values[used] for values in (signal, variance, pairs, step)]
    if gamma == 1:
        # dark frames, but those that light fills
        current = dark["current_counts_per_s"] * np.asarray(model.exposures, float)
        dark_variance = np.asarray(dark["variance_counts2"])
        bare = (current < 0.1 * span) & (dark_variance > _DITHERED)
        weight = np.full(len(current), float((dark["frames"] - 1) * good.sum()))
        added = current, dark_variance, weight, np.ones(len(current))
        bins = [np.append(old, new[bare]) for old, new in zip(bins, added, strict=True)]
    gain, gain_error, read, read_error, misfit = _fit_noise(*bins)
    electrons = gain * np.sqrt(read)
    electrons_error = gain * read_error / (2 * np.sqrt(max(read, read_error)))
    # what counts is the noise of darkness, to which the converter's steps belong
    of_darkness = read_error / (2 * (read + 1 / 12))
    facts = {
        "electrons_per_count": gain,
        "electrons_per_count_error": gain_error,
        "full_well_electrons": gain * span,
        "read_noise_electrons": electrons,
        "read_noise_error": electrons_error,
        "dark_current_electrons": max(0.0, dark["current_counts_per_s"] * gain),
        "misfit": misfit,
        "known_within": 2 * max(gain_error / gain, of_darkness),
        "numbers": _numbers(gain, gain_error, electrons, electrons_error),
    }
    curve = read + signal / gain + step**2 / 12
    arrays = {
        "signal": signal, "variance": variance, "error": error, "model": curve, "used": used
    }  # fmt: skip
    return Findings.of("transfer", facts, arrays)


def _numbers(gain: float, gain_error: float, electrons: float, electrons_error: float) -> str:
    """Return gain and read noise as a person reads them; not what is known to its own size only."""
    if gain_error >= gain:
        return "gain and read noise are not known"
    read = with_error(electrons, electrons_error, "{:.3g}")
    return f"{gain:.3g} +- {gain_error:.2g} electrons a count, read noise {read} electrons"


def _fit_noise(
    signal: Double, variance: Double, pairs: Double, step: Double
) -> tuple[float, float, float, float, float]:
    """Fit gain and read noise to bins (n,): variance = read noise^2 + signal / gain + step^2 / 12.

    `pairs` are the differences that each variance is of, and `step` that of the converter: 1, or
    more or less where a response was linearised.

    Returns
    -------
    gain, gain_error : float
        Electrons a count.
    read, read_error : float
        Variance of the read noise in counts squared.
    misfit : float
        RMS of the relative difference between measured and fitted variances, beyond the noise.

    Notes
    -----
    Least squares, each bin weighted with its expected spread: the measured one goes with the
    measured variance, and would pull the fit down. Errors grow with the misfit where it is more
    than noise.
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
    return 1 / slope, slope_error / slope**2, read, read_error, float(misfit)


def _linear(counts: Double, span: float, gamma: float) -> Double:
    """Return the signal of counts above black, in linear counts."""
    if gamma == 1:
        return counts
    return np.asarray(span * np.copysign(np.abs(counts / span) ** gamma, counts))


def _binned(at: NDArray[np.int64], bins: int, *values: Double) -> Double:
    """Return how many items each bin has, and the sums of their values, (1 + values, bins)."""
    return np.stack([np.bincount(at, of_bin, bins) for of_bin in (None, *values)]).astype(float)


def _spread(first: Double, second: Double, edges: Double) -> Double:
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
        pairs, total = _binned(at, bins, rest)
        rest = rest - (total / np.maximum(pairs, 1))[at]
        noise = np.sqrt(_binned(at, bins, rest**2)[1] / np.maximum(pairs, 1))
        kept = np.abs(rest) <= _CLIP * noise[at]
        at, signal, rest = at[kept], signal[kept], rest[kept]
    pairs = np.bincount(at, minlength=bins)
    # the mean difference takes one of the pairs' degrees of freedom
    squares = rest**2 / 2 * (pairs / np.maximum(pairs - 1, 1))[at]
    return _binned(at, bins, signal, squares, squares**2) * (pairs > 1)
