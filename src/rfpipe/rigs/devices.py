"""The two halves of a real rig: what a projector and a camera must do."""

from __future__ import annotations

from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.sensor import Sensor
from rfpipe.weights import as_weights

__all__ = ["Camera", "Closing", "Projector", "bracket_of", "check_picture"]

Float = NDArray[np.float32]


class Projector(Protocol):
    """One display; see `rfpipe.testing.ProjectorContract`."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""

    def show(self, picture: Float) -> None:
        """Show a picture until the next one; return when it is on display and settled.

        Parameters
        ----------
        picture : ndarray of float32, shape (H, W)
            Weights in [0, 1] in linear light: 1 is all light that a pixel gives. Is not kept.

        Raises
        ------
        InputError
            When the picture has the wrong shape or a weight outside [0, 1].
        CaptureError
            When the display fails or is closed.
        """

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the light."""

    def close(self) -> None:
        """Give the display back; closing twice is no error."""


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
        """Take one bracket of what is before the camera now.

        Returns
        -------
        ndarray, shape sensor.frame_shape(shape, channels), sensor.frame_dtype

        Raises
        ------
        CaptureError
            When the camera fails, still after the retries that its driver makes, or is closed.
        """

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""


class Closing:
    """What a with statement closes in the end."""

    def close(self) -> None:
        """Give back what it holds; closing twice is no error."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def bracket_of(projector: Projector, camera: Camera, picture: Float, name: str) -> NDArray[Any]:
    """Show a picture and return its bracket, shape (E, H, W[, C]).

    Raises
    ------
    CaptureError
        When a device fails, or the camera returns what is no bracket of its own; begins with the
        picture's name.
    """
    try:
        projector.show(picture)
        frames = np.asarray(camera.expose())
    except CaptureError as error:
        raise CaptureError(f"{name}: {error}") from error
    dtype = camera.sensor.frame_dtype
    expected = camera.sensor.frame_shape(camera.shape, camera.channels)
    if frames.shape != expected or frames.dtype != dtype:
        raise CaptureError(
            f"{name}: the camera returned {frames.dtype} frames of shape {frames.shape}; expected "
            f"{dtype} {expected}. Check the camera's size, pixel format and exposures"
        )
    return frames


def check_picture(picture: NDArray[Any], shape: tuple[int, int]) -> Float:
    """Return a picture as float32, or raise InputError where a projector can't show it."""
    picture = np.asarray(picture)
    if picture.shape != shape:
        raise InputError(f"the picture has the shape {picture.shape}; this projector shows {shape}")
    picture = as_weights(picture, "the picture")
    least, largest = (float(picture.min()), float(picture.max())) if picture.size else (0.0, 0.0)
    if not (least >= 0 and largest <= 1):  # NaN is neither
        where = tuple(int(i) for i in np.argwhere(~((picture >= 0) & (picture <= 1)))[0])
        raise InputError(
            f"the picture is {picture[where]} at projector pixel {where}; a projector shows "
            "weights from 0 to 1"
        )
    return np.asarray(picture, np.float32)
