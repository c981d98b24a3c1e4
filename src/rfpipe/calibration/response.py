"""Responses: counts of the camera's light, and light of the projector's codes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError

Double = NDArray[np.float64]

LEVELS = (1.0, 0.25, 1 / 16)
"""Weights of the flat pictures whose exposures are compared."""

_SURE = 4.0  # standard errors beyond which exposures differ in one of many bins
_LEAST_PIXELS = 100  # photosites in a bin that is compared
_STRAIGHT = 0.03  # by how much noise bends the exponent of a linear camera


def measure_linearity(
    brackets: Iterable[NDArray[Any]],
    dark: Findings,
    exposures: Sequence[float],
    white_level: int,
    tolerance: float,
) -> Findings:
    """Compare each exposure with the next longer one, over the levels that they count.

    Parameters
    ----------
    brackets : iterable of ndarray of uint16, shape (E, ...)
        Of flat pictures, each taken twice: the one tells a photosite's level, the other is
        compared, so that noise which lifts a count past a bin's edge has no part in it.
    dark : Findings
    exposures : sequence of float
        Seconds.
    white_level : int
        Full scale in counts.
    tolerance : float
        Deviation up to which a camera counts as linear.

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
    black = dark["black_level_counts"]
    span, good = white_level - black, ~dark["hot"]
    # below, noise and black level rule; above, saturation
    edges = np.geomspace(0.02, 0.9, 13)
    ratios = np.divide(exposures[1:], exposures[:-1])
    short, long, squares, count = np.zeros((4, len(ratios), len(edges) - 1))
    remaining = iter(brackets)
    for frames, other in zip(remaining, remaining, strict=False):
        signal, level = (taken[:, good] - black for taken in (frames, other))
        for k, ratio in enumerate(ratios):
            index = np.searchsorted(edges, level[k + 1] / span) - 1
            inside = (index >= 0) & (index < len(edges) - 1)
            at, (less, more) = index[inside], signal[k : k + 2, inside]
            rest = less * ratio - more  # fixed differences between photosites cancel
            for total, values in ((short, less), (long, more), (squares, rest**2), (count, None)):
                total[k] += np.bincount(at, values, len(edges) - 1)
    ratio = np.broadcast_to(ratios[:, None], count.shape)
    there = (count >= _LEAST_PIXELS) & (short > 0)
    short, long, squares, count, ratio = (v[there] for v in (short, long, squares, count, ratio))
    scatter = squares - (short * ratio - long) ** 2 / count
    # rounding is no chance: noise below a step, of which it may feign a quarter, leaves a mean up
    # to this share of a step off
    noise = np.maximum(scatter / count / ratio**2 - 1 / 4, 0)
    rounding = np.exp(-2 * np.pi**2 * noise) / np.pi * ratio * count / long
    error = np.sqrt(scatter) / long + rounding / _SURE
    error += dark["black_level_error"] * (ratio - 1) * count / long
    deviation = short * ratio / long - 1
    known = error < max(tolerance, 1e-3)
    compared = int(known.sum())
    worst = _beyond(deviation[known], error[known]) if compared else None
    facts: dict[str, Any] = {
        "kind": "Linear",
        "tolerance": tolerance,
        "compared_levels": compared,
        "worst_deviation": worst,
        "deviation": worst,
        "response_gamma": 1.0,
        "bent_deviation": None,
        "unsteady_deviation": None,
    }
    if worst is not None and worst > tolerance:
        weight = 1 / error[known] ** 2
        factor = np.exp(np.average(np.log(long / short)[known], weights=weight))
        # one exponent for pairs of all ratios
        apart = np.average(np.log(ratio)[known], weights=weight)
        gamma = float(apart / np.log(factor)) if factor > 1 else np.inf
        left = short**gamma * ratio / long**gamma - 1 if 0.2 <= gamma <= 5 else deviation
        misfit = _beyond(left[known], error[known])
        pairs = np.nonzero(there)[0][known]
        of_pair = np.bincount(pairs, weight * deviation[known]) / np.bincount(pairs, weight)
        varies = _beyond(deviation[known] - of_pair[pairs], error[known])
        if misfit <= tolerance and abs(gamma - 1) > _STRAIGHT:
            kind = f"Undone as a power law of exponent {gamma:.3g}"
            facts |= {"response_gamma": gamma, "deviation": misfit, "kind": kind}
        elif varies > tolerance:
            facts["bent_deviation"] = misfit
        else:  # a time that is wrong, or light that changes, is the same at all levels
            facts["unsteady_deviation"] = worst
    arrays = {"level": long / span / count, "deviation": deviation, "error": error}
    return Findings.of("linearity", facts, arrays)


def _beyond(deviation: Double, error: Double) -> float:
    """Return the largest deviation beyond `_SURE` times its error."""
    return float(np.maximum(np.abs(deviation) - _SURE * error, 0).max())


def codes_of(count: int) -> NDArray[np.int64]:
    """Return the codes to show: full light first and last, and between them from dark to bright."""
    steps = np.unique(np.rint(np.linspace(0, 255, count)).astype(np.int64))
    return np.append(255, steps)


def measure_light(
    images: Iterable[tuple[Double, Double]], codes: NDArray[np.int64], tolerance: float
) -> Findings:
    """Measure the light of codes.

    Parameters
    ----------
    images : iterable of (radiance, variance), each (Hc, Wc)
        Under flat pictures of the codes, black subtracted.
    codes : ndarray of int64
        Theirs; the first and the last are 255.
    tolerance : float
        Drift that is accepted, a fraction.

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

    remaining = iter(images)
    full, variance = next(remaining)
    lit = full > 10 * np.sqrt(variance)
    if not lit.any():
        raise CaptureError(
            "no camera pixel is lit by the projector's full light; check lamp, lens cap and "
            "exposures"
        )
    lit &= full > 0.5 * np.percentile(full[lit], 90)  # darker ones add more noise than knowledge
    ratios = [image[lit] / full[lit] for image, _ in remaining]
    measured = np.array([np.median(ratio) for ratio in ratios])
    # the median's standard error is 1.2533 times the mean's
    error = np.array([1.2533 * ratio.std() / np.sqrt(ratio.size) for ratio in ratios])
    drift, shown = float(measured[-1] - 1), codes[1:]
    measured /= measured[-1]  # full light at the end is that of the curve's own time
    monotone = isotonic_regression(measured, weights=np.maximum(error, 1e-6) ** -2.0).x
    monotone = (monotone - monotone[0]) / max(monotone[-1] - monotone[0], 1e-9)
    light = PchipInterpolator(shown, monotone)(np.arange(256))
    light = np.maximum.accumulate(np.clip(light, 0, 1))
    falls = np.diff(measured) + 4 * np.hypot(error[1:], error[:-1])
    over_noise = float(np.median(full[lit] / np.sqrt(variance[lit])))
    beyond = max(abs(drift) - 3 * float(error[-1]), 0.0)
    rises = measured[-1] - measured[0] >= 0.5
    facts = {
        "tolerance": tolerance,
        "pixels": int(lit.sum()),
        "over_noise": over_noise,
        "drift": drift,
        "drift_beyond_noise": None if over_noise < 30 else beyond,
        "falls_at_code": int(shown[1:][np.argmin(falls)]) if (falls < 0).any() else None,
        "usable_codes": int(np.count_nonzero(np.diff(light) > 1e-5)) if rises else 0,
        "code_of_half_light": float(np.interp(0.5, light, np.arange(256))),
        "largest_error": float(error.max()),
    }
    arrays = {"codes": shown, "measured": measured, "error": error, "light": light}
    return Findings.of("light", facts, arrays)
