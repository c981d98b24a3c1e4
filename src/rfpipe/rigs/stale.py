"""Frames of the pattern before: noticed while patterns are taken one by one.

A projector that is slower at times than its `settle_seconds` gives brackets that begin with, or
are, the picture before. Two things look like it: exposures of a bracket that contradict each other,
and a bracket like the one before although another pattern is shown. Neither proves it, as a camera
may not be linear, and a scene may look alike under two patterns. So a doubtful bracket is taken
again, later: only where the second one is another, the first was wrong.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.camera import CameraModel
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.sequence_frames import Light, is_little

__all__ = ["RETAKE_SECONDS", "StaleWatch"]

Float = NDArray[np.float32]

RETAKE_SECONDS = 0.5
"""Wait before a doubtful bracket is taken again: longer than any display is late."""

CONTRADICTION = 0.25
"""Share of a frame's light by which it must miss what the exposure before promises."""

UNSURE = 4.0
"""Factor on the noise that the settings say: they may not be measured yet."""

MOST_PIXELS = 2**20
"""Pixels that are compared."""

MOST_SKIPPED = 64
"""Patterns that go by unwatched after an unfounded doubt: 1 after the first, then twice as many."""

REMEMBERED = 4
"""Brackets that a new one is compared with: a quick capture may be late by more than one."""

SATURATION = 0.98


class StaleWatch:
    """Compares each bracket with itself and with those before.

    Parameters
    ----------
    sensor : Sensor
        Watched are cameras whose counts are in proportion to light.

    Attributes
    ----------
    statistics : dict of str to int
        ``doubted``: brackets taken again; ``stale``: those that were wrong.
    """

    def __init__(self, sensor: Sensor) -> None:
        self._lights: list[Light] = []
        self._exposures = sensor.exposures
        if isinstance(sensor, CameraModel) and sensor.response_gamma == 1:
            self._lights = [_light(sensor, exposure) for exposure in sensor.exposures]
        self._last: deque[tuple[Float, Float]] = deque(maxlen=REMEMBERED)
        self._pause = 1
        self._skipped = 0
        self.statistics = {"doubted": 0, "stale": 0}

    def is_doubtful(self, frames: NDArray[Any], picture: Float) -> bool:
        """Whether a bracket (E, ...) may be, in part or wholly, of the picture before."""
        if not self._lights:
            return False
        if self._skipped:
            self._skipped -= 1
            return False
        seen = _some(frames)
        if any(self._contradicts(seen, number) for number in range(1, len(seen))):
            return True
        return any(
            self._are_alike(seen, taken)
            for shown, taken in self._last
            if not np.array_equal(shown, picture)
        )

    def accept(self, frames: NDArray[Any], picture: Float) -> None:
        """Note what was taken in the end, for the next bracket."""
        if self._lights:
            self._last.append((picture.copy(), _some(frames)))

    def judge(self, frames: NDArray[Any], again: NDArray[Any]) -> bool:
        """Whether a doubtful bracket was wrong, by another one taken later."""
        self.statistics["doubted"] += 1
        if self._are_alike(_some(frames), _some(again)):
            self._skipped, self._pause = self._pause, min(2 * self._pause, MOST_SKIPPED)
            return False
        self.statistics["stale"] += 1
        self._pause = 1
        return True

    def _contradicts(self, seen: Float, number: int) -> bool:
        ratio = self._exposures[number] / self._exposures[number - 1]
        shorter, longer = self._lights[number - 1 : number + 1]
        return not longer.is_promised(seen[number], seen[number - 1], shorter, ratio, CONTRADICTION)

    def _are_alike(self, seen: Float, other: Float) -> bool:
        return all(
            is_little(
                one - two,
                2 * (light.variance(one) + light.variance(two)),
                one - light.black,
                float(np.maximum(one - light.black, 0).sum(dtype=np.float64)),
            )
            for light, one, two in zip(self._lights, seen, other, strict=True)
        )


def _light(camera: CameraModel, exposure: float) -> Light:
    """Return what a camera's numbers say of one exposure."""
    electrons = camera.electrons_per_count
    glow = camera.dark_current_electrons * exposure
    black = np.float32(camera.black_level_counts + glow / electrons)
    variance = (camera.read_noise_electrons**2 + glow) / electrons**2 + 1 / 12
    white = np.float32(camera.white_level)
    return Light(
        np.asarray(white),
        np.asarray(black),
        UNSURE * variance,
        UNSURE / electrons,
        SATURATION * camera.white_level,
    )


def _some(frames: NDArray[Any]) -> Float:
    """Return at most `MOST_PIXELS` pixels of each frame, (E, n)."""
    flat = frames.reshape(len(frames), -1)
    return flat[:, :: -(-flat.shape[1] // MOST_PIXELS)].astype(np.float32)
