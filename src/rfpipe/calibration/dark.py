"""Black level, dark current and hot pixels, from frames of the all-off picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Measured, Verdict, take, uniform
from rfpipe.errors import CaptureError
from rfpipe.photometry.defects import DarkFrames, find_hot
from rfpipe.rigs.devices import Camera, Projector

__all__ = ["Dark", "dark_findings", "measure_dark", "take_dark"]

Double = NDArray[np.float64]

LEAST_FRAMES = 2
MOST_HOT = 1e-3
"""Share of hot photosites from which on to cool a sensor, or replace it, not do without them."""


@dataclass(frozen=True, eq=False)
class Dark(Measured):
    """What the camera counts without light; counts, unless said otherwise.

    Attributes
    ----------
    frames : int
        Brackets measured.
    black : ndarray of float32, shape (E, ...)
        Their mean.
    level : ndarray of float64, shape (E,)
        Median over photosites of that mean.
    variance : ndarray of float64, shape (E,)
        Median over photosites of the variance between frames, made unbiased.
    black_level_counts, black_level_error : float
        At an exposure time of zero.
    current_counts_per_s, current_error : float
        Of dark current, and of whatever light is left under the all-off picture.
    hot : ndarray of bool, shape (...)
        Photosites with an outlying black level or noise.
    """

    frames: int
    black: NDArray[np.float32]
    level: Double
    variance: Double
    black_level_counts: float
    black_level_error: float
    current_counts_per_s: float
    current_error: float
    hot: NDArray[np.bool_]


def take_dark(projector: Projector, camera: Camera, count: int) -> Iterable[NDArray[Any]]:
    """Take brackets of the all-off picture, one by one."""
    return take(projector, camera, (uniform(projector, 0) for _ in range(count)))


def measure_dark(brackets: Iterable[NDArray[Any]], exposures: Sequence[float]) -> Dark:
    """Measure dark frames.

    Parameters
    ----------
    brackets : iterable of ndarray of uint16, shape (E, ...)
        Two or more brackets of the all-off picture.
    exposures : sequence of float, length E
        Exposure times in seconds.

    Returns
    -------
    Dark

    Raises
    ------
    CaptureError
        When there are fewer than two brackets.

    Notes
    -----
    The dark current is the slope of the mean over the exposure time, by least squares weighted
    with the noise. Fixed differences between photosites are the same at all exposures and don't
    enter it: the mean is over the photosites that aren't hot.
    """
    frames = DarkFrames()
    for bracket in brackets:
        frames.add(bracket[None])
    if frames.count < LEAST_FRAMES:
        raise CaptureError(f"{frames.count} dark frames; expected {LEAST_FRAMES} or more")
    black, spread = frames.mean, frames.variance
    hot = find_hot(frames)
    good = ~hot
    level = np.array([mean[good].mean() for mean in black])
    # the mean over many photosites is unbiased where their median, of few frames, is not
    variance = np.array([values[good].mean() for values in spread])
    # counts are whole: rounding hides what is far below it
    error = np.sqrt(np.maximum(variance, 1 / 12) / (frames.count * good.sum()))
    (black_level, current), covariance = _line(np.asarray(exposures, float), level, error)
    return Dark(
        frames.count,
        black.astype(np.float32),
        level,
        variance,
        black_level,
        float(np.sqrt(covariance[0, 0])),
        current,
        float(np.sqrt(covariance[1, 1])),
        hot,
    )


def dark_findings(dark: Dark, exposures: Sequence[float], white_level: int) -> Findings:
    """Return the step's findings, with a verdict on clipping, hot pixels and stray light."""
    hot = float(dark.hot.mean())
    deepest = dark.black_level_counts - 4 * float(np.sqrt(dark.variance.max()))
    glow = float(dark.level.max() - dark.black_level_counts)
    faults = []
    if deepest < 0 and dark.variance.max() > 0:
        faults.append(
            f"The black level, {dark.black_level_counts:.1f} counts, is less than four times the "
            f"noise ({np.sqrt(dark.variance.max()):.2f}) above zero: darkness is cut off and "
            "biased. Raise the camera's black level."
        )
    if hot > MOST_HOT:
        faults.append(
            f"{hot:.2%} of the photosites are hot, more than {MOST_HOT:.1%}: cool the camera or "
            "use shorter exposures."
        )
    if glow > 0.05 * (white_level - dark.black_level_counts):
        faults.append(
            f"The all-off picture reaches {glow:.0f} counts at {max(exposures):.3g} s: dim the "
            "room's light, or cover the projector's stray light."
        )
    text = (
        f"Black level {dark.black_level_counts:.2f} counts; {int(dark.hot.sum())} hot photosites "
        f"({hot:.3%}), which are left out."
    )
    return dark.findings(
        Verdict.of(faults, text),
        exposures_s=list(exposures),
        level_counts=dark.level.tolist(),
        variance_counts2=dark.variance.tolist(),
        hot_photosites=int(dark.hot.sum()),
    )


def _line(x: Double, y: Double, error: Double) -> tuple[tuple[float, float], Double]:
    """Fit y = a + b x; return (a, b) and their covariance. One point has no slope."""
    if len(x) == 1:
        return (float(y[0]), 0.0), np.diag([error[0] ** 2, 0.0])
    (slope, intercept), covariance = np.polyfit(x, y, 1, w=1 / error, cov="unscaled")
    return (float(intercept), float(slope)), covariance[::-1, ::-1]
