"""Black level, dark current, and hot pixels."""

from __future__ import annotations

import time

import numpy as np

from rfpipe.array_types import Bools, Double
from rfpipe.calibration.context import StepContext
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.photometry.defects import MAD_TO_DEVIATION, DarkFrames
from rfpipe.units import SATURATION_FRACTION

LONGEST_SECONDS = 60.0
"""Longest exposure of a bracket that is proposed."""


def measure_dark(context: StepContext) -> Findings:
    """Measure brackets of the all-off picture.

    Returns
    -------
    Findings
        Arrays: ``black``, mean of the frames, (E, ...); ``hot`` photosites, (...).

    Raises
    ------
    CaptureError
        When all exposures are saturated.

    Notes
    -----
    The slope of the mean over the exposure time, weighted with the noise, is dark current and
    remaining light. Fixed differences between photosites are the same at all exposures and don't
    enter it.
    """
    model = context.model
    frames, levels, seconds = _capture_dark(context)
    black, times = frames.mean, np.asarray(model.exposures, float)
    # variation that all photosites share is light, not noise
    common = np.var(levels, axis=0, ddof=1).reshape(-1, *(1,) * (black.ndim - 1))
    spread = frames.variance - common
    limit = SATURATION_FRACTION * model.white_level
    usable = np.logical_and.accumulate(frames.largest < limit, axis=0)
    if not usable[0].any():
        raise CaptureError(
            f"the whole all-off picture is saturated even at {times[0]:.3g} s: darken the room, "
            "check that the projector shows black, or close the aperture"
        )
    # exposures in which most photosites are usable; saturated photosites would bend the line
    used = max(k for k in range(len(black)) if k == 0 or usable[k].mean() > 0.5) + 1
    hot = _hot(black[:used], spread, usable, frames.count)
    good = ~hot & usable[used - 1]
    level = black[:, good].mean(axis=1)
    variance = np.maximum(spread[:, good].mean(axis=1), 0)
    # noise far below one count is hidden by rounding
    error = np.sqrt(np.maximum(variance, 1 / 12) / (frames.count * good.sum()))[:used]
    line = _fit_line(times, level, error, model.white_level)
    change, noise = np.ptp(levels, axis=0)[:used], np.sqrt(variance)
    span = model.white_level - line["black_level_counts"]
    facts = {
        **line,
        "room_change": float((change / np.maximum(noise[:used], 0.5)).max()),
        "room_change_share": float(change.max() / span),
        "room_seconds": float(np.ptp(seconds)),
        "frames": frames.count,
        "exposures_s": times.tolist(),
        "level_counts": level.tolist(),
        "variance_counts2": variance.tolist(),
        "hot_photosites": int(hot.sum()),
        "hot_share": float(hot.mean()),
        **_headroom(level, noise),
        **_filling(span, line["current_counts_per_s"], float(times[-1])),
    }
    return Findings.of("dark", facts, {"black": black.astype(np.float32), "hot": hot})


def _capture_dark(context: StepContext) -> tuple[DarkFrames, list[Double], list[float]]:
    """Capture all-off brackets; return their statistics, mean levels (E,), and times."""
    frames, levels, seconds = DarkFrames(), [], []
    count = context.settings.dark_frames
    for bracket in context.brackets([context.flat_picture(0)] * count, count):
        frames.add(bracket[None])
        levels.append(bracket.reshape(len(bracket), -1).mean(axis=1))
        seconds.append(time.time())
    return frames, levels, seconds


def _fit_line(times: Double, level: Double, error: Double, white_level: int) -> dict[str, float]:
    """Fit ``level = black level + current * time`` to the first exposures, those with an error.

    With one usable exposure of several, the current is the least that saturates the second one.
    """
    used = len(error)
    (current, black_level), covariance = (0.0, float(level[0])), np.diag([0, error[0] ** 2])
    if used > 1:
        (current, black_level), covariance = np.polyfit(
            times[:used], level[:used], 1, w=1 / error, cov="unscaled"
        )
    elif len(times) > 1:
        current = max(0.0, (white_level - level[0]) / times[1])
        black_level = max(0.0, black_level - current * times[0])
    return {
        "black_level_counts": float(black_level),
        "black_level_error": float(np.sqrt(covariance[1, 1])),
        "current_counts_per_s": float(current),
        "current_error": float(np.sqrt(covariance[0, 0])),
    }


def _headroom(level: Double, noise: Double) -> dict[str, float | None]:
    """Smallest distance of the dark level from 0 counts, in standard deviations of its noise."""
    headroom = np.divide(level, noise, out=np.full(level.shape, np.inf), where=noise > 0)
    return {
        "noise_counts": float(noise[np.argmin(headroom)]),
        "headroom_deviations": float(headroom.min()) if np.isfinite(headroom).any() else None,
    }


def _filling(span: float, current: float, longest: float) -> dict[str, float]:
    """Share of the range that dark current and light fill in the longest exposure."""
    return {
        "longest_s": longest,
        "filled_share": float(current * longest / span),
        "bearable_s": bearable_seconds(span, current),
    }


def bearable_seconds(span: float, rate: float) -> float:
    """Longest exposure in which light of `rate` counts per second fills 4 % of `span` counts.

    At most `LONGEST_SECONDS`. The verdict accepts 5 %.
    """
    return min(0.04 * span / max(rate, 1e-9), LONGEST_SECONDS)


def _hot(black: Double, spread: Double, usable: Bools, count: int) -> Bools:
    """Find photosites outside the range of all their neighbours of the same colour.

    This distinguishes hot photosites from light: neighbours share the shape of a glint, whereas a
    hot photosite is many times brighter than its neighbours.
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
        # of 10^7 good photosites, none exceeds nine deviations by chance
        hot |= at & (np.abs(mean - np.clip(mean, low, high)) > 9 * max(noise, shape))
    return hot
