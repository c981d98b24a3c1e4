"""The two halves of a real rig: protocols of projectors and cameras."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Annotated, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.base import check_weights

Float = NDArray[np.float32]
Codes = NDArray[np.uint8]

Offset = Annotated[int, Field(ge=0, le=32768)]
PictureExtent = Annotated[int, Field(ge=1, le=32768)]
"""Settings of where a picture lies among pixels, and of its extent."""

TIMES_SHOWN = 5
"""How often a picture is shown until it stands for a whole bracket."""

STEPS = 65535
"""Weights are rounded to multiples of 1 / STEPS before they are looked up."""

_log = logging.getLogger(__name__)


class Projector(Protocol):
    """One display; see `rfpipe.testing.ProjectorContract`.

    A projector may also have, and is then asked for it,

    - ``undisturbed() -> bool``: whether the last picture stood from `show` until now. Where it
      didn't, as when a cable flickered or a window hid it, the pattern is shown and taken again.
    - ``show_now(picture)``: as `show`, but returns before the light has settled, which the
      calibration then measures; and ``settle_seconds``, what `show` waits for it.
    - ``show_colour(picture)``: as `show`, of weights (H, W, 3) of red, green and blue light, by
      which the calibration finds the order of the colours in a camera's mosaic.
    - what `SequenceProjector` has: sequences of patterns in hardware.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""

    def show(self, picture: Float) -> None:
        """Show a picture until the next one; return when it is on display and settled.

        The picture, float32 (H, W), has weights in [0, 1] in linear light: 1 is all light that a
        pixel gives; it is not kept. InputError where its shape or a weight is another,
        CaptureError where the display fails or is closed.
        """

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the light."""

    def close(self) -> None:
        """Give the display back; closing twice is no error."""


class SequenceProjector(Projector, Protocol):
    """A projector that shows a list of pictures by its own clock, and triggers a camera at each.

    One whose sequences are of zeros and ones alone says so by ``sequence_levels = 2``.
    """

    @property
    def sequence_pictures(self) -> int:
        """The most pictures that it holds; 0 where it holds none as it is set up."""

    def load(self, pictures: Iterable[Float]) -> None:
        """Take pictures (H, W), weights in [0, 1], in the place of those before.

        InputError where one has the wrong shape, or a weight that a sequence can't show.
        """

    def play(self, order: Sequence[int], seconds: float) -> None:
        """Show loaded pictures in this order, each for so long, and trigger the camera at each.

        Returns when the last one was shown.
        """


class Camera(Protocol):
    """One camera; see `rfpipe.testing.CameraContract`."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frames in pixels."""

    @property
    def channels(self) -> int:
        """Colour channels of merged images: 1 of a grey sensor, 3 of one under a mosaic."""

    @property
    def sensor(self) -> Sensor:
        """The sensor, which merges what `expose` returns."""

    def expose(self) -> NDArray[Any]:
        """Return a bracket, sensor.frame_shape(shape, channels), of what is before the camera now.

        CaptureError where it fails, still after the retries that its driver makes, or is closed.
        """

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""


class SequenceCamera(Camera, Protocol):
    """A camera that takes a frame at each trigger of a projector."""

    @property
    def can_be_triggered(self) -> bool:
        """Whether it is set up for that."""

    def seconds_between(self, exposure: float) -> float:
        """Return the least time from one trigger to the next at an exposure time in seconds."""

    def arm(self, exposure: float, count: int) -> None:
        """Wait for `count` triggers from now on, each of a frame of `exposure` seconds."""

    def collect(self) -> NDArray[Any]:
        """Return the frames since `arm` as they came, (n, *sensor.frame_shape(...)[1:]).

        There may be fewer than were armed for, where triggers were missed.
        """


class Closing:
    """What a with statement closes in the end."""

    def close(self) -> None:
        """Give back what it holds; closing twice is no error."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def bracket_of(projector: Projector, camera: Camera, picture: Float, name: str) -> NDArray[Any]:
    """Show a picture and return its bracket; see `shown_bracket`."""
    return shown_bracket(partial(projector.show, picture), projector, camera, name)


def shown_bracket(
    show: Callable[[], None], projector: Projector, camera: Camera, name: str
) -> NDArray[Any]:
    """Return the bracket, shape (E, H, W[, C]), of a picture that `show` shows.

    Raises
    ------
    CaptureError
        When a device fails, the picture doesn't stand for a whole bracket, or the camera returns
        what is no bracket of its own; begins with the picture's name.
    """
    try:
        for _ in range(TIMES_SHOWN):
            show()
            frames = np.asarray(camera.expose())
            if undisturbed(projector):
                expected = camera.sensor.frame_shape(camera.shape, camera.channels)
                return check_frames(frames, expected, camera.sensor.frame_dtype)
            _log.warning(
                "%s: the projector's picture was lost or hidden while it was taken; taking it "
                "again", name,
            )  # fmt: skip
        raise CaptureError(
            f"the projector's picture was lost or hidden {TIMES_SHOWN} times while it was taken. "
            "Check the projector's cable, and keep other windows and notifications off its monitor"
        )
    except CaptureError as error:
        raise CaptureError(f"{name}: {error}") from error


def check_frames(
    frames: NDArray[Any], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> NDArray[Any]:
    """Return frames, or raise CaptureError where they have another shape or dtype."""
    if frames.shape != shape or frames.dtype != dtype:
        raise CaptureError(
            f"the camera returned {frames.dtype} frames of shape {frames.shape}; expected {dtype} "
            f"{shape}. Check the camera's size, pixel format and exposures"
        )
    return frames


def undisturbed(projector: Projector) -> bool:
    """Tell whether a projector's last picture stood from `show` until now, as far as it knows."""
    asked = getattr(projector, "undisturbed", None)
    return asked is None or bool(asked())


def check_picture(picture: NDArray[Any], shape: tuple[int, ...]) -> Float:
    """Return a picture as float32, or raise InputError where a projector can't show it."""
    picture = np.asarray(picture)
    if picture.shape != shape:
        raise InputError(f"the picture has the shape {picture.shape}; this projector shows {shape}")
    return check_weights(picture[None], "the picture", ["the picture"]).reshape(shape)


def code_table(light: NDArray[Any] | None) -> Codes:
    """Return the code for each of `STEPS` + 1 weights from 0 to 1, uint8.

    `light`, (256,) and never falling, was measured at each code; None where it is in proportion.
    The code of a weight is that whose light, scaled so that code 0 gives 0 and 255 gives 1, is
    nearest. InputError where the table is none.
    """
    measured = np.arange(256.0) if light is None else np.asarray(light, np.float64)
    is_rising = measured.shape == (256,) and (np.diff(measured) >= 0).all()
    if not is_rising or not 0 < measured[-1] - measured[0] < np.inf:
        raise InputError(
            "projector response: expected the light of the codes 0 to 255, finite numbers that "
            "never fall, the last above the first. Measure it again, with the lamp warm"
        )
    relative = (measured - measured[0]) / (measured[-1] - measured[0])
    between = (relative[1:] + relative[:-1]) / 2
    weights = np.arange(STEPS + 1) / STEPS
    return np.searchsorted(between, weights).astype(np.uint8)
