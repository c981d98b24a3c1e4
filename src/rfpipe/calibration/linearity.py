"""Whether the camera counts light in proportion, and its response where it doesn't."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Verdict
from rfpipe.calibration.dark import Dark
from rfpipe.errors import CaptureError
from rfpipe.photometry.response import Response, recover_response

__all__ = ["LEVELS", "Linearity", "linearity_findings", "measure_linearity", "power_law"]

Double = NDArray[np.float64]

LEVELS = (1.0, 0.25, 1 / 16)
"""Weights of the flat pictures whose brackets are compared."""

BINS = 12
FLOOR = 0.02
"""Fraction of full scale above which exposures are compared: below, noise and black level rule."""

TOP = 0.9
"""Fraction of full scale up to which they are."""


SPREAD = 2.0
"""Variance of a shorter exposure, scaled to the longer one, over that of the longer one and over
how many times longer it is: 1 of photon noise, and more of read noise."""

SURE = 4.0
"""Standard errors beyond which exposures differ in one of many bins."""

STEEPEST = (0.2, 5.0)
"""Exponents that a response is believed to have."""

STRAIGHT = 0.03
"""By how much the exponent of a response differs from 1 that no more than noise bends."""

LEAST_PIXELS = 30
"""Photosites in a bin that is compared."""


@dataclass(frozen=True, eq=False)
class Linearity:
    """How exposures of one light agree.

    Attributes
    ----------
    level : ndarray of float64, shape (n,)
        Counts above black of the longer exposure, as a fraction of full scale.
    deviation, error : ndarray of float64, shape (n,)
        Light by the shorter exposure over that by the longer one, less 1; its standard error.
    worst : float
        Largest deviation beyond `SURE` times its error; NaN where nothing could be compared.
    response : Response or None
        Recovered where the camera isn't linear.
    gamma : float
        Exponent g of that response, counts ~ light^(1/g); 1 for a linear camera.
    gamma_misfit : float
        RMS of the difference between response and power law, as a fraction of full scale.
    """

    level: Double
    deviation: Double
    error: Double
    worst: float
    response: Response | None
    gamma: float
    gamma_misfit: float

    @property
    def power_law(self) -> Response | None:
        """The power law as a response, which is what a `CameraModel` undoes; None if linear."""
        return None if self.response is None else power_law(self.gamma)


def power_law(gamma: float) -> Response:
    """Return the response counts ~ light^(1/gamma)."""
    level = np.linspace(0, 1, 4097)
    return Response(level, level**gamma)


def measure_linearity(
    brackets: Sequence[NDArray[Any]],
    dark: Dark,
    exposures: Sequence[float],
    white_level: int,
    tolerance: float,
) -> Linearity:
    """Compare each exposure with the next longer one, over the levels that they count.

    Parameters
    ----------
    brackets : sequence of ndarray of uint16, shape (E, ...)
        Of flat pictures of several weights, the brightest first.
    dark : Dark
    exposures : sequence of float
        Seconds.
    white_level : int
        Full scale in counts.
    tolerance : float
        Deviation up to which a camera counts as linear.

    Returns
    -------
    Linearity
    """
    span = white_level - dark.black_level_counts
    good = ~dark.hot
    edges = np.geomspace(FLOOR, TOP, BINS + 1)
    pairs = len(exposures) - 1
    short, long, squares, count = (np.zeros((pairs, BINS)) for _ in range(4))
    for frames in brackets:
        signal = frames[:, good] - dark.black[:, good].astype(np.float64)
        for k in range(pairs):
            ratio = exposures[k + 1] / exposures[k]
            # of both, so that noise which lifts one into a bin doesn't make them differ there
            light = signal[k + 1] + (signal[k] * ratio - signal[k + 1]) / (1 + SPREAD * ratio)
            at = np.searchsorted(edges, light / span) - 1
            # glow under the all-off picture takes up room below full scale, too
            inside = (at >= 0) & (at < BINS) & (frames[k + 1][good] < TOP * white_level)
            index = at[inside]
            short[k] += np.bincount(index, signal[k][inside] * ratio, BINS)
            long[k] += np.bincount(index, signal[k + 1][inside], BINS)
            # noise as it is, of both exposures: the same light, so that their difference is all
            rest = signal[k][inside] * ratio - signal[k + 1][inside]
            squares[k] += np.bincount(index, rest**2, BINS)
            count[k] += np.bincount(index, minlength=BINS)
    there = count >= LEAST_PIXELS
    deviation = short[there] / long[there] - 1
    scatter = squares[there] - np.square(short - long)[there] / count[there]
    # of few photosites the scatter may be small by chance: darkness' own noise is in it at least
    ratios = np.asarray(exposures[1:], float) / np.asarray(exposures[:-1], float)
    least = (dark.variance[:-1] * (1 + 1 / dark.frames) + 1 / 12) * ratios**2
    scatter = np.maximum(scatter, (count * least[:, None])[there])
    error = np.sqrt(scatter) / long[there]
    # as sure as bins are many; rounding is no chance
    error += _rounding(edges, span, exposures, dark)[there] * count[there] / long[there] / SURE
    level = long[there] / span / count[there]
    known = error < max(tolerance, 1e-3)
    beyond = np.maximum(np.abs(deviation[known]) - SURE * error[known], 0)
    worst = float(beyond.max()) if known.any() else float("nan")
    response, gamma, misfit = None, 1.0, 0.0
    if worst > tolerance:
        frames = np.concatenate([bracket[:, good] for bracket in brackets], axis=1)
        # the same for all photosites: a steep response makes each one's own mean of darkness noise
        black = np.broadcast_to(dark.level[:, None], frames.shape)
        response = recover_response(frames, exposures, black, white_level)
        gamma, misfit = _power(response)
        if not STEEPEST[0] <= gamma <= STEEPEST[1]:
            gamma, misfit = 1.0, 1.0
        elif abs(gamma - 1) <= STRAIGHT:
            gamma = 1.0
    return Linearity(level, deviation, error, worst, response, gamma, misfit)


def linearity_findings(linearity: Linearity, tolerance: float) -> Findings:
    """Return the step's findings: a poor verdict only where no power law describes the camera."""
    facts = {
        "worst_deviation": None if np.isnan(linearity.worst) else linearity.worst,
        "response_gamma": linearity.gamma,
        "gamma_misfit": linearity.gamma_misfit,
    }
    arrays = {
        "linearity_level": linearity.level,
        "linearity_deviation": linearity.deviation,
        "linearity_error": linearity.error,
    }
    response = linearity.response
    if np.isnan(linearity.worst):
        verdict = Verdict(
            "unknown",
            "Exposures could not be compared: it takes two or more, a few times apart, of light "
            "between black and saturated.",
        )
    elif response is None:
        verdict = Verdict(
            "good",
            f"Linear: exposures agree within {linearity.worst:.2%} beyond noise, "
            f"{tolerance:.1%} allowed.",
        )
    else:
        arrays |= {"response_level": response.level, "response_exposure": response.exposure}
        text = (
            f"Not linear: exposures differ by up to {linearity.worst:.1%}. The recovered response "
            f"is a power law of exponent {linearity.gamma:.3g} within "
            f"{linearity.gamma_misfit:.2%} of full scale"
        )
        follows = linearity.gamma_misfit <= tolerance and linearity.gamma != 1
        if linearity.gamma_misfit >= 1:
            text = (
                f"Exposures of the same light differ by up to {linearity.worst:.1%}, and by no "
                "response that a camera has"
            )
        if linearity.gamma == 1 and linearity.gamma_misfit < 1:
            text = (
                f"Exposures of the same light differ by up to {linearity.worst:.1%}, though the "
                "camera's response is next to a straight line: is the light steady, are gain and "
                "exposure not automatic, and are the exposure times true"
            )
            advice = "?"
        elif follows:
            advice = ", and is undone with it."
        else:
            advice = "; switch the camera's gamma off."
        verdict = Verdict("good" if follows else "poor", text + advice)
    return Findings(verdict, facts, arrays)


def _rounding(edges: Double, span: float, exposures: Sequence[float], dark: Dark) -> Double:
    """Return by how many counts of the longer exposure rounding may shift a bin, (pairs, bins).

    Of light whose counts spread over w steps evenly, the mean rounded is off by w-th parts of an
    eighth of a step; of less than one step, by up to half of one. Noise evens that out.
    """
    times = np.asarray(exposures, float)
    ratio = (times[1:] / times[:-1])[:, None]
    steps = np.maximum(np.diff(edges) * span / ratio, 1e-9)
    off = np.where(steps < 1, 0.5, 0.125 / steps)
    noise = np.maximum(dark.variance[:-1] - 1 / 12, 0)[:, None]
    return np.asarray(off * np.exp(-2 * np.pi**2 * noise) * ratio)


def _power(response: Response) -> tuple[float, float]:
    """Return the exponent of the power law closest to a response, and the RMS difference."""
    middle = (response.level > 0.05) & (response.level < 0.95)
    if middle.sum() < 3:
        raise CaptureError("the recovered response has no levels between black and saturated")
    level, light = response.level[middle], response.exposure[middle]
    # the scale is free: full scale is where the solver knows least
    gamma, scale = np.polyfit(np.log(level), np.log(light), 1)
    misfit = light / np.exp(scale) - level**gamma
    return float(gamma), float(np.sqrt(np.mean(misfit**2)))
