"""Contracts of projectors and cameras: tests that every device must pass."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.testing import assert_array_equal, assert_equal
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import Camera, Projector
from rfpipe.testing.checks import opened, require, require_closing, require_raises


class ProjectorContract:
    """Tests that any projector must pass.

    Subclass it as ``Test...`` and define `make_projector`.

    Attributes
    ----------
    accuracy : float
        Largest difference between the light of a pixel and its weight; by default half a step of
        an 8-bit display.
    """

    accuracy: float = 0.5 / 255 + 1e-6

    def make_projector(self) -> Projector:
        """Return a new projector with the same settings at every call."""
        raise NotImplementedError(f"{type(self).__name__} must define make_projector()")

    def read_back(self, projector: Projector) -> Float | None:
        """Return the light that each pixel shows now, (H, W), or None if it can't be measured."""
        del projector
        return None

    def test_shows_pixel_by_pixel(self) -> None:
        """Every pixel shows the light of its weight, and no other pixel does, from any thread."""
        with opened(self.make_projector()) as projector:
            for name, picture in _pictures(projector.shape).items():
                projector.show(picture)
                self._require_shown(projector, picture, name)
                _in_a_thread(projector.show, picture)
                self._require_shown(projector, picture, f"{name}, from another thread")

    def test_accepts_any_memory_layout_and_keeps_no_reference(self) -> None:
        """Pictures may be transposed, strided or read-only, or change afterwards."""
        with opened(self.make_projector()) as projector:
            picture = _pictures(projector.shape)["noise"]
            strided, frozen = np.repeat(picture, 2, axis=1)[:, ::2], picture.copy()
            frozen.flags.writeable = False
            for array in (np.asfortranarray(picture), strided, frozen, picture.copy()):
                projector.show(array)
                if array.flags.writeable:
                    array[...] = 0
                self._require_shown(projector, picture, "a picture in another memory layout")

    def test_rejects_what_cannot_be_shown(self) -> None:
        """Wrong shapes, weights outside [0, 1] and NaN raise InputError and change no picture."""
        with opened(self.make_projector()) as projector:
            picture = _pictures(projector.shape)["noise"]
            projector.show(picture)
            with_nan = picture.copy()
            with_nan[-1, -1] = np.nan
            for wrong in (
                np.vstack([picture, picture[:1]]), picture[..., None].repeat(3, axis=2),
                1.5 + 0 * picture, -picture, 255 * picture, with_nan,
            ):  # fmt: skip
                require_raises(InputError, projector.show, wrong)
            self._require_shown(projector, picture, "the picture before")

    def test_describes_itself_and_closes(self) -> None:
        """`describe` is the same for equal projectors; a closed one raises CaptureError."""
        require_closing(self.make_projector, lambda it: it.show(_pictures(it.shape)["noise"]))

    def _require_shown(self, projector: Projector, picture: Float, name: str) -> None:
        light = self.read_back(projector)
        if light is not None:
            np.testing.assert_allclose(light, picture, rtol=0, atol=self.accuracy, err_msg=name)


class CameraContract:
    """Tests that any camera must pass.

    Subclass it as ``Test...`` and define `make_camera`. The scene in front of the camera must be
    lit and steady, and must not saturate the shortest exposure.

    Attributes
    ----------
    steadiness : float
        Largest relative difference between the mean counts of two pictures of one scene. Also the
        least fraction of full scale that a lit scene reaches at the longest exposure.
    """

    steadiness: float = 0.02

    def make_camera(self) -> Camera:
        """Return a new, preferably small camera with the same settings at every call."""
        raise NotImplementedError(f"{type(self).__name__} must define make_camera()")

    def set_light(self, camera: Camera, is_on: bool) -> bool:
        """Light or darken the scene, and return True; return False if this isn't possible."""
        del camera, is_on
        return False

    def test_brackets(self) -> None:
        """Brackets have the sensor's shape, dtype and range, don't change, and can be merged."""
        with opened(self.make_camera()) as camera:
            sensor = camera.sensor
            require(len(camera.shape) == 2 and min(camera.shape) > 0, f"shape is {camera.shape}")
            require(camera.channels in (1, 3), f"channels is {camera.channels}, not 1 or 3")
            require(min(sensor.exposures) > 0, f"exposures are {sensor.exposures}")
            expected = sensor.frame_shape(camera.shape, camera.channels), sensor.frame_dtype
            for frames in (camera.expose(), _in_a_thread(camera.expose)):
                assert_equal((frames.shape, frames.dtype), expected, "a bracket")
                if isinstance(sensor, CameraModel):
                    require(frames.max() <= sensor.white_level, "counts beyond full scale")
                before = frames.copy()
                camera.expose()
                assert_array_equal(frames, before, "a bracket after the next was taken")
            merged = sensor.merge(frames[None], np.zeros(frames.shape, np.float32))
            assert_equal(merged.radiance.shape, (1, *camera.shape, camera.channels))
            require(np.isfinite(merged.radiance).all(), "merged radiance isn't finite")

    def test_exposures(self) -> None:
        """Longer exposures aren't darker, and two brackets of a scene agree: no frame is stale."""
        with opened(self.make_camera()) as camera:
            self.set_light(camera, True)
            first, second = _means(camera), _means(camera)
            self._require_brightness(first[-1], camera, True)
            steps = np.diff(first) >= -self.steadiness * first[:-1]
            require(steps.all(), f"mean counts of ascending exposures: {first}")
            alike = np.abs(first - second) <= self.steadiness * np.maximum(first, second) + 1
            require(alike.all(), f"mean counts are {first}, then {second}")

    def test_brackets_follow_the_light(self) -> None:
        """The first bracket after the light changes shows the change: no frame is stale."""
        with opened(self.make_camera()) as camera:
            if not self.set_light(camera, True):
                return
            for is_on in (True, False, True, False):
                self.set_light(camera, is_on)
                self._require_brightness(_means(camera)[-1], camera, is_on)

    def test_describes_itself_and_closes(self) -> None:
        """`describe` is the same for equal cameras; a closed one raises CaptureError."""
        require_closing(self.make_camera, lambda camera: camera.expose())

    def _require_brightness(self, counts: float, camera: Camera, is_on: bool) -> None:
        dark, sensor = 0.0, camera.sensor
        if isinstance(sensor, CameraModel):
            black = sensor.black_level_counts
            dark = black + self.steadiness * (sensor.white_level - black)
        brightness = f"{counts:.4g} of at least {dark:.4g} counts"
        require((counts > dark) == is_on, f"{brightness} where light is {'on' if is_on else 'off'}")


def _means(camera: Camera) -> NDArray[np.float64]:
    """Return the mean counts of each exposure, shape (E,)."""
    frames = camera.expose().reshape(len(camera.sensor.exposures), -1)
    return np.asarray(frames.mean(axis=1), np.float64)


def _pictures(shape: tuple[int, int]) -> dict[str, Float]:
    """Return pictures that reveal errors of position, scale or level, by name."""
    random = generator(0)
    corner = np.zeros(shape, np.float32)
    corner[0, -1] = 1
    return {
        "black": np.zeros(shape, np.float32),
        "white": np.ones(shape, np.float32),
        "one pixel": corner,
        "noise": random.random(shape, np.float32),
        "random pixels": (random.random(shape) < 0.5).astype(np.float32),
    }


def _in_a_thread(call: Callable[..., Any], *arguments: Any) -> Any:
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call, *arguments).result()
