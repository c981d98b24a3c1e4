"""Black level, dark current and hot pixels, from frames of the all-off picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Measured, Verdict, take, uniform
from rfpipe.calibration.darkness import MOST_CURRENT, Glow, beyond_neighbours, measure_glow
from rfpipe.calibration.sight import SATURATED, Sight
from rfpipe.errors import CaptureError
from rfpipe.photometry.defects import MAD_TO_DEVIATION, DarkFrames, find_hot
from rfpipe.rigs.devices import Camera, Projector

__all__ = ["Dark", "dark_findings", "glow_of", "measure_dark", "take_dark"]

Double = NDArray[np.float64]

LEAST_FRAMES = 2
MOST_HOT = 1e-3
"""Share of hot photosites from which on to cool a sensor, or replace it, not do without them."""

MOST_GLOW = 0.05
"""Fraction of full scale that what grows with the exposure time may fill at the longest one."""

HALF = 0.5
OUTLYING = 9.0
"""Deviations by which a photosite exceeds all its neighbours that is hot, where light falls."""


@dataclass(frozen=True, eq=False)
class Dark(Measured):
    """What the camera counts under the all-off picture; counts, unless said otherwise.

    Attributes
    ----------
    frames : int
        Brackets measured.
    black : ndarray of float32, shape (E, ...)
        Their mean.
    level : ndarray of float64, shape (E,)
        Mean of ``black`` over the photosites that aren't hot.
    variance : ndarray of float64, shape (E,)
        Mean over the same photosites of the variance between frames, made unbiased.
    black_level_counts, black_level_error : float
        At an exposure time of zero, from the exposures that light of the all-off picture, if any,
        doesn't saturate.
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


def measure_dark(
    brackets: Iterable[NDArray[Any]], exposures: Sequence[float], white_level: int | None = None
) -> Dark:
    """Measure dark frames.

    Parameters
    ----------
    brackets : iterable of ndarray of uint16, shape (E, ...)
        Two or more brackets of the all-off picture.
    exposures : sequence of float, length E
        Exposure times in seconds.
    white_level : int, optional
        Full scale in counts: exposures that are saturated without light tell nothing of darkness.

    Returns
    -------
    Dark

    Raises
    ------
    CaptureError
        When there are fewer than two brackets, or all exposures are saturated.

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
    usable = _usable(frames, white_level)
    if not usable[0].any():
        raise CaptureError(
            f"all of the all-off picture is saturated even at {min(exposures):.3g} s: darken the "
            "room, and see that the projector shows black, or close the aperture"
        )
    is_lit = _is_lit(black, spread, usable)
    hot = _hot_in_light(black, spread, usable, frames.count) if is_lit else find_hot(frames)
    # the same photosites at all exposures, most of them: those that saturate would bend the line
    last = max(k for k in range(len(black)) if k == 0 or usable[k].mean() > HALF)
    good, clear = ~hot & usable[last], slice(last + 1)
    level = np.array([mean[good].mean() for mean in black])
    # the mean over many photosites is unbiased where their median, of few frames, is not
    variance = np.array([values[good].mean() for values in spread])
    # counts are whole: rounding hides what is far below it
    error = np.sqrt(np.maximum(variance, 1 / 12) / (frames.count * good.sum()))
    times = np.asarray(exposures, float)
    (black_level, current), covariance = _line(times[clear], level[clear], error[clear])
    if last == 0 and len(times) > 1 and white_level is not None:
        current = max(0.0, float((white_level - level[0]) / times[1]))  # or more
        black_level = max(0.0, black_level - current * float(times[0]))
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


def glow_of(
    dark: Dark,
    exposures: Sequence[float],
    white_level: int,
    sight: Sight,
    electrons_per_count: float,
) -> Glow:
    """Tell apart what grows with the exposure time in dark frames; see `measure_glow`."""
    times = np.asarray(exposures, float).reshape(-1, 1, 1)
    black, good = dark.black.astype(np.float64), ~dark.hot
    if black.ndim == 4:
        black, good = black.mean(axis=-1), np.asarray(good.all(axis=-1))
    below: NDArray[np.bool_] = np.asarray(black < SATURATED * white_level)
    clear = np.logical_and.accumulate(below, axis=0)
    weight = np.where(clear, times, 0)
    squares = np.square(weight).sum(axis=0)
    above = np.where(clear, black - dark.black_level_counts, 0)
    at = good & (squares > 0)
    rate = np.divide((weight * above).sum(axis=0), squares, out=np.zeros(at.shape), where=at)
    variance = np.maximum(dark.variance, 1 / 12).reshape(-1, 1, 1) / dark.frames
    error = np.sqrt(np.square(weight) * variance).sum(axis=0)
    error = np.divide(error, squares, out=np.full(at.shape, np.inf), where=at)
    return measure_glow(rate, error, at, sight, electrons_per_count)


def dark_findings(
    dark: Dark, exposures: Sequence[float], white_level: int, glow: Glow | None = None
) -> Findings:
    """Return the step's findings, with a verdict on clipping, hot pixels and stray light."""
    hot = float(dark.hot.mean())
    depth = dark.level - 4 * np.sqrt(dark.variance)
    faults = []
    if depth.min() < 0 and dark.variance.max() > 0:
        noise = float(np.sqrt(dark.variance[np.argmin(depth)]))
        faults.append(
            f"The black level, {dark.black_level_counts:.1f} counts, is less than four times the "
            f"noise ({noise:.2f}) above zero: darkness is cut off and "
            "biased. Raise the camera's black level."
        )
    if hot > MOST_HOT:
        faults.append(
            f"{hot:.2%} of the photosites are hot, more than {MOST_HOT:.1%}: cool the camera or "
            "use shorter exposures."
        )
    span = white_level - dark.black_level_counts
    filled = dark.current_counts_per_s * max(exposures) / span
    if filled > MOST_GLOW:
        faults.append(_told(dark, exposures, span, glow))
    text = (
        f"Black level {dark.black_level_counts:.2f} counts; {int(dark.hot.sum())} hot photosites "
        f"({hot:.3%}), which are left out."
    )
    if glow is not None and glow.black > 0:
        text += f" The projector's black is {glow.black:.2%} of its full light."
    return dark.findings(
        Verdict.of(faults, text),
        exposures_s=list(exposures),
        level_counts=dark.level.tolist(),
        variance_counts2=dark.variance.tolist(),
        hot_photosites=int(dark.hot.sum()),
        **({} if glow is None else _facts(glow)),
    )


def _facts(glow: Glow) -> dict[str, Any]:
    """Return what the dark is made of, as facts."""
    known = np.isfinite(glow.of_white)
    return {
        "projector_black": glow.black,
        "projector_black_error": glow.black_error if np.isfinite(glow.black_error) else None,
        "room_light_of_white": glow.of_white if known else None,
        "even_counts_per_s": glow.even,
        "uneven_counts_per_s": glow.uneven,
    }


def _told(dark: Dark, exposures: Sequence[float], span: float, glow: Glow | None) -> str:
    """Say what fills the all-off picture, how much it is, and what to do."""
    current, longest = dark.current_counts_per_s, max(exposures)
    filled = current * longest / span
    short = MOST_GLOW * span / current
    much = (
        f"takes {filled:.0%} of the camera's range"
        if filled < 1
        else "saturates the camera, and more"
    )
    text = f"The all-off picture isn't dark: at {longest:.3g} s it {much}."
    if glow is None:
        return f"{text} Dim the room's light, or cover the projector's stray light."
    if glow.black > 0:
        sure = "" if glow.at_outline else ", or room light on the same surfaces: cover the lamp"
        text += (
            f" Projector black: {glow.black:.2%} of its full light, in the shape of its picture"
            f"{sure}. Lower its brightness setting, close its iris, or take a projector of more "
            "contrast."
        )
    if glow.room > 0:
        of_white = f", {glow.of_white:.0%} of the projector's" if np.isfinite(glow.of_white) else ""
        even = "even" if glow.uneven < glow.even else "uneven"
        text += (
            f" Stray light of the room: {glow.room:.3g} counts a second{of_white}, {even}, and "
            f"more than a sensor's dark current ({MOST_CURRENT:.0f} electrons a second at most). "
            "Black out the room."
        )
    elif glow.even * longest > MOST_GLOW / 2 * span:
        text += (
            f" Dark current: {glow.even:.3g} counts a second, the same all over the picture, or as "
            "much stray light that falls evenly. This rig can't shut its lens, which alone tells "
            "them apart: put the cap on, and run rfpipe calibrate with --step dark --again. If it "
            "stays, cool the camera; if not, black out the room."
        )
    return f"{text} Exposures up to {short:.2g} s would bear it."


def _usable(frames: DarkFrames, white_level: int | None) -> NDArray[np.bool_]:
    """Return where dark frames are not saturated, nor were at a shorter exposure, (E, ...)."""
    if white_level is None:
        return np.ones(frames.most.shape, bool)
    return np.asarray(np.logical_and.accumulate(frames.most < SATURATED * white_level, axis=0))


def _is_lit(black: Double, spread: Double, usable: NDArray[np.bool_]) -> bool:
    """Say whether light falls on a good part of the sensor: its noise is that of light, too."""
    rise = [
        float(np.median((black[k] - black[0])[usable[k]])) if usable[k].any() else np.inf
        for k in range(len(black))
    ]
    noise = float(np.sqrt(np.median(spread[0]) + 1 / 12))
    quarter = np.percentile(black[-1], 75) - np.percentile(black[-1], 25)
    return bool(max(rise) > 2 * noise or quarter > 4 * noise)


def _hot_in_light(
    black: Double, spread: Double, usable: NDArray[np.bool_], count: int
) -> NDArray[np.bool_]:
    """Find photosites that exceed all their neighbours, where light has a shape and noise."""
    hot: NDArray[np.bool_] = np.zeros(black.shape[1:], bool)
    for mean, variance, at in zip(black, spread, usable, strict=True):
        if at.mean() < HALF:
            break
        images = mean[..., None] if mean.ndim == 2 else mean
        beyond = np.stack(
            [beyond_neighbours(image, 1 if mean.ndim == 3 else 2)
             for image in np.moveaxis(images, -1, 0)], axis=-1,
        ).reshape(mean.shape)  # fmt: skip
        noise = float(np.sqrt(np.maximum(variance[at].mean(), 1 / 12) / count))
        spare = MAD_TO_DEVIATION * float(np.median(np.abs(mean - np.median(mean))))
        # a glint is a share of the light about it, a hot photosite many times that
        hot[at & (np.abs(beyond) > OUTLYING * max(noise, spare))] = True
    return hot


def _line(x: Double, y: Double, error: Double) -> tuple[tuple[float, float], Double]:
    """Fit y = a + b x; return (a, b) and their covariance. One point has no slope."""
    if len(x) == 1:
        return (float(y[0]), 0.0), np.diag([error[0] ** 2, 0.0])
    (slope, intercept), covariance = np.polyfit(x, y, 1, w=1 / error, cov="unscaled")
    return (float(intercept), float(slope)), covariance[::-1, ::-1]
