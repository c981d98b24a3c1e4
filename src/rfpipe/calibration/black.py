"""Black level, dark current, hot pixels, and the light that the all-off picture leaves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.sight import SATURATED
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.photometry.defects import MAD_TO_DEVIATION, DarkFrames

Double = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOST_CURRENT = 1e4
# Electrons a second that a sensor's dark current stays below: good ones have a few at room
# temperature, poor and hot ones a thousand.

_BAND = 2  # camera pixels on either side of the projector's outline that are compared across it
_LEAST_PIXELS = 40


def measure_dark(
    brackets: Iterable[NDArray[Any]],
    exposures: Sequence[float],
    white_level: int,
    sight: Findings | None = None,
    electrons_per_count: float = 1.0,
) -> Findings:
    """Measure brackets of the all-off picture.

    Parameters
    ----------
    brackets : iterable of ndarray of uint16, shape (E, ...)
        Two or more.
    exposures : sequence of float, length E
        Exposure times in seconds.
    white_level : int
        Full scale in counts: exposures that are saturated without light tell nothing of darkness.
    sight : Findings, optional
        Of the scene, which tells light from dark current.
    electrons_per_count : float
        As well as it is known.

    Returns
    -------
    Findings
        Arrays: ``black``, mean of the frames, (E, ...); ``hot`` photosites, (...).

    Raises
    ------
    CaptureError
        When there are fewer than two brackets, or all exposures are saturated.

    Notes
    -----
    The slope of the mean over the exposure time, weighted with the noise, is dark current and
    whatever light is left. Fixed differences between photosites are the same at all exposures and
    don't enter it.
    """
    frames = DarkFrames()
    for bracket in brackets:
        frames.add(bracket[None])
    if frames.count < 2:
        raise CaptureError(f"{frames.count} dark frames; expected 2 or more")
    black, spread, times = frames.mean, frames.variance, np.asarray(exposures, float)
    usable = np.logical_and.accumulate(frames.most < SATURATED * white_level, axis=0)
    if not usable[0].any():
        raise CaptureError(
            f"all of the all-off picture is saturated even at {min(exposures):.3g} s: darken the "
            "room, and see that the projector shows black, or close the aperture"
        )
    # the same photosites at all exposures, most of them: those that saturate would bend the line
    last = max(k for k in range(len(black)) if k == 0 or usable[k].mean() > 0.5)
    hot = _hot(black[: last + 1], spread, usable, frames.count)
    good = ~hot & usable[last]
    level, variance = black[:, good].mean(axis=1), spread[:, good].mean(axis=1)
    # counts are whole: rounding hides what is far below it
    sure = np.maximum(variance, 1 / 12) / (frames.count * good.sum())
    line, covariance = _line(times[: last + 1], level[: last + 1], np.sqrt(sure[: last + 1]))
    black_level, current = line
    if last == 0 and len(times) > 1:
        current = max(0.0, (white_level - level[0]) / times[1])  # or more
        black_level = max(0.0, black_level - current * times[0])
    span, longest = white_level - black_level, float(times[-1])
    noise = np.sqrt(variance)
    headroom = np.divide(level, noise, out=np.full(level.shape, np.inf), where=noise > 0)
    facts = {
        "frames": frames.count,
        "exposures_s": list(exposures),
        "longest_s": longest,
        "level_counts": level.tolist(),
        "variance_counts2": variance.tolist(),
        "black_level_counts": float(black_level),
        "black_level_error": float(np.sqrt(covariance[0, 0])),
        "current_counts_per_s": float(current),
        "current_error": float(np.sqrt(covariance[1, 1])),
        "hot_photosites": int(hot.sum()),
        "hot_share": float(hot.mean()),
        "noise_counts": float(noise[np.argmin(headroom)]),
        "headroom_deviations": float(headroom.min()) if np.isfinite(headroom).any() else None,
        "filled_share": float(current * longest / span),
        "bearable_s": float(0.05 * span / current) if current > 0 else None,
    }
    glow = dict.fromkeys(("projector_black", "black_fills", "room_fills", "current_fills"))
    if sight is not None:
        noise_of_mean = variance / frames.count
        rate, error, known = _rates(black - black_level, times, noise_of_mean, usable & ~hot)
        least = 0.025 * span / longest if facts["filled_share"] > 0.05 else None
        glow = _glow(rate, error, known, sight, electrons_per_count, least)
    arrays = {"black": black.astype(np.float32), "hot": hot}
    return Findings.of("dark", {**facts, **glow}, arrays)


def _line(x: Double, y: Double, error: Double) -> tuple[tuple[float, float], Double]:
    """Fit y = a + b x; return (a, b) and their covariance. One point has no slope."""
    if len(x) == 1:
        return (float(y[0]), 0.0), np.diag([error[0] ** 2, 0.0])
    (slope, intercept), covariance = np.polyfit(x, y, 1, w=1 / error, cov="unscaled")
    return (float(intercept), float(slope)), covariance[::-1, ::-1]


def _hot(black: Double, spread: Double, usable: Mask, count: int) -> Mask:
    """Return photosites beyond all their neighbours, of their own colour under a mosaic.

    Light has a shape that neighbours share: a glint is a share of the light about it, a hot
    photosite many times that.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    hot = np.zeros(black.shape[1:], bool)
    reach = 2 if hot.ndim == 2 else 1
    ring = np.zeros((2 * reach + 1,) * 2 + (1,) * (hot.ndim - 2), bool)
    ring[::reach, ::reach] = True
    ring[reach, reach] = False
    for mean, variance, at in zip(black, spread, usable, strict=False):
        low = minimum_filter(mean, footprint=ring, mode="mirror")
        high = maximum_filter(mean, footprint=ring, mode="mirror")
        noise = np.sqrt(max(float(variance[at].mean()), 1 / 12) / count)
        shape = MAD_TO_DEVIATION * float(np.median(np.abs(mean - np.median(mean))))
        # nine deviations: what none of 10^7 good ones exceeds by chance
        hot |= at & (np.abs(mean - np.clip(mean, low, high)) > 9 * max(noise, shape))
    return hot


def _rates(
    above: Double, times: Double, variance: Double, good: Mask
) -> tuple[Double, Double, Mask]:
    """Return counts a second of each pixel (H, W) in the dark, their error, and which are good."""
    if above.ndim == 4:
        above, good = above.mean(axis=-1), np.asarray(good.all(axis=-1))
    weight = np.where(good, times[:, None, None], 0)
    squares = np.square(weight).sum(axis=0)
    known = squares > 0
    over = np.where(known, squares, 1)
    noise = np.maximum(variance, 1e-3)[:, None, None]
    error = np.sqrt((np.square(weight) * noise).sum(axis=0)) / over
    return (weight * above).sum(axis=0) / over, error, known


def _glow(
    rate: Double, error: Double, good: Mask, sight: Findings, electrons: float, least: float | None
) -> dict[str, Any]:
    """Tell apart what grows with the exposure time in the dark; counts a second.

    Light of the projector has the shape of its own white picture: its step at the outline, where
    the camera sees beyond it and surfaces and the room's light go on; else all of the shape. What
    is left is even or not; a sensor's current is even, and small. Where `least` is given, the dark
    is too light, and causes are named; a current from `least` on.
    """
    white, lit = sight["white"].astype(np.float64), sight["lit"]
    facts: dict[str, Any] = dict.fromkeys(
        ("projector_black", "projector_black_error", "room_light_of_white", "even_counts_per_s",
         "uneven_counts_per_s", "black_fills", "room_fills", "current_fills")
    )  # fmt: skip
    if good.sum() < _LEAST_PIXELS:
        return facts
    at, tells = good, white
    inside, outside = _across(lit, good)
    if min(inside.sum(), outside.sum()) >= _LEAST_PIXELS and (
        white[inside].mean() > white[outside].mean()
    ):
        at, tells = inside | outside, inside.astype(np.float64)
    x, y, z = (values[at] - values[at].mean() for values in (white, rate, tells))
    along = float(z @ x)
    black, black_error = 0.0, np.inf
    if along > 0:
        black = float(z @ y) / along
        rest = max(float((y - black * x).std()), float(np.median(error)))
        # neighbours share what the model doesn't know: a quarter of the pixels are independent
        black_error = 2 * rest * float(np.sqrt(z @ z)) / along
    if not (black > 5 * black_error and lit.any()):
        black = 0.0
    left = rate[good] - black * white[good]
    even = float(np.median(left))
    typical = float(np.median(error[good]))
    beyond = np.percentile(np.abs(left - even), 95) ** 2 - (2 * typical) ** 2
    uneven = float(np.sqrt(max(beyond, 0.0)))
    # an imperfect white picture leaves a tenth of the black's shape
    if uneven < max(typical, 0.1 * black * float(white[good].max())):
        uneven = 0.0
    is_current = even * electrons <= _MOST_CURRENT
    room = (0.0 if is_current else max(even, 0.0)) + uneven
    light = float(white[good & lit].mean()) if (good & lit).any() else 0.0
    return {
        "projector_black": black,
        "projector_black_error": black_error if np.isfinite(black_error) else None,
        "room_light_of_white": room / light if light > 0 else None,
        "even_counts_per_s": even,
        "uneven_counts_per_s": uneven,
        "black_fills": black if least is not None else None,
        "room_fills": room if least is not None else None,
        "current_fills": even if least is not None and room == 0 and even > least else None,
    }


def _across(lit: Mask, good: Mask) -> tuple[Mask, Mask]:
    """Return the good pixels just inside and just outside the projector's outline."""
    from scipy.ndimage import binary_dilation, binary_erosion

    square = np.ones((3, 3), bool)
    # pixels on the outline itself are lit in part
    inner = binary_erosion(lit, square, border_value=1)
    inside = inner & ~binary_erosion(inner, square, iterations=_BAND, border_value=1)
    outer = ~binary_dilation(lit, square)
    outside = outer & binary_dilation(lit, square, iterations=1 + _BAND)
    return inside & good, outside & good
