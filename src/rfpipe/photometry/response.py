"""The response of a non-linear camera: its table, its nominal form, its recovery."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError
from rfpipe.provenance import generator

Double = NDArray[np.float64]

SAMPLES = 200
"""Pixels that a response is recovered from: well over n / (E - 1), which the solver needs."""

SMOOTHNESS = 30.0
"""Debevec and Malik's lambda, for counts scaled to 256 values."""

BINS = 256
"""Values that counts are scaled to for the solver, as in the paper."""

LOWEST, HIGHEST = 8, 246
"""Values between which the solver's curve is used: a thirtieth of full scale from either end, where
its weights are a twentieth of their largest or more."""


@dataclass(frozen=True, eq=False)
class Response:
    """A camera's response as a monotone table.

    Parameters
    ----------
    level : ndarray of float64, shape (n,)
        Counts above the black level as a fraction of full scale, ascending from 0 to 1.
    exposure : ndarray of float64, shape (n,)
        Light that gives that level, as a fraction of the light at full scale, ascending from
        0 to 1.
    """

    level: Double
    exposure: Double

    def __post_init__(self) -> None:
        for name, values in (("level", self.level), ("exposure", self.exposure)):
            if values.ndim != 1 or len(values) < 2 or not np.isfinite(values).all():
                raise InputError(f"a response's {name} must be 2 or more finite numbers")
            if values[0] != 0 or values[-1] != 1 or (np.diff(values) <= 0).any():
                raise InputError(f"a response's {name} must ascend strictly from 0 to 1")
        if self.level.shape != self.exposure.shape:
            raise InputError(
                f"a response has {len(self.level)} levels but {len(self.exposure)} exposures"
            )

    def linearise(self, level: NDArray[Any]) -> Double:
        """Return the light, as a fraction of that at full scale, behind levels in [-1, 1].

        Below the black level the response is taken as odd: noise there averages to zero.
        """
        level = np.asarray(level, np.float64)
        light = np.interp(np.abs(level), self.level, self.exposure)
        return np.asarray(np.copysign(light, level))


def recover_response(
    frames: NDArray[np.uint16],
    exposures: Sequence[float],
    black: NDArray[Any],
    white_level: int,
    seed: int = 0,
) -> Response:
    """Recover a camera's response from one bracket [DM97], by colour-hdri's solver.

    Parameters
    ----------
    frames : ndarray of uint16, shape (E, ...)
        A bracket of the floodlit scene, E at least 2, at best 4 or more with factors of 2 to 4
        between exposures; channels and photosites share one response.
    exposures : sequence of float
        Exposure times in seconds.
    black : ndarray, shape (E, ...)
        The mean of the all-off frames, in counts.
    white_level : int
        Full scale in counts.
    seed : int
        Seed of the choice of pixels.

    Returns
    -------
    Response
        Monotone; its scale is set so that full scale is 1.

    Raises
    ------
    InputError
        When the shapes don't fit together.
    CaptureError
        When the bracket has fewer than two exposures, or no pixel between black and saturated
        in at least two of them.

    References
    ----------
    Debevec and Malik, Recovering high dynamic range radiance maps from photographs, 1997.
    """
    if frames.shape != np.shape(black) or len(frames) != len(exposures):
        raise InputError(
            f"frames {frames.shape}, black {np.shape(black)} and {len(exposures)} exposures "
            "don't belong together"
        )
    if len(exposures) < 2:
        raise CaptureError("a response can't be recovered from one exposure; take 2 or more")
    samples = _choose_samples(frames, np.asarray(black), white_level, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colour warns of its own deprecated imports
        from colour_hdri import g_solve

        log_exposure = g_solve(samples, np.log(np.asarray(exposures)), SMOOTHNESS, n=BINS)[0]
    return _table(np.asarray(log_exposure, np.float64))


def _choose_samples(
    frames: NDArray[np.uint16], black: NDArray[Any], white_level: int, seed: int
) -> NDArray[np.int64]:
    """Choose pixels (samples, E) spread evenly over the levels, scaled to `BINS` values."""
    count = len(frames)
    pedestal = black.reshape(count, -1).astype(np.float64)
    span = np.maximum(white_level - pedestal, 1)  # a pixel stuck at full scale has none
    level = (frames.reshape(count, -1) - pedestal) / span
    usable = (level > 1 / BINS) & (frames.reshape(count, -1) < white_level)
    candidates = np.flatnonzero(usable.sum(axis=0) >= 2)
    if len(candidates) == 0:
        raise CaptureError(
            "no pixel of the bracket lies between black and saturated in two exposures or more; "
            "choose exposures closer to each other, or light the scene evenly"
        )
    # Even in the sum over exposures, which orders pixels by their light: a scene's histogram
    # alone would leave most levels without a sample.
    brightness = level[:, candidates].sum(axis=0)
    order = candidates[np.argsort(brightness, kind="stable")]
    edges = np.searchsorted(np.sort(brightness), np.linspace(0, brightness.max(), SAMPLES + 1))
    random = generator(seed)
    chosen = [
        order[random.integers(first, last)] for first, last in pairwise(edges) if last > first
    ]
    scaled = np.rint(np.clip(level[:, chosen].T, 0, 1) * (BINS - 1))
    return scaled.astype(np.int64)


def _table(log_exposure: Double) -> Response:
    """Return the solver's curve as a strictly ascending table from (0, 0) to (1, 1).

    At both ends the solver's weights vanish and its values mean nothing: below `LOWEST` and above
    `HIGHEST` the curve goes on as the power of the level that fits it next to there.
    """
    level = np.arange(BINS) / (BINS - 1)
    curve = log_exposure.copy()
    foot = slice(LOWEST, 3 * LOWEST)
    head = slice(2 * HIGHEST - BINS, HIGHEST + 1)
    for part, outside in ((foot, slice(1, LOWEST)), (head, slice(HIGHEST + 1, BINS))):
        fit = np.polyfit(np.log(level[part]), log_exposure[part], 1)
        curve[outside] = np.polyval(fit, np.log(level[outside]))
    curve[1:] = np.maximum.accumulate(curve[1:])
    light = np.exp(curve - curve[-1])
    light[0] = 0
    keep = np.concatenate([[True], np.diff(light) > 0])
    keep[-1], light[-1] = True, 1
    keep[:-1] &= light[:-1] < 1
    return Response(level[keep], light[keep])
