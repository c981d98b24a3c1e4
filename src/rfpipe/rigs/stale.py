"""Detection of stale frames, which show the previous picture, while patterns are captured.

If a projector is slower than its `settle_seconds`, brackets show the previous picture in part or
wholly: their exposures contradict each other, or a bracket equals a previous one although the
pattern differs. Neither is a proof, since a camera may not be linear, and a scene may look the same
under two patterns. Therefore a doubtful bracket is repeated after a pause, and was stale only if
the repetition differs. If the repetition differs in brightness only, the lamp flickers or the gain
changes, and both brackets are equally good.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.photometry.camera import CameraModel
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.check_pictures import thinned
from rfpipe.rigs.faults import AUTOMATIC_OFF, GAIN_CHANGES, SIGNIFICANCE, WHOLE_PERIODS, late_fault
from rfpipe.rigs.late import is_out_of_order
from rfpipe.rigs.noise import CountNoise
from rfpipe.units import SATURATION_FRACTION

RETAKE_SECONDS = 0.5
"""Pause before a doubtful bracket is repeated, longer than the delay of any display."""

FLICKER = 0.05
"""Accepted difference of two frames, relative to the light of a pixel, due to flicker."""

ASTRAY = 0.02
"""Accepted sum of larger differences, relative to the light of the picture."""

CONTRADICTION = 0.25
"""Accepted sum between exposures of one bracket: cameras are not exactly linear."""

BRIGHTER = 3.0
"""Largest factor by which gain or a flickering lamp changes a frame."""

_MOST_PIXELS = 2**20
_STALE = f"captured again: {late_fault(1.0, 'at least in part').text}"
_UNSTEADY = (
    "exposures of one picture contradict each other, and differ when they are repeated: the lamp "
    f"flickers, or {GAIN_CHANGES}. First {AUTOMATIC_OFF}; if that changes nothing, "
    f"{WHOLE_PERIODS}"
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ExposureNoise:
    """Black level and noise of the frames of one exposure.

    Attributes
    ----------
    black : ndarray of float32
        Mean frame without light.
    black_variance, gain : float
        Variance without light, in squared counts; variance per count above black.
    saturated : float
        Least count of a saturated pixel.
    """

    black: Float
    black_variance: float
    gain: float
    saturated: float

    def variance(self, counts: Float) -> Float:
        """Expected variance of a frame's counts."""
        above = np.maximum(counts - self.black, 0)
        return np.asarray(self.black_variance + self.gain * above, np.float32)

    def sum(self, frame: Float) -> float:
        """Total light of a frame in counts."""
        return float(np.maximum(frame - self.black, 0).sum(dtype=np.float64))

    def agrees(
        self,
        frame: Float,
        shorter_frame: Float,
        shorter: ExposureNoise,
        ratio: float,
        share: float = ASTRAY,
    ) -> bool:
        """Test whether a frame is `ratio` times a shorter exposure, up to saturation."""
        expected = self.black + np.float32(ratio) * (shorter_frame - shorter.black)
        expected[shorter_frame >= shorter.saturated] = self.saturated
        expected, frame = (np.minimum(counts, self.saturated) for counts in (expected, frame))
        variance = self.variance(frame) + np.float32(ratio**2) * shorter.variance(shorter_frame)
        # saturated pixels have no expected light, which would allow other pixels to differ
        light = np.where(expected < self.saturated, np.maximum(expected - self.black, 0), 0)
        total = float(light.sum(dtype=np.float64))
        return is_small(frame - expected, variance, light, total, share)


def is_small(
    difference: Float, variance: Float, light: Float, total: float, share: float = ASTRAY
) -> bool:
    """Test whether a difference of frames is small compared to their noise and light.

    Parameters
    ----------
    difference, variance : ndarray of float32
        Difference of two frames, and its variance.
    light : ndarray of float32
        Expected light of each pixel.
    total : float
        Light of the picture. Significant differences may add up to `share` of it, plus a tenth of
        a pixel's light.
    """
    difference, light = np.abs(difference), np.maximum(light, 0)
    significant = difference > SIGNIFICANCE * np.sqrt(variance) + FLICKER * light
    limit = share * total + 0.1 * float(light.mean(dtype=np.float64))
    return float(difference[significant].sum(dtype=np.float64)) <= limit


class StaleWatch:
    """Captures brackets, and repeats stale ones.

    Each bracket is checked in itself and compared with the previous four, since a fast capture may
    lag by several pictures. Cameras whose counts aren't proportional to light are not checked.

    Attributes
    ----------
    statistics : dict
        Numbers of brackets: ``doubted``, which were repeated; ``stale``; and ``unsteady``, whose
        repetition differs in brightness only.
    """

    def __init__(self, sensor: Sensor) -> None:
        self._noise: list[ExposureNoise] = []
        self._exposures = sensor.exposures
        if isinstance(sensor, CameraModel) and sensor.response_gamma == 1:
            self._noise = _noise_of(sensor)
        self._previous: deque[tuple[Float, Float]] = deque(maxlen=4)
        self._pause = 1
        self._skipped = 0
        self.statistics = {"doubted": 0, "stale": 0, "unsteady": 0}

    def capture(self, name: str, picture: Float, take: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Capture a bracket (E, ...) of a picture by `take`; return its repetition if it is stale.

        `name` describes the picture in log messages.
        """
        frames = take()
        if not self._noise:
            return frames
        sample = thinned(frames, _MOST_PIXELS)
        if self._skipped:
            self._skipped -= 1
        elif self._is_doubtful(sample, picture):
            time.sleep(RETAKE_SECONDS)
            repeated = take()
            sample_of_repeated = thinned(repeated, _MOST_PIXELS)
            self.statistics["doubted"] += 1
            is_steady = self._are_alike(sample, sample_of_repeated)
            if is_steady or self._differ_in_brightness(sample, sample_of_repeated):
                # the doubt was unfounded: skip brackets, twice as many the next time
                self._skipped, self._pause = self._pause, min(2 * self._pause, 64)
                if not is_steady:
                    self._count("unsteady", name, _UNSTEADY)
            else:
                self._count("stale", name, _STALE)
                self._pause, frames, sample = 1, repeated, sample_of_repeated
        self._previous.append((picture.copy(), sample.copy()))
        return frames

    def _count(self, kind: str, name: str, text: str) -> None:
        """Count a fault, and log the first, second, fourth, eighth, ... of its kind."""
        self.statistics[kind] += 1
        count = self.statistics[kind]
        if count & (count - 1) == 0:
            _log.warning("%s: %s", name, text if count == 1 else f"{text} ({count} times so far)")

    def _is_doubtful(self, bracket: Float, picture: Float) -> bool:
        """Test whether a bracket may show the previous picture, in part or wholly."""
        return any(self._contradicts(bracket, number) for number in range(1, len(bracket))) or any(
            self._are_alike(bracket, previous)
            for displayed, previous in self._previous
            if not np.array_equal(displayed, picture)
        )

    def _contradicts(self, bracket: Float, number: int) -> bool:
        """Test whether an exposure of a bracket contradicts the next shorter one."""
        ratio = self._exposures[number] / self._exposures[number - 1]
        shorter, longer = self._noise[number - 1 : number + 1]
        frame, shorter_frame = bracket[number], bracket[number - 1]
        return not longer.agrees(frame, shorter_frame, shorter, ratio, CONTRADICTION)

    def _differ_in_brightness(self, bracket: Float, repetition: Float) -> bool:
        """Test whether the frames of two brackets differ by one factor per exposure only."""
        if self._is_out_of_order(bracket):
            return False
        for noise, first, second in zip(self._noise, bracket, repetition, strict=True):
            usable = np.maximum(first, second) < noise.saturated
            sums = [np.where(usable, frame - noise.black, 0).sum() for frame in (first, second)]
            factor = float(sums[1] / sums[0]) if min(sums) > 0 else 1.0  # without light: noise
            if not 1 / BRIGHTER < factor < BRIGHTER:
                return False
            difference = np.where(usable, second - noise.black - factor * (first - noise.black), 0)
            variance = noise.variance(second) + np.float32(factor**2) * noise.variance(first)
            if not is_small(difference, variance, second - noise.black, noise.sum(second)):
                return False
        return True

    def _is_out_of_order(self, bracket: Float) -> bool:
        """Test whether a longer exposure is much darker, more than a lamp can cause."""
        sums = [noise.sum(frame) for noise, frame in zip(self._noise, bracket, strict=True)]
        return is_out_of_order(sums, 1 / BRIGHTER)

    def _are_alike(self, bracket: Float, previous: Float) -> bool:
        """Test whether two brackets agree within noise and flicker."""
        return all(
            is_small(
                first - second,
                2 * (noise.variance(first) + noise.variance(second)),
                first - noise.black,
                noise.sum(first),
            )
            for noise, first, second in zip(self._noise, bracket, previous, strict=True)
        )


def _noise_of(camera: CameraModel) -> list[ExposureNoise]:
    """Black level and noise of each exposure according to the camera's settings."""
    noise, saturated = CountNoise.of(camera), SATURATION_FRACTION * camera.white_level
    glow = camera.dark_current_electrons * np.asarray(camera.exposures) / camera.electrons_per_count
    return [
        ExposureNoise(
            np.asarray(camera.black_level_counts + counts, np.float32),
            float(variance), noise.per_count, saturated,
        )
        for counts, variance in zip(glow, noise.fixed, strict=True)
    ]  # fmt: skip
