"""Base class of cameras that take a bracket frame by frame: retries and reconnection."""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from rfpipe.array_types import Counts
from rfpipe.config.base import Settings
from rfpipe.errors import CaptureError
from rfpipe.installation import needing
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.devices import Closing, Offset, PictureExtent

_log = logging.getLogger(__name__)


class RegionOptions(Settings):
    """Region of the sensor that a camera reads."""

    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None, description="Height and width of the frames in pixels, or null for the whole sensor."
    )
    offset: tuple[Offset, Offset] = Field(
        (0, 0),
        description="Place of the frames on the sensor: rows from its upper edge, columns from "
        "its left edge; of a photo camera even numbers both.",
    )


class FrameOptions(RegionOptions):
    """Options shared by the drivers of cameras that deliver frames in time or late."""

    without_effect_on_frames: ClassVar[frozenset[str]] = frozenset({"timeout_seconds"})

    timeout_seconds: float = Field(
        2.0,
        gt=0,
        le=600,
        description="Seconds after its exposure until a frame counts as lost.",
    )


class BracketCamera(Closing, ABC):
    """A camera that exposes a bracket frame by frame; a driver implements a single frame.

    A frame that fails or times out is taken again. A camera that is disconnected is opened and set
    up again. A frame that arrives late is dropped and never mistaken for the next exposure.

    Attributes
    ----------
    Options : type
        The driver's settings.
    kind : str
        The driver's name in descriptions.
    attempts, reconnect_seconds : int, float
        Attempts to take a frame, and the wait before a lost camera is opened again.
    channels : int
        Colour channels of a frame: 1 for a grey camera or one with a colour mosaic, else 3.
    statistics : dict of str to int
        ``frames`` taken, ``failed`` (damaged) and ``timed_out`` (missing) frames, and how often the
        camera was ``reconnected``.
    advice : str
        Remedy in the message when frames keep failing.
    faults : tuple of exception types
        Exceptions of the driver's library when the camera is lost.
    """

    Options: ClassVar[type[Settings]]
    kind: ClassVar[str]
    attempts: ClassVar[int] = 4
    reconnect_seconds: ClassVar[float] = 2.0
    advice: ClassVar[str] = "Check its cable and the load of its port (packet size, USB hub)"
    faults: tuple[type[Exception], ...] = ()

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        self._options: Any = self.Options(**options)
        self.sensor = sensor
        self.channels = 1
        self._handle: Any = None
        self.statistics = {"frames": 0, "failed": 0, "timed_out": 0, "reconnected": 0}
        self.shape = (0, 0)
        self._name = "camera"
        self._lock = threading.Lock()
        self._closed = False

    def expose(self) -> Counts:
        """Take one bracket; see `rfpipe.rigs.devices.Camera.expose`."""
        frames = np.empty(self.sensor.frame_shape(self.shape, self.channels), np.uint16)
        with self._lock:
            for index, exposure in enumerate(self.sensor.exposures):
                frames[index] = self._exposure(exposure).reshape(frames.shape[1:])
        return frames

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return {"kind": self.kind, "shape": list(self.shape)}

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        with self._lock:
            self._closed = True
            self._disconnect()

    @abstractmethod
    def _open(self) -> tuple[int, int]:
        """Find, set up and start the camera; return the frames' shape, or raise CaptureError."""

    @abstractmethod
    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        """Take one frame; return it, or None and the problem: ``""`` for a timeout."""

    @abstractmethod
    def _release(self, handle: Any) -> None:
        """Close the device, whatever its state."""

    def _restart(self) -> None:
        """Reset the camera, so that a late frame isn't mistaken for the next one."""
        self._disconnect()

    def _is_lost(self) -> bool:
        """Test whether the camera is disconnected."""
        return self._handle is None

    def _disconnect(self) -> None:
        """Close the device, if it is open."""
        handle, self._handle = self._handle, None
        if handle is not None:
            self._release(handle)

    def _error_text(self, error: Exception) -> str:
        """Return the message of an error of the library."""
        return str(error).strip().rstrip(".")

    def _before_trigger(self, exposure: float) -> None:
        """Prepare a trigger; called before each, for virtual cameras."""

    def _check_open(self) -> None:
        """Reconnect a lost camera, or raise CaptureError."""
        if self._closed:
            raise CaptureError("the camera is closed; open it again")
        for attempt in range(self.attempts):
            if not self._is_lost():
                return
            self._disconnect()
            time.sleep(self.reconnect_seconds)
            try:
                shape = self._open()
            except CaptureError as error:
                _log.warning("attempt %d of %d: %s", attempt + 1, self.attempts, error)
                problem = error
                continue
            if shape != self.shape:
                raise CaptureError(
                    f"{self._name}: has {shape} pixels after reconnecting, {self.shape} before"
                )
            self.statistics["reconnected"] += 1
            _log.warning("%s is reconnected", self._name)
            return
        raise CaptureError(
            f"{self._name} was lost and not reconnected in {self.attempts} attempts; last problem: "
            f"{problem}. Check its power, cable and network, and that no other program uses it"
        )

    def _exposure(self, exposure: float) -> Counts:
        """Take one frame, in up to `attempts` attempts."""
        for attempt in range(self.attempts):
            self._check_open()
            frame, problem = self._attempt(exposure)
            if frame is not None:
                self.statistics["frames"] += 1
                return frame
            _log.warning(
                "%s, exposure %g s, attempt %d of %d: %s",
                self._name, exposure, attempt + 1, self.attempts, problem,
            )  # fmt: skip
        has_timeout = isinstance(self._options, FrameOptions)
        patience = ", or raise camera.options.timeout_seconds" if has_timeout else ""
        raise CaptureError(
            f"{self._name}: no good frame of {exposure:g} s in {self.attempts} attempts; "
            f"last problem: {problem}. {self.advice}{patience}"
        )

    def _attempt(self, exposure: float) -> tuple[Counts | None, str]:
        """Take one frame once; return it, or None and the problem after resetting the camera."""
        try:
            frame, problem = self._frame(exposure)
            if frame is not None and frame.shape[:2] == self.shape:
                return frame, ""
            if frame is not None:
                problem = f"the frame has {frame.shape[:2]} pixels, expected {self.shape}"
            self.statistics["failed" if problem else "timed_out"] += 1
            self._restart()
        except self.faults as error:
            self._disconnect()
            return None, self._error_text(error)
        return None, problem or "no frame came in time"


def load_library(module: str, extra: str) -> Any:
    """Import a driver's library, or raise CaptureError that names the extra to install."""
    with needing(extra, module, CaptureError):
        return import_module(module)
