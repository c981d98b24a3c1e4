"""What every projector and every camera must do."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import Camera, Projector
from rfpipe.testing.checks import require, require_equal_descriptions, require_raises

Float = NDArray[np.float32]
Device = TypeVar("Device", Projector, Camera)


class _DeviceContract(Generic[Device]):
    """What projectors and cameras have in common."""

    @abstractmethod
    def _make(self) -> Device: ...

    @abstractmethod
    def _use(self, device: Device) -> Any: ...

    @contextmanager
    def _opened(self) -> Iterator[Device]:
        with closing(self._make()) as device:
            yield device

    def test_describes_itself(self) -> None:
        """`describe` gives plain data, the same for equal devices."""
        require_equal_descriptions(self._opened)

    def test_closes(self) -> None:
        """Closing twice is no error; a closed device raises CaptureError."""
        with self._opened() as device:
            device.close()
            device.close()
            require_raises(CaptureError, partial(self._use, device), "it works while closed")


class ProjectorContract(_DeviceContract[Projector]):
    """Tests that any projector must pass; subclass it as ``Test...``, define `make_projector`.

    Attributes
    ----------
    accuracy : float
        By how much the light of a pixel may miss its weight: half a step of an 8-bit display,
        unless set otherwise.
    """

    accuracy: float = 0.5 / 255 + 1e-6

    def make_projector(self) -> Projector:
        """Return a projector, each time anew and each time the same."""
        raise NotImplementedError(f"{type(self).__name__} must define make_projector()")

    def read_back(self, projector: Projector) -> Float | None:
        """Return the light that each pixel gives now, (H, W), or None where nobody can tell."""
        del projector
        return None

    def _make(self) -> Projector:
        return self.make_projector()

    def _use(self, device: Projector) -> None:
        device.show(_pictures(device.shape)["noise"])

    def test_shape(self) -> None:
        """A display has a height and a width."""
        with self._opened() as projector:
            shape = projector.shape
            require(len(shape) == 2 and min(shape) > 0, f"shape is {shape}")

    def test_shows_pixel_by_pixel(self) -> None:
        """Every pixel gives the light of its weight, and no other does, from any thread."""
        with self._opened() as projector:
            for name, picture in _pictures(projector.shape).items():
                projector.show(picture)
                self._require_shown(projector, picture, name)
                _in_a_thread(partial(projector.show, picture))
                self._require_shown(projector, picture, f"{name}, from another thread")

    def test_takes_any_memory_layout_and_keeps_no_hold_of_it(self) -> None:
        """Pictures may be transposed, strided, read-only, or changed afterwards."""
        with self._opened() as projector:
            picture = _pictures(projector.shape)["noise"]
            strided, frozen = np.repeat(picture, 2, axis=1)[:, ::2], picture.copy()
            frozen.flags.writeable = False
            for given in (np.asfortranarray(picture), strided, frozen, picture.copy()):
                projector.show(given)
                if given.flags.writeable:
                    given[...] = 0
                self._require_shown(projector, picture, "a picture in another memory layout")

    def test_rejects_what_cannot_be_shown(self) -> None:
        """Wrong shapes, weights outside [0, 1] and NaN are InputErrors, and show nothing."""
        with self._opened() as projector:
            height, width = projector.shape
            picture = _pictures(projector.shape)["noise"]
            projector.show(picture)
            one_wrong = picture.copy()
            one_wrong[-1, -1] = np.nan
            counts: NDArray[Any] = np.rint(255 * picture).astype(np.uint8)
            for name, wrong in (
                ("another shape", np.zeros((height + 1, width), np.float32)),
                ("three channels", np.zeros((height, width, 3), np.float32)),
                ("a weight of 1.5", np.full_like(picture, 1.5)),
                ("a negative weight", np.full_like(picture, -0.5)),
                ("a picture of 0 to 255", counts),
                ("NaN", one_wrong),
            ):
                show = partial(projector.show, wrong)
                require_raises(InputError, show, f"the projector shows {name}")
            self._require_shown(projector, picture, "the picture before")

    def _require_shown(self, projector: Projector, picture: Float, name: str) -> None:
        light = self.read_back(projector)
        if light is None:
            return
        require(light.shape == picture.shape, f"light of {light.shape} for {picture.shape}")
        off = np.abs(light - picture)
        where = np.unravel_index(int(off.argmax()), off.shape)
        require(
            bool(off.max() <= self.accuracy),
            f"{name}: pixel {tuple(map(int, where))} gives {light[where]:.6g}, its weight is "
            f"{picture[where]:.6g}; {np.count_nonzero(off > self.accuracy)} pixels are off by "
            f"more than {self.accuracy:.3g}",
        )


class CameraContract(_DeviceContract[Camera]):
    """Tests that any camera must pass; subclass it as ``Test...`` and define `make_camera`.

    What is before the camera should not change, nor be brighter than the shortest exposure takes.

    Attributes
    ----------
    steadiness : float
        Fraction of the mean counts by which two pictures of one thing may differ.
    """

    steadiness: float = 0.02

    def make_camera(self) -> Camera:
        """Return a camera, each time anew and each time the same; small, to be quick."""
        raise NotImplementedError(f"{type(self).__name__} must define make_camera()")

    def _make(self) -> Camera:
        return self.make_camera()

    def _use(self, device: Camera) -> Any:
        return device.expose()

    def test_shapes(self) -> None:
        """Frames have a height and a width, merged images 1 or 3 channels."""
        with self._opened() as camera:
            require(len(camera.shape) == 2 and min(camera.shape) > 0, f"shape is {camera.shape}")
            require(camera.channels in (1, 3), f"channels is {camera.channels}, not 1 or 3")
            exposures = camera.sensor.exposures
            require(min(exposures) > 0, f"exposures are {exposures}")

    def test_brackets(self) -> None:
        """Brackets have the sensor's shape, dtype and range, from any thread, and keep them."""
        with self._opened() as camera:
            sensor = camera.sensor
            expected = sensor.frame_shape(camera.shape, camera.channels), sensor.frame_dtype
            for expose in (camera.expose, partial(_in_a_thread, camera.expose)):
                frames = expose()
                found = frames.shape, frames.dtype
                require(found == expected, f"a bracket is {found}; expected {expected}")
                if isinstance(sensor, CameraModel):
                    largest = int(frames.max())
                    full = f"full scale is {sensor.white_level}"
                    require(largest <= sensor.white_level, f"counts reach {largest}; {full}")
                before = frames.copy()
                camera.expose()
                same = np.array_equal(frames, before)
                require(same, "a bracket changed when the next was taken")

    def test_longer_exposures_are_not_darker(self) -> None:
        """The exposures of a bracket come in their order."""
        with self._opened() as camera:
            means = _means(camera)
            steps = np.diff(means) >= -self.steadiness * means[:-1]
            require(bool(steps.all()), f"mean counts of ascending exposures: {means}")

    def test_is_steady(self) -> None:
        """Two brackets of one thing are alike: no frame is an old or a foreign one."""
        with self._opened() as camera:
            first, second = _means(camera), _means(camera)
            alike = np.abs(first - second) <= self.steadiness * np.maximum(first, second) + 1
            require(bool(alike.all()), f"mean counts are {first}, then {second}")

    def test_merges(self) -> None:
        """The sensor merges what the camera takes."""
        with self._opened() as camera:
            frames = camera.expose()
            merged = camera.sensor.merge(frames[None], np.zeros(frames.shape, np.float32))
            expected = (1, *camera.shape, camera.channels)
            require(merged.radiance.shape == expected, f"merged images {merged.radiance.shape}")
            require(np.isfinite(merged.radiance).all(), "merged radiance isn't finite")


def _means(camera: Camera) -> NDArray[np.float64]:
    """Return the mean counts of each exposure."""
    frames = camera.expose().reshape(len(camera.sensor.exposures), -1)
    return np.asarray(frames.mean(axis=1), np.float64)


def _pictures(shape: tuple[int, int]) -> dict[str, Float]:
    """Return pictures that show a mistake in place, scale or level."""
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


def _in_a_thread(call: Callable[[], Any]) -> Any:
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result()
