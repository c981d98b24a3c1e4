"""Protocols of projectors and cameras, the devices of a real rig."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Annotated, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.array_types import Codes, Float
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.base import check_weights

Offset = Annotated[int, Field(ge=0, le=32768)]
PictureExtent = Annotated[int, Field(ge=1, le=32768)]
"""Types of settings: position and extent of a picture in pixels."""

ATTEMPTS = 5
"""Largest number of times that a picture is shown for one undisturbed bracket."""

WEIGHT_STEPS = 65535
"""Number of steps to which weights are rounded before they are looked up."""

_log = logging.getLogger(__name__)


class Projector(Protocol):
    """A display; see `rfpipe.testing.ProjectorContract`.

    A projector may have optional members:

    - ``undisturbed() -> bool``: whether the picture was displayed without interruption since
      `show`. If not, for example after a loose cable or behind another window, the pattern is shown
      and captured again.
    - ``show_now(picture)``: as `show`, but returns before the light has settled, so that the
      calibration can measure the delay; and ``settle_seconds``, the time that `show` waits for it.
    - ``show_colour(picture)``: as `show`, for weights (H, W, 3) of red, green and blue light, with
      which the calibration measures the order of the colours in a camera's mosaic.
    - the members of `SequenceProjector`: hardware sequences.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""

    def show(self, picture: Float) -> None:
        """Show a picture until the next one; return when its light has settled.

        Parameters
        ----------
        picture : ndarray of float32, shape (H, W)
            Weights in [0, 1] in linear light; 1 is the full light of a pixel. It is not modified.

        Raises
        ------
        InputError
            When shape or weights are wrong.
        CaptureError
            When the display fails or is closed.
        """

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: everything that affects the light."""

    def close(self) -> None:
        """Release the display; further calls have no effect."""


class SequenceProjector(Projector, Protocol):
    """A projector that shows a list of pictures by its own clock, and triggers a camera at each.

    The optional attribute ``sequence_levels = 2`` states that its sequences are binary.
    """

    @property
    def sequence_pictures(self) -> int:
        """Largest number of pictures in a sequence; 0 where its settings allow none."""

    def load(self, pictures: Iterable[Float]) -> None:
        """Load pictures (H, W), weights in [0, 1], in place of the previous ones.

        InputError when one has the wrong shape, or a weight that a sequence can't show.
        """

    def play(self, order: Sequence[int], seconds: float) -> None:
        """Show loaded pictures in this order, each for `seconds`, and trigger the camera at each.

        Returns after the last picture.
        """


class Camera(Protocol):
    """A camera; see `rfpipe.testing.CameraContract`."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frames in pixels."""

    @property
    def channels(self) -> int:
        """Colour channels of merged images: 1 for a grey sensor, 3 for a colour mosaic."""

    @property
    def sensor(self) -> Sensor:
        """The sensor, which merges what `expose` returns."""

    def expose(self) -> NDArray[Any]:
        """Expose a bracket of the current scene, shape ``sensor.frame_shape(shape, channels)``.

        CaptureError when it fails in spite of the driver's retries, or is closed.
        """

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: everything that affects a frame."""

    def close(self) -> None:
        """Release the camera; further calls have no effect."""


class SequenceCamera(Camera, Protocol):
    """A camera that takes a frame at each trigger of a projector."""

    @property
    def can_be_triggered(self) -> bool:
        """True if its settings enable triggers."""

    def seconds_between(self, exposure: float) -> float:
        """Shortest time between two triggers at an exposure time, in seconds."""

    def arm(self, exposure: float, count: int) -> None:
        """Wait for `count` triggers, each for a frame of `exposure` seconds."""

    def collect(self) -> NDArray[Any]:
        """Return the frames since `arm` in their order, (n, *sensor.frame_shape(...)[1:]).

        n is less than the number of triggers if the camera missed some.
        """


class Closing:
    """Base of classes with a `close` method, which a with statement calls at its end."""

    def close(self) -> None:
        """Release all resources; further calls have no effect."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def bracket_of(projector: Projector, camera: Camera, picture: Float, name: str) -> NDArray[Any]:
    """Show a picture and capture its bracket; see `shown_bracket`."""
    return shown_bracket(partial(projector.show, picture), projector, camera, name)


def shown_bracket(
    show: Callable[[], None], projector: Projector, camera: Camera, name: str
) -> NDArray[Any]:
    """Call `show`, and capture a bracket, shape (E, H, W[, C]).

    Raises
    ------
    CaptureError
        When a device fails, the picture is disturbed in `ATTEMPTS` brackets, or frames have the
        wrong shape or dtype. The message begins with `name`.
    """
    try:
        for _ in range(ATTEMPTS):
            show()
            frames = np.asarray(camera.expose())
            if undisturbed(projector):
                expected = camera.sensor.frame_shape(camera.shape, camera.channels)
                return check_frame_shape(frames, expected, camera.sensor.frame_dtype)
            _log.warning(
                "%s: the projector's picture was lost or hidden during the exposure; repeating it",
                name,
            )
        raise CaptureError(
            f"the projector's picture was lost or hidden during {ATTEMPTS} exposures",
            remedy="Check the projector's cable, and keep other windows and notifications off "
            "its monitor",
        )
    except CaptureError as error:
        raise CaptureError(f"{name}: {error.problem}", remedy=error.remedy) from error


def check_frame_shape(
    frames: NDArray[Any], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> NDArray[Any]:
    """Return frames; CaptureError if their shape or dtype is wrong."""
    if frames.shape != shape or frames.dtype != dtype:
        raise CaptureError(
            f"the camera returned {frames.dtype} frames of shape {frames.shape}; expected {dtype} "
            f"{shape}",
            remedy="Check the camera's size, pixel format and exposures",
        )
    return frames


def undisturbed(projector: Projector) -> bool:
    """Test whether the picture was displayed without interruption, if the projector knows it."""
    test = getattr(projector, "undisturbed", None)
    return test is None or bool(test())


def check_picture(picture: NDArray[Any], shape: tuple[int, ...]) -> Float:
    """Convert a picture to float32; InputError if the projector can't show it."""
    picture = np.asarray(picture)
    if picture.shape != shape:
        raise InputError(f"the picture has the shape {picture.shape}; this projector needs {shape}")
    return check_weights(picture[None], "the picture", ["the picture"]).reshape(shape)


def code_table(light: NDArray[Any] | None) -> Codes:
    """Invert a projector's response: code of each of `WEIGHT_STEPS` + 1 weights from 0 to 1, uint8.

    The code is chosen whose light, scaled to 0 for code 0 and 1 for code 255, is nearest.

    Parameters
    ----------
    light : ndarray, shape (256,), or None
        Light of each code, monotone; None: light is proportional to the code.

    Raises
    ------
    InputError
        When the response is not monotone or not finite.
    """
    measured = np.arange(256.0) if light is None else np.asarray(light, np.float64)
    is_rising = measured.shape == (256,) and (np.diff(measured) >= 0).all()
    if not is_rising or not 0 < measured[-1] - measured[0] < np.inf:
        raise InputError(
            "projector response: the light of the codes 0 to 255 is not finite, or decreases; "
            "expected 256 non-decreasing numbers, the last above the first",
            remedy="Measure it again, with the lamp warm",
        )
    relative = (measured - measured[0]) / (measured[-1] - measured[0])
    between = (relative[1:] + relative[:-1]) / 2
    weights = np.arange(WEIGHT_STEPS + 1) / WEIGHT_STEPS
    return np.searchsorted(between, weights).astype(np.uint8)
