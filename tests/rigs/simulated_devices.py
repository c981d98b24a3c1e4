"""A simulated projector and a simulated camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.devices import check_picture


class SimulatedProjector:
    """A projector whose light is known exactly.

    Parameters
    ----------
    shape : (int, int)
        Height and width in pixels.

    Attributes
    ----------
    light : ndarray of float32, shape `shape`, or (*shape, 3) of a coloured picture
        Light that the projector shows now; initially black.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self.light: Float = np.zeros(shape, np.float32)
        self._closed = False

    def show(self, picture: Float) -> None:
        """Show a picture; see `rfpipe.rigs.devices.Projector.show`."""
        picture = check_picture(picture, self.shape)
        if self._closed:
            raise CaptureError("the simulated projector is closed")
        self.light = picture.copy()

    def show_colour(self, picture: Float) -> None:
        """Show weights (H, W, 3) of red, green and blue."""
        self.light = check_picture(picture, (*self.shape, 3)).copy()

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return {"kind": "simulated", "shape": list(self.shape)}

    def close(self) -> None:
        """Close the device; further use raises CaptureError."""
        self._closed = True


class SimulatedCamera:
    """A camera whose radiance is computed by a function.

    Parameters
    ----------
    radiance : callable
        Function that returns the current radiance, shape (*shape, C).
    shape : (int, int)
        Height and width in pixels.
    channels : int
        1 or 3.
    sensor : CameraModel
    seed : int
        Seed of the noise, which differs from bracket to bracket.
    """

    def __init__(
        self,
        radiance: Callable[[], NDArray[Any]],
        shape: tuple[int, int],
        channels: int,
        sensor: CameraModel,
        seed: int = 0,
    ) -> None:
        self.shape = shape
        self.channels = channels
        self.sensor = sensor
        self._radiance = radiance
        self._seed = seed
        self._brackets = 0
        self._closed = False

    def expose(self) -> NDArray[np.uint16]:
        """Take one bracket; see `rfpipe.rigs.devices.Camera.expose`."""
        if self._closed:
            raise CaptureError("the simulated camera is closed")
        self._brackets += 1
        return self.sensor.expose(self._radiance(), self._seed, (self._brackets,))

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return {
            "kind": "simulated",
            "shape": list(self.shape),
            "channels": self.channels,
            "seed": self._seed,
        }

    def close(self) -> None:
        """Close the device; further use raises CaptureError."""
        self._closed = True
