"""Protocol of sensors, which convert light to frames and frames to radiance; exact sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import CaptureError
from rfpipe.units import RADIANCE, picture_name

_NEGATIVE_TOLERANCE = 1e-3
# Negative light up to this fraction of the image's maximum is attributed to rounding in a
# compressed operator and set to zero; a larger one is an error of the operator.


@dataclass(frozen=True)
class MergedImages:
    """Radiance images merged from brackets.

    Parameters
    ----------
    radiance, variance : ndarray of float32, shape (B, *camera_shape, C)
        In units of the transport matrix; finite. Radiance may be negative due to noise. The
        variance of exact radiance is 0.
    saturated : int
        Number of samples of the batch (photosites under a mosaic, else pixels times channels) that
        were saturated in every exposure. Their radiance is a lower bound, with a standard deviation
        of `rfpipe.photometry.camera.UNKNOWN_DEVIATION` of full scale.
    """

    radiance: Float
    variance: Float
    saturated: int


class BracketMerge(Protocol):
    """Merge of brackets for given all-off frames; thread-safe."""

    def __call__(self, frames: NDArray[Any], first_index: int = 0) -> MergedImages:
        """Merge brackets (B, E, ...); `first_index` is the number of the first pattern.

        CaptureError if a frame is impossible for this sensor.
        """


class Sensor(Protocol):
    """A camera's sensor: converts radiance to frames, and frames to radiance."""

    @property
    def exposures(self) -> tuple[float, ...]:
        """Exposure times of a bracket in seconds, ascending; their number is E."""

    @property
    def frame_dtype(self) -> np.dtype[Any]:
        """Dtype of frames: uint16 counts or float32 radiance."""

    @property
    def bayer(self) -> str | None:
        """Colour mosaic of the frames, such as "RGGB"; None without one."""
        return None

    @property
    def black_level_counts(self) -> float:
        """Value of a frame without light."""
        return 0.0

    @property
    def white_level(self) -> float:
        """Value of a frame at full scale, where the sensor saturates; infinity without limit."""
        return np.inf

    def frame_shape(self, camera_shape: tuple[int, ...], channels: int) -> tuple[int, ...]:
        """Shape of one bracket: (E, *camera_shape, C), or (E, *camera_shape) under a mosaic."""

    def expose(self, radiance: NDArray[Any], seed: int, key: tuple[int, ...]) -> NDArray[Any]:
        """Simulate one bracket of a radiance image (*camera_shape, C).

        The noise depends on seed, key and exposure only. CaptureError if the radiance is negative
        or not finite.
        """

    def merge(
        self, frames: NDArray[Any], black: NDArray[Any], black_count: int = 1
    ) -> MergedImages:
        """Merge brackets (B, E, ...), given the mean of `black_count` all-off brackets (E, ...).

        The variance includes the noise of this mean. CaptureError, with pattern and pixel, if a
        frame is impossible for this sensor.
        """
        return self.bracket_merge(black, black_count)(frames)

    def bracket_merge(self, black: NDArray[Any], black_count: int = 1) -> BracketMerge:
        """Prepare `merge` for many brackets with the same `black`.

        CaptureError if `black` is impossible for this sensor.
        """

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: everything that affects a frame."""

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays that restore the sensor together with `describe`; empty if it needs none."""
        return {}


@dataclass(frozen=True)
class ExactSensor(Sensor):
    """A sensor without noise or limits: one exposure of 1 s, whose frame is the radiance."""

    @property
    def exposures(self) -> tuple[float, ...]:
        """The only exposure, 1 s."""
        return (1.0,)

    @property
    def frame_dtype(self) -> np.dtype[Any]:
        """Frames are float32 radiance."""
        return np.dtype(RADIANCE)

    def frame_shape(self, camera_shape: tuple[int, ...], channels: int) -> tuple[int, ...]:
        """Shape of one bracket, (1, *camera_shape, C)."""
        return (1, *camera_shape, channels)

    def expose(self, radiance: NDArray[Any], seed: int, key: tuple[int, ...]) -> Float:  # noqa: ARG002
        """Return the radiance as the only frame of a bracket, float32 (1, *camera_shape, C)."""
        return check_light(radiance, key)[None]

    def bracket_merge(self, black: NDArray[Any], black_count: int = 1) -> BracketMerge:  # noqa: ARG002
        """Prepare a merge that subtracts the all-off frame; the variance is zero."""
        check_black(np.asarray(black), 1)
        return partial(_subtracted, np.asarray(black))

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return {"kind": "exact"}


def _subtracted(black: NDArray[Any], frames: NDArray[Any], first_index: int = 0) -> MergedImages:
    """Merge brackets of one exact exposure."""
    frames = np.asarray(frames)
    check_shape(frames, black.shape, first_index)
    for index, frame in enumerate(frames, first_index):
        _check_values(frame, f"pattern {index}")
    radiance = np.subtract(frames[:, 0], black[0], dtype=RADIANCE)
    return MergedImages(radiance, np.zeros_like(radiance), 0)


def check_frames(frames: NDArray[Any], white_level: int, first_index: int) -> None:
    """Raise CaptureError unless the frames hold counts from 0 to `white_level`."""
    if frames.dtype.kind != "u":
        raise CaptureError(
            f"frames have dtype {frames.dtype}; this camera's frames are unsigned counts (uint16)"
        )
    if frames.size and int(frames.max()) > white_level:
        where = np.unravel_index(int(frames.argmax()), frames.shape)
        raise CaptureError(
            f"pattern {first_index + int(where[0])} holds {frames[where]} counts at "
            f"exposure {int(where[1])}, {place(where[2:])}; this camera's full scale is "
            f"{white_level}: check its bits"
        )


def check_black(black: NDArray[Any], exposures: int) -> None:
    """Raise CaptureError unless the all-off bracket (E, ...) is finite and has E exposures."""
    if black.ndim < 3 or len(black) != exposures:
        raise CaptureError(
            f"the all-off bracket has the shape {black.shape}; expected ({exposures} exposures, "
            "*camera_shape[, channels])"
        )
    if not np.isfinite(black).all():
        raise CaptureError("the all-off frames hold NaN or infinity", remedy="take them again")


def check_shape(frames: NDArray[Any], bracket: tuple[int, ...], first_index: int) -> None:
    """Raise CaptureError unless the brackets (B, E, ...) have the shape of the all-off one."""
    if frames.shape[1:] != bracket:
        raise CaptureError(
            f"pattern {first_index}: brackets have the shape {frames.shape[1:]}, the "
            f"all-off one {bracket}; all must be of one camera and setting"
        )


def check_light(radiance: NDArray[Any], key: tuple[int, ...]) -> Float:
    """Return radiance as float32 without negative rounding, or raise CaptureError."""
    light = np.asarray(radiance, RADIANCE)
    largest = _check_values(light, picture_name(key), _NEGATIVE_TOLERANCE)
    return np.maximum(light, 0, dtype=RADIANCE) if largest else np.zeros_like(light)


def place(index: tuple[Any, ...]) -> str:
    """Name a pixel in an error message."""
    return f"pixel {tuple(int(i) for i in index)}"


def _check_values(image: NDArray[Any], name: str, tolerance: float = 0.0) -> float:
    """Return the maximum of an image of finite values, none negative beyond `tolerance` of it."""
    if not image.size:
        raise CaptureError(f"{name}: the picture is empty, shape {image.shape}")
    least, largest = float(image.min()), float(image.max())
    if np.isfinite(least) and np.isfinite(largest) and least >= -tolerance * largest:
        return largest
    bad = ~np.isfinite(image) if not np.isfinite(image).all() else image < -tolerance * largest
    where = tuple(np.argwhere(bad)[0])
    raise CaptureError(
        f"{name} holds {image[where]} at {place(where)} (and {np.count_nonzero(bad) - 1} more "
        "such values); light is finite and not negative: check the rig or the operator behind it"
    )
