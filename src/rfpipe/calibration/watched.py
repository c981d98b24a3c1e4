"""Watching a step of a calibration: its pictures are counted, and whether a device failed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry import Sensor
from rfpipe.rigs.devices import Camera, Projector

__all__ = ["Counts", "Progress", "WatchedCamera", "WatchedProjector"]


class Counts(Protocol):
    """Something that counts what is done."""

    def advance(self, patterns: int) -> None:
        """Count so many more."""


Progress = Callable[[str, int], AbstractContextManager[Counts]]
"""Makes one for a name and a total, such as `rfpipe.stages.jobs.progress.Progress`."""


class WatchedProjector:
    """A projector whose pictures are counted; everything else is the projector's own.

    Parameters
    ----------
    projector : Projector
    counts : Counts or None

    Attributes
    ----------
    failed : bool
        Whether it raised.
    """

    def __init__(self, projector: Projector, counts: Counts | None) -> None:
        self._projector = projector
        self._counts = counts
        self.failed = False

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self._projector.shape

    def show(self, picture: NDArray[np.float32]) -> None:
        """Show a picture, and count it."""
        self.failed = True  # until it has not
        self._projector.show(picture)
        self.failed = False
        if self._counts is not None:
            self._counts.advance(1)

    def __getattr__(self, name: str) -> Any:
        """Return what else the projector has, such as `undisturbed`."""
        return getattr(self._projector, name)

    def describe(self) -> dict[str, Any]:
        """Describe the projector."""
        return self._projector.describe()

    def close(self) -> None:
        """Give the display back."""
        self._projector.close()


class WatchedCamera:
    """A camera of which is known whether it failed; everything else is the camera's own.

    Parameters
    ----------
    camera : Camera

    Attributes
    ----------
    failed : bool
        Whether it raised.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self.failed = False
        self.shape, self.channels = camera.shape, camera.channels

    @property
    def sensor(self) -> Sensor:
        """The sensor, which merges what `expose` returns."""
        return self._camera.sensor

    def expose(self) -> NDArray[Any]:
        """Take one bracket."""
        self.failed = True  # until it has not
        frames = self._camera.expose()
        self.failed = False
        return frames

    def describe(self) -> dict[str, Any]:
        """Describe the camera."""
        return self._camera.describe()

    def close(self) -> None:
        """Give the camera back."""
        self._camera.close()
