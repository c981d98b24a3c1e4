"""Black level, dark current, and hot pixels."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.bench import Bench
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.photometry.defects import MAD_TO_DEVIATION, DarkFrames
from rfpipe.units import SATURATION_FRACTION

Double = NDArray[np.float64]
Mask = NDArray[np.bool_]

LONGEST_SECONDS = 60.0
"""Longest exposure that a bracket may have."""


def measure_dark(bench: Bench) -> Findings:
    """Measure brackets of the all-off picture.

    Returns
    -------
    Findings
        Arrays: ``black``, mean of the frames, (E, ...); ``hot`` photosites, (...).

    Raises
    ------
    CaptureError
        When all exposures are saturated: they tell nothing of darkness.

    Notes
    -----
    The slope of the mean over the exposure time, weighted with the noise, is dark current and
    whatever light is left. Fixed differences between photosites are the same at all exposures and
    don't enter it.
    """
    model = bench.model
    frames, white_level = DarkFrames(), model.white_level
    levels, taken_at = [], []
    for bracket in bench.take([bench.flat(0)] * bench.settings.dark_frames):
        frames.add(bracket[None])
        levels.append(bracket.reshape(len(bracket), -1).mean(axis=1))
        taken_at.append(time.time())
    black, times = frames.mean, np.asarray(model.exposures, float)
    # what all photosites do together is light, not noise
    together = np.var(levels, axis=0, ddof=1).reshape(-1, *(1,) * (black.ndim - 1))
    spread = np.maximum(frames.variance - together, 0)
    usable = np.logical_and.accumulate(frames.most < SATURATION_FRACTION * white_level, axis=0)
    if not usable[0].any():
        raise CaptureError(
            f"all of the all-off picture is saturated even at {times[0]:.3g} s: darken the room, "
            "and see that the projector shows black, or close the aperture"
        )
    # the same photosites at all exposures, most of them: those that saturate would bend the line
    last = max(k for k in range(len(black)) if k == 0 or usable[k].mean() > 0.5)
    hot = _hot(black[: last + 1], spread, usable, frames.count)
    good = ~hot & usable[last]
    level, variance = black[:, good].mean(axis=1), spread[:, good].mean(axis=1)
    # counts are whole: rounding hides what is far below it
    error = np.sqrt(np.maximum(variance, 1 / 12) / (frames.count * good.sum()))[: last + 1]
    (current, black_level), covariance = (0.0, float(level[0])), np.diag([0, error[0] ** 2])
    if last:
        (current, black_level), covariance = np.polyfit(
            times[: last + 1], level[: last + 1], 1, w=1 / error, cov="unscaled"
        )
    elif len(times) > 1:  # or more
        current = max(0.0, (white_level - level[0]) / times[1])
        black_level = max(0.0, black_level - current * times[0])
    span, longest, noise = white_level - black_level, float(times[-1]), np.sqrt(variance)
    headroom = np.divide(level, noise, out=np.full(level.shape, np.inf), where=noise > 0)
    filled = current * longest / span
    change = np.ptp(levels, axis=0)[: last + 1]
    facts = {
        "room_change": float((change / np.maximum(noise[: last + 1], 0.5)).max()),
        "room_change_share": float(change.max() / span),
        "room_seconds": float(np.ptp(taken_at)),
        "frames": frames.count,
        "exposures_s": times.tolist(),
        "longest_s": longest,
        "level_counts": level.tolist(),
        "variance_counts2": variance.tolist(),
        "black_level_counts": float(black_level),
        "black_level_error": float(np.sqrt(covariance[1, 1])),
        "current_counts_per_s": float(current),
        "current_error": float(np.sqrt(covariance[0, 0])),
        "hot_photosites": int(hot.sum()),
        "hot_share": float(hot.mean()),
        "noise_counts": float(noise[np.argmin(headroom)]),
        "headroom_deviations": float(headroom.min()) if np.isfinite(headroom).any() else None,
        "filled_share": float(filled),
        "bearable_s": bearable_seconds(span, current),
    }
    return Findings.of("dark", facts, {"black": black.astype(np.float32), "hot": hot})


def bearable_seconds(span: float, rate: float) -> float:
    """Return the longest exposure, a minute at most, that light of so many counts a second leaves.

    It then takes a 25th of the range, `span` counts: what is good, less a margin.
    """
    return min(0.04 * span / max(rate, 1e-9), LONGEST_SECONDS)


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
