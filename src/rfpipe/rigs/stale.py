"""Frames of the pattern before: noticed while patterns are taken one by one.

A projector that is slower at times than its `settle_seconds` gives brackets that begin with, or
are, the picture before: exposures of a bracket contradict each other, or a bracket is like one
before although another pattern is shown. Neither proves it, as a camera may not be linear, and a
scene may look alike under two patterns. So a doubtful bracket is taken again, later: only where the
second one is another, the first was wrong.
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
from rfpipe.units import SATURATION_FRACTION

Float = NDArray[np.float32]

RETAKE_SECONDS = 0.5
"""Wait before a doubtful bracket is taken again: longer than any display is late."""

SIGNIFICANCE = 6.0
"""Deviations of noise beyond which a pixel differs."""

FLICKER = 0.05
"""Share of the light by which it may differ beside: lamps flicker."""

ASTRAY = 0.02
"""Share of a picture's light that may be astray in all."""

CONTRADICTION = 0.25
"""The same for exposures that contradict each other: cameras are not quite linear."""

UNSURE = 4.0
"""Factor on the variance that the settings say: it may not be measured yet."""

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
        """Tell whether a frame is `ratio` times that of a shorter exposure, up to saturation."""
        promised = self.black + np.float32(ratio) * (before - shorter.black)
        promised[before >= shorter.saturated] = self.saturated
        promised, frame = (np.minimum(one, self.saturated) for one in (promised, frame))
        variance = self.variance(frame) + np.float32(ratio**2) * shorter.variance(before)
        # what is saturated says nothing, and must not make room for the rest
        light = np.where(promised < self.saturated, np.maximum(promised - self.black, 0), 0)
        total = float(light.sum(dtype=np.float64))
        return is_little(frame - promised, variance, light, total, share)


def is_little(
    off: Float, variance: Float, light: Float, total: float, share: float = ASTRAY
) -> bool:
    """Tell whether a difference of frames is little beside their noise and light.

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
    brackets taken again, and ``stale``, those that were wrong.
    """

    def __init__(self, sensor: Sensor) -> None:
        self._lights: list[Light] = []
        self._exposures = sensor.exposures
        if isinstance(sensor, CameraModel) and sensor.response_gamma == 1:
            self._lights = [_light(sensor, exposure) for exposure in sensor.exposures]
        self._last: deque[tuple[Float, Float]] = deque(maxlen=4)
        self._pause = 1
        self._skipped = 0
        self.statistics = {"doubted": 0, "stale": 0}

    def kept(self, name: str, picture: Float, take: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Take a bracket (E, ...) of a picture and return it, or one taken later in its place."""
        frames = take()
        if not self._lights:
            return frames
        if self._skipped:
            self._skipped -= 1
        elif self._is_doubtful(_some(frames), picture):
            time.sleep(RETAKE_SECONDS)
            again = take()
            self.statistics["doubted"] += 1
            if self._are_alike(_some(frames), _some(again)):
                # an unfounded doubt: so many patterns go by unwatched, twice as many the next time
                self._skipped, self._pause = self._pause, min(2 * self._pause, 64)
            else:
                _log.warning(
                    "%s: the frames were, in part at least, of the pattern before; taken again. "
                    "The projector is slower than its settle_seconds: `rfpipe calibrate` measures "
                    "its delay (step latency)", name,
                )  # fmt: skip
                self.statistics["stale"] += 1
                self._pause, frames = 1, again
        self._last.append((picture.copy(), _some(frames)))
        return frames

    def _is_doubtful(self, bracket: Float, picture: Float) -> bool:
        """Tell whether a bracket may be, in part or wholly, of the picture before."""
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


def _light(camera: CameraModel, exposure: float) -> Light:
    """Return black and noise of one exposure by the camera's numbers."""
    electrons = camera.electrons_per_count
    glow = camera.dark_current_electrons * exposure
    return Light(
        np.asarray(camera.black_level_counts + glow / electrons, np.float32),
        UNSURE * ((camera.read_noise_electrons**2 + glow) / electrons**2 + 1 / 12),
        UNSURE / electrons,
        SATURATION_FRACTION * camera.white_level,
    )


def _some(frames: NDArray[Any]) -> Float:
    """Return at most a million pixels of each frame, (E, n)."""
    flat = frames.reshape(len(frames), -1)
    return flat[:, :: -(-flat.shape[1] // 2**20)].astype(np.float32)
