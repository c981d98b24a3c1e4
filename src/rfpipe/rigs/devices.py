"""The two halves of a real rig: what a projector and a camera must do."""

from __future__ import annotations

import logging
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.sensor import Sensor
from rfpipe.weights import as_weights

__all__ = ["Camera", "Closing", "Projector", "bracket_of", "check_picture", "undisturbed"]

Float = NDArray[np.float32]

TIMES_SHOWN = 5
"""How often a picture is shown until it stands for a whole bracket."""

_log = logging.getLogger(__name__)


class Projector(Protocol):
    """One display; see `rfpipe.testing.ProjectorContract`.

    A projector may also have, and is then asked for it,

    - ``undisturbed() -> bool``: whether the last picture stood from `show` until now. Where it
      didn't, as when a cable flickered or a window hid it, the pattern is shown and taken again.
    - ``show_now(picture)``: as `show`, but returns before the light has settled, which the
      calibration then measures; and ``settle_seconds``, what `show` waits for it.
    - what `rfpipe.rigs.sequences.SequenceProjector` has: sequences of patterns in hardware.
    """

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
        When a device fails, the picture doesn't stand for a whole bracket, or the camera returns
        what is no bracket of its own; begins with the picture's name.
    """
    try:
        frames = _standing_bracket(projector, camera, picture, name)
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


def undisturbed(projector: Projector) -> bool:
    """Whether a projector's last picture stood from `show` until now, as far as it can tell."""
    asked = getattr(projector, "undisturbed", None)
    return asked is None or bool(asked())


def _standing_bracket(
    projector: Projector, camera: Camera, picture: Float, name: str
) -> NDArray[Any]:
    """Show a picture and take its bracket, again where it didn't stand all the while."""
    for _ in range(TIMES_SHOWN):
        projector.show(picture)
        frames = np.asarray(camera.expose())
        if undisturbed(projector):
            return frames
        _log.warning(
            "%s: the projector's picture was lost or hidden while it was taken; taking it again",
            name,
        )
    raise CaptureError(
        f"the projector's picture was lost or hidden {TIMES_SHOWN} times while it was taken. "
        "Check the projector's cable, and keep other windows and notifications off its monitor"
    )


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
