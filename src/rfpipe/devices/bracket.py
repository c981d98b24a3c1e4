"""What every camera that takes its brackets frame by frame does alike: retries, a lost device."""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.config.base import Settings
from rfpipe.errors import CaptureError, installing
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.devices import Closing, Offset, PictureExtent

Counts = NDArray[np.uint16]

_log = logging.getLogger(__name__)


class FrameOptions(Settings):
    """What cameras have in common."""

    without_effect_on_frames: ClassVar[frozenset[str]] = frozenset({"timeout_seconds"})

    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None, description="Height and width of the frames in pixels, or null for the whole sensor."
    )
    offset: tuple[Offset, Offset] = Field(
        (0, 0),
        description="Place of the frames on the sensor: rows from its upper edge, columns from "
        "its left edge; of a photo camera even numbers both.",
    )
    timeout_seconds: float = Field(
        2.0,
        gt=0,
        le=600,
        description="Seconds until a frame counts as lost, beyond its exposure time; above 0, at "
        "most 600.",
    )


class BracketCamera(Closing, ABC):
    """A camera that exposes a bracket frame by frame; a driver adds how one frame is taken.

    A frame that fails or doesn't come in time is taken again; a camera that is lost is looked for,
    set up and asked again. What arrives late is dropped, never taken for the next exposure.

    Attributes
    ----------
    Options : type
        The driver's settings.
    kind : str
        The driver's name in descriptions.
    attempts, reconnect_seconds : int, float
        Times that a frame is taken, and the wait before a lost camera is looked for.
    channels : int
        Of a frame: 1 of a grey camera and under a mosaic, or 3.
    statistics : dict of str to int
        ``frames`` taken; ``failed``: frames that came damaged; ``timed_out``: that didn't come;
        ``reconnected``: times that the camera was lost and found.
    advice : str
        What to look at when frames keep failing.
    faults : tuple of exception types
        What the driver's library raises where the camera is lost.
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
            self._drop()

    @abstractmethod
    def _open(self) -> tuple[int, int]:
        """Find the camera, set it up and start it; return the frames' shape, or CaptureError."""

    @abstractmethod
    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        """Take one frame; return it, or None and the problem: ``""`` where none came in time."""

    @abstractmethod
    def _release(self, handle: Any) -> None:
        """Let go of the device, whatever state it is in."""

    def _restart(self) -> None:
        """Start afresh, so that a frame that comes late is not taken for the next one."""
        self._drop()

    def _is_lost(self) -> bool:
        """Tell whether there is no camera at hand."""
        return self._handle is None

    def _drop(self) -> None:
        handle, self._handle = self._handle, None
        if handle is not None:
            self._release(handle)

    def _said(self, error: Exception) -> str:
        """Return the text of the library's error."""
        return str(error).strip().rstrip(".")

    def _before_trigger(self, exposure: float) -> None:
        """Is called before each trigger; a real camera needs nothing more."""

    def _check_open(self) -> None:
        """Find a lost camera again, or raise CaptureError."""
        if self._closed:
            raise CaptureError("the camera is closed; open it anew")
        for attempt in range(self.attempts):
            if not self._is_lost():
                return
            self._drop()
            time.sleep(self.reconnect_seconds)
            try:
                shape = self._open()
            except CaptureError as error:
                _log.warning("attempt %d of %d: %s", attempt + 1, self.attempts, error)
                problem = error
                continue
            if shape != self.shape:
                raise CaptureError(
                    f"{self._name}: has {shape} pixels since it came back, {self.shape} before"
                )
            self.statistics["reconnected"] += 1
            _log.warning("%s is back", self._name)
            return
        raise CaptureError(
            f"{self._name} was lost and not found again in {self.attempts} attempts; the last: "
            f"{problem}. Check its power, cable and network, and that no other program took it"
        )

    def _exposure(self, exposure: float) -> Counts:
        """Take one frame, again where it fails."""
        for attempt in range(self.attempts):
            self._check_open()
            try:
                frame, problem = self._frame(exposure)
                if frame is not None:
                    if frame.shape[:2] == self.shape:
                        self.statistics["frames"] += 1
                        return frame
                    problem = f"the frame has {frame.shape[:2]} pixels, expected {self.shape}"
                self.statistics["failed" if problem else "timed_out"] += 1
                problem = problem or "no frame came in time"
                self._restart()
            except self.faults as error:
                problem = self._said(error)
                self._drop()
            _log.warning(
                "%s, exposure %g s, attempt %d of %d: %s",
                self._name, exposure, attempt + 1, self.attempts, problem,
            )  # fmt: skip
        raise CaptureError(
            f"{self._name}: no good frame of {exposure:g} s in {self.attempts} attempts; "
            f"the last: {problem}. {self.advice}, or raise camera.options.timeout_seconds"
        )


def load_library(module: str, extra: str) -> Any:
    """Import a driver's library, or raise CaptureError that names the extra of rfpipe with it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise CaptureError(
            f"{module} can't be loaded: {error}. To install it, {installing(extra)}"
        ) from error
