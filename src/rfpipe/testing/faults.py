"""Faulty devices: wrappers that make a projector or a camera fail in a known way.

They test the checks of a calibration, a capture or a driver. Each wraps any device, simulated or
real, and has the description of that device, so that only the pictures reveal the fault::

    from rfpipe.testing import faults

    camera = faults.jittering_gain(MyCamera(), after=200)  # clean for 200 brackets
    rig = rfpipe.DeviceRig(MyProjector(), camera)

`after` is the number of pictures (of a projector) or of brackets (of a camera) before the fault
begins; ``wrapper.after = wrapper.count`` begins it immediately. Frames are changed in counts, after
the noise. Faults that depend on time use a simulated clock: each exposure takes its length and
20 ms. Hardware sequences are disabled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs.devices import Camera, Projector
from rfpipe.units import SATURATION_FRACTION

Frames = NDArray[Any]

READOUT_SECONDS = 0.02
"""Simulated time from the end of an exposure to the beginning of the next."""


@dataclass(frozen=True)
class Moment:
    """Number and time of a bracket.

    Attributes
    ----------
    index : int
        Brackets since the fault began.
    starts : ndarray of float64, shape (E,)
        Simulated beginning of each exposure, in seconds since the first bracket.
    """

    index: int
    starts: NDArray[np.float64]


ChangeFrames = Callable[[Frames, Moment], Frames]
"""Function that returns the faulty frames (E, ...) of a bracket."""


class FaultyProjector:
    """A projector whose pictures are changed by a fault.

    Parameters
    ----------
    projector : Projector
    change : callable
        ``change(picture)`` returns the picture (H, W) to show instead.
    after : int
        Pictures before the fault begins.

    Attributes
    ----------
    count : int
        Pictures shown so far.
    """

    sequence_pictures = 0

    def __init__(
        self, projector: Projector, change: Callable[[Float], Float], after: int = 0
    ) -> None:
        self._device, self._change, self.after, self.count = projector, change, after, 0

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._device, name)
        return self._wrap(value) if name == "show_now" else value

    def show(self, picture: Float) -> None:
        """Show a picture; see `rfpipe.rigs.devices.Projector.show`."""
        self._wrap(self._device.show)(picture)

    def _wrap(self, show: Callable[[Float], None]) -> Callable[[Float], None]:
        def show_changed(picture: Float) -> None:
            is_faulty = self.count >= self.after
            self.count += 1
            show(self._change(np.asarray(picture)) if is_faulty else picture)

        return show_changed


class FaultyCamera:
    """A camera whose frames are changed by a fault.

    Parameters
    ----------
    camera : Camera
    change : callable
        ``change(frames, moment)`` returns the faulty frames (E, ...) of a bracket.
    after : int
        Brackets before the fault begins.

    Attributes
    ----------
    count : int
        Brackets taken so far.
    """

    can_be_triggered = False

    def __init__(self, camera: Camera, change: ChangeFrames, after: int = 0) -> None:
        self._device, self._change, self.after, self.count = camera, change, after, 0
        self._seconds = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def expose(self) -> Frames:
        """Take one bracket; see `rfpipe.rigs.devices.Camera.expose`."""
        frames = self._take()
        lengths = np.asarray(self._device.sensor.exposures) + READOUT_SECONDS
        ends = self._seconds + np.cumsum(lengths)
        moment = Moment(self.count - self.after, ends - lengths)
        self._seconds = float(ends[-1])
        self.count += 1
        return self._change(frames, moment) if moment.index >= 0 else frames

    def _take(self) -> Frames:
        return np.asarray(self._device.expose())


class LateCamera(FaultyCamera):
    """A camera whose queue delays frames: each bracket begins with frames of the previous one.

    Parameters
    ----------
    camera : Camera
    after : int
        Brackets before the fault begins.
    frames : int, optional
        Delay in frames, at most the frames of one bracket. None delays by one bracket.
    """

    def __init__(self, camera: Camera, after: int = 0, frames: int | None = None) -> None:
        bracket = len(camera.sensor.exposures)
        self._late = bracket if frames is None else frames
        if not 1 <= self._late <= bracket:
            raise InputError(
                f"frames is {frames}; expected 1 to {bracket}, the frames of a bracket"
            )
        super().__init__(camera, self._delayed, after)
        self._stream: list[Frames] = []

    def _take(self) -> Frames:
        frames = super()._take()
        # before the first bracket, the queue is filled with its frames
        self._stream = [*(self._stream or frames)[-len(frames) :], *frames]
        return frames

    def _delayed(self, frames: Frames, moment: Moment) -> Frames:
        del moment
        last = len(self._stream) - self._late
        return np.stack(self._stream[last - len(frames) : last])


class RepeatingCamera(FaultyCamera):
    """A camera whose driver delivers the previous bracket again where it has no new one.

    Parameters
    ----------
    camera : Camera
    after : int
        Brackets before the fault begins.
    every : int
        One bracket of this number is a repetition.
    """

    def __init__(self, camera: Camera, after: int = 0, every: int = 4) -> None:
        super().__init__(camera, self._repeated, after)
        self._every = every
        self._previous: Frames | None = None

    def _repeated(self, frames: Frames, moment: Moment) -> Frames:
        is_new = moment.index % self._every or self._previous is None
        self._previous = frames if is_new else self._previous
        return np.asarray(self._previous)


def jittering_gain(
    camera: Camera, after: int = 0, deviation: float = 0.1, seed: int = 0
) -> FaultyCamera:
    """Return a camera with automatic gain: a random gain multiplies each bracket.

    `deviation` is the standard deviation of the gain's logarithm.
    """

    def change(frames: Frames, moment: Moment) -> Frames:
        random = generator(seed, moment.index)
        return _scaled(frames, camera, float(np.exp(deviation * random.standard_normal())))

    return FaultyCamera(camera, change, after)


def flickering_lamp(
    camera: Camera, after: int = 0, depth: float = 0.4, hertz: float = 100.0, seed: int = 0
) -> FaultyCamera:
    """Return a camera under a flickering lamp: ``1 + depth * cos(2 pi hertz t + phase)``.

    Each exposure has the mean of the light over its length, with a random phase. Over whole periods
    the flicker cancels. Mains-powered lamps flicker at twice the mains frequency.
    """

    def change(frames: Frames, moment: Moment) -> Frames:
        phases = generator(seed, moment.index).uniform(0, 2 * np.pi, len(frames))
        swing = depth * np.sinc(hertz * np.asarray(camera.sensor.exposures))
        return _scaled(frames, camera, 1 + swing * np.cos(phases))

    return FaultyCamera(camera, change, after)


def drifting_lamp(
    camera: Camera, after: int = 0, change: float = -0.06, brackets: int = 100
) -> FaultyCamera:
    """Return a camera under a drifting lamp: its light changes by `change` in `brackets` brackets.

    The light is constant afterwards.
    """

    def changed(frames: Frames, moment: Moment) -> Frames:
        return _scaled(frames, camera, 1 + change * min(1.0, moment.index / brackets))

    return FaultyCamera(camera, changed, after)


def changing_room_light(
    camera: Camera, after: int = 0, light: float = 0.02, seconds: float = 20.0, seed: int = 0
) -> FaultyCamera:
    """Return a camera in a room whose light changes, for example by clouds.

    The room adds a uniform radiance that oscillates between 0 and `light` with a period of
    `seconds`, with photon noise.
    """
    sensor = _counts_of(camera)

    def change(frames: Frames, moment: Moment) -> Frames:
        exposures = np.asarray(sensor.exposures)
        phase = 2 * np.pi * (moment.starts + exposures / 2) / seconds
        radiance = light * (1 - np.cos(phase)) / 2
        mean = _per_frame(sensor.electrons_per_radiance * exposures * radiance, frames)
        noise = generator(seed, moment.index).standard_normal(frames.shape)
        return _counts(frames + (mean + np.sqrt(mean) * noise) / sensor.electrons_per_count, sensor)

    return FaultyCamera(camera, change, after)


def moved_camera(camera: Camera, after: int = 0, pixels: tuple[int, int] = (0, 1)) -> FaultyCamera:
    """Return a camera that was moved: its picture is shifted by `pixels` down and to the right.

    For a camera with a colour mosaic the shifts must be even, since the mosaic doesn't move.
    """
    if camera.sensor.bayer is not None and (pixels[0] % 2 or pixels[1] % 2):
        raise InputError(f"pixels is {pixels}; expected even numbers for a camera with a mosaic")

    def change(frames: Frames, moment: Moment) -> Frames:
        del moment
        rows, columns = (
            np.clip(np.arange(extent) - by, 0, extent - 1)
            for extent, by in zip(frames.shape[1:3], pixels, strict=True)
        )
        return frames[:, rows][:, :, columns]

    return FaultyCamera(camera, change, after)


class MisreadMosaic(FaultyCamera):
    """A camera whose `sensor` states a wrong order of the colour mosaic.

    Parameters
    ----------
    camera : Camera
    order : {"RGGB", "GRBG", "GBRG", "BGGR"}
        Order that the sensor states.
    """

    def __init__(self, camera: Camera, order: str) -> None:
        super().__init__(camera, lambda frames, _: frames)
        self.sensor = replace(_counts_of(camera), bayer=order)


def mirrored(projector: Projector, after: int = 0) -> FaultyProjector:
    """Return a projector whose picture is mirrored left to right, by its cable or its menu."""
    return FaultyProjector(projector, lambda picture: picture[:, ::-1], after)


def half_dark(projector: Projector, after: int = 0) -> FaultyProjector:
    """Return a projector that lights the left half of its picture and nothing else."""

    def change(picture: Float) -> Float:
        columns = np.arange(picture.shape[1])
        return np.where(columns < picture.shape[1] // 2, picture, np.float32(0))

    return FaultyProjector(projector, change, after)


def _counts_of(camera: Camera) -> CameraModel:
    """Return the sensor of a camera that gives counts, or raise InputError."""
    if not isinstance(camera.sensor, CameraModel):
        raise InputError(f"the camera's sensor is {camera.sensor}; this fault needs a CameraModel")
    return camera.sensor


def _scaled(frames: Frames, camera: Camera, gain: Any) -> Frames:
    """Return frames (E, ...) with their light multiplied by a gain, one number or one per frame."""
    sensor = _counts_of(camera)
    black = np.float64(sensor.black_level_counts)
    factor = _per_frame(gain, frames) ** (1 / sensor.response_gamma)
    is_saturated = frames >= SATURATION_FRACTION * sensor.white_level
    changed = np.where(is_saturated, frames, black + factor * (frames - black))
    return _counts(changed, sensor)


def _per_frame(values: Any, frames: Frames) -> NDArray[np.float64]:
    """Return numbers per frame as an array that broadcasts with the frames."""
    numbers = np.broadcast_to(np.asarray(values, np.float64), len(frames))
    return numbers.reshape(-1, *(1,) * (frames.ndim - 1))


def _counts(values: NDArray[np.float64], sensor: CameraModel) -> Frames:
    return np.clip(np.rint(values), 0, sensor.white_level).astype(sensor.frame_dtype)
