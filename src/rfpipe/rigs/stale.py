"""Frames of the picture before: noticed while patterns are taken one by one.

A projector that is slower at times than its `settle_seconds` gives brackets that begin with, or
are, the picture before: exposures of a bracket contradict each other, or a bracket is like one
before although another pattern is shown. Neither proves it, as a camera may not be linear, and a
scene may look alike under two patterns. So a doubtful bracket is taken again, later: only where the
second one is another, the first was wrong. Where its frames are only brighter or darker, the lamp
flickers or the gain changes, and neither is better.
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

from rfpipe.photometry.camera import CameraModel
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.check_pictures import thinned
from rfpipe.rigs.faults import AUTOMATIC_OFF, GAIN_CHANGES, SIGNIFICANCE, WHOLE_PERIODS, late_fault
from rfpipe.rigs.late import is_out_of_order
from rfpipe.rigs.noise import CountNoise
from rfpipe.units import SATURATION_FRACTION

Float = NDArray[np.float32]

RETAKE_SECONDS = 0.5
"""Wait before a doubtful bracket is taken again: longer than any display is late."""

FLICKER = 0.05
"""Share of the light by which it may differ beside: lamps flicker."""

ASTRAY = 0.02
"""Share of a picture's light that may be astray in all."""

CONTRADICTION = 0.25
"""The same for exposures that contradict each other: cameras are not quite linear."""

BRIGHTER = 3.0
"""Factor by which gain or a flickering lamp changes a frame at most."""

_MOST_PIXELS = 2**20
_STALE = f"taken again: {late_fault(1.0, 'in part at least').text}"
_UNSTEADY = (
    "exposures of one picture contradict each other, and differ when they are taken again: the "
    f"lamp flickers, or {GAIN_CHANGES}. First {AUTOMATIC_OFF}; if that changes nothing, "
    f"{WHOLE_PERIODS}"
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Light:
    """Black and noise of the frames of one exposure.

    Attributes
    ----------
    black : ndarray of float32
        Mean frame without light.
    black_variance, gain : float
        Its variance, in counts squared; variance a count above black.
    saturated : float
        Counts from which on a pixel says no more.
    """

    black: Float
    black_variance: float
    gain: float
    saturated: float

    def variance(self, counts: Float) -> Float:
        """Return the variance of a frame."""
        above = np.maximum(counts - self.black, 0)
        return np.asarray(self.black_variance + self.gain * above, np.float32)

    def sum(self, frame: Float) -> float:
        """Return the light of a frame in counts."""
        return float(np.maximum(frame - self.black, 0).sum(dtype=np.float64))

    def is_promised(
        self, frame: Float, before: Float, shorter: Light, ratio: float, share: float = ASTRAY
    ) -> bool:
        """Test whether a frame is `ratio` times that of a shorter exposure, up to saturation."""
        promised = self.black + np.float32(ratio) * (before - shorter.black)
        promised[before >= shorter.saturated] = self.saturated
        promised, frame = (np.minimum(one, self.saturated) for one in (promised, frame))
        variance = self.variance(frame) + np.float32(ratio**2) * shorter.variance(before)
        # saturated pixels have no expected light, which would allow other pixels to differ
        light = np.where(promised < self.saturated, np.maximum(promised - self.black, 0), 0)
        total = float(light.sum(dtype=np.float64))
        return is_little(frame - promised, variance, light, total, share)


def is_little(
    off: Float, variance: Float, light: Float, total: float, share: float = ASTRAY
) -> bool:
    """Test whether a difference of frames is little beside their noise and light.

    Parameters
    ----------
    off, variance : ndarray of float32
        Difference of two frames, and its variance.
    light : ndarray of float32
        Expected light of each pixel.
    total : float
        Light of the picture, of which `share` may be astray, and that of a tenth of a pixel.
    """
    off, light = np.abs(off), np.maximum(light, 0)
    beyond = off > SIGNIFICANCE * np.sqrt(variance) + FLICKER * light
    most = share * total + 0.1 * float(light.mean(dtype=np.float64))
    return float(off[beyond].sum(dtype=np.float64)) <= most


class StaleWatch:
    """Compares each bracket with itself and with the last four: a quick capture may lag by several.

    Watched are cameras whose counts are in proportion to light. `statistics` counts ``doubted``,
    brackets taken again; ``stale``, wrong ones; and ``unsteady``, brackets whose repetition differs
    in brightness alone.
    """

    def __init__(self, sensor: Sensor) -> None:
        self._lights: list[Light] = []
        self._exposures = sensor.exposures
        if isinstance(sensor, CameraModel) and sensor.response_gamma == 1:
            self._lights = _lights_of(sensor)
        self._last: deque[tuple[Float, Float]] = deque(maxlen=4)
        self._pause = 1
        self._skipped = 0
        self.statistics = {"doubted": 0, "stale": 0, "unsteady": 0}

    def kept(self, name: str, picture: Float, take: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Take a bracket (E, ...) of a picture and return it, or one taken later in its place."""
        frames = take()
        if not self._lights:
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
                # an unfounded doubt: pause the watch, twice as long the next time
                self._skipped, self._pause = self._pause, min(2 * self._pause, 64)
                if not is_steady:
                    self._count("unsteady", name, _UNSTEADY)
            else:
                self._count("stale", name, _STALE)
                self._pause, frames, sample = 1, repeated, sample_of_repeated
        self._last.append((picture.copy(), sample.copy()))
        return frames

    def _count(self, kind: str, name: str, text: str) -> None:
        """Count a fault, and log the first, second, fourth, eighth, ... of its kind."""
        self.statistics[kind] += 1
        count = self.statistics[kind]
        if count & (count - 1) == 0:
            _log.warning("%s: %s", name, text if count == 1 else f"{text} ({count} times so far)")

    def _is_doubtful(self, bracket: Float, picture: Float) -> bool:
        """Test whether a bracket may be, in part or wholly, of the picture before."""
        return any(self._contradicts(bracket, number) for number in range(1, len(bracket))) or any(
            self._are_alike(bracket, previous)
            for shown, previous in self._last
            if not np.array_equal(shown, picture)
        )

    def _contradicts(self, bracket: Float, number: int) -> bool:
        ratio = self._exposures[number] / self._exposures[number - 1]
        shorter, longer = self._lights[number - 1 : number + 1]
        frame, before = bracket[number], bracket[number - 1]
        return not longer.is_promised(frame, before, shorter, ratio, CONTRADICTION)

    def _differ_in_brightness(self, bracket: Float, other: Float) -> bool:
        """Test whether the frames of two brackets are the same but for a factor each."""
        if self._is_out_of_order(bracket):
            return False
        for light, one, two in zip(self._lights, bracket, other, strict=True):
            usable = np.maximum(one, two) < light.saturated
            sums = [np.where(usable, frame - light.black, 0).sum() for frame in (one, two)]
            factor = float(sums[1] / sums[0]) if min(sums) > 0 else 1.0  # without light: noise
            if not 1 / BRIGHTER < factor < BRIGHTER:
                return False
            off = np.where(usable, two - light.black - factor * (one - light.black), 0)
            variance = light.variance(two) + np.float32(factor**2) * light.variance(one)
            if not is_little(off, variance, two - light.black, light.sum(two)):
                return False
        return True

    def _is_out_of_order(self, bracket: Float) -> bool:
        """Test whether a longer exposure is much darker, as no lamp makes it."""
        sums = [light.sum(frame) for light, frame in zip(self._lights, bracket, strict=True)]
        return is_out_of_order(sums, 1 / BRIGHTER)

    def _are_alike(self, bracket: Float, other: Float) -> bool:
        return all(
            is_little(
                one - two,
                2 * (light.variance(one) + light.variance(two)),
                one - light.black,
                light.sum(one),
            )
            for light, one, two in zip(self._lights, bracket, other, strict=True)
        )


def _lights_of(camera: CameraModel) -> list[Light]:
    """Return black and noise of each exposure by the camera's numbers."""
    noise, saturated = CountNoise.of(camera), SATURATION_FRACTION * camera.white_level
    glow = camera.dark_current_electrons * np.asarray(camera.exposures) / camera.electrons_per_count
    return [
        Light(
            np.asarray(camera.black_level_counts + counts, np.float32),
            float(variance), noise.per_count, saturated,
        )
        for counts, variance in zip(glow, noise.fixed, strict=True)
    ]  # fmt: skip
