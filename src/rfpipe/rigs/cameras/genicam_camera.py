"""What cameras of the GenICam standard do alike, through whatever library."""

from __future__ import annotations

import logging
from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.cameras.bracket import BracketCamera
from rfpipe.rigs.cameras.collector import Collector
from rfpipe.rigs.cameras.genicam import (
    SOFTWARE,
    CameraSetup,
    Nodes,
    frame_rate,
    seconds_between,
)
from rfpipe.rigs.cameras.options import GenicamOptions

__all__ = ["GenicamCamera"]

Counts = NDArray[np.uint16]

_log = logging.getLogger(__name__)


class GenicamCamera(BracketCamera):
    """A camera that takes brackets by software trigger, and sequences by a projector's.

    Parameters
    ----------
    sensor : CameraModel
    options : GenicamOptions
        ``sequence_line`` is the input of the projector's triggers; without it there are none.
    """

    kind: ClassVar[str]

    def __init__(self, sensor: CameraModel, options: GenicamOptions) -> None:
        super().__init__(sensor, 1 if sensor.bayer is None else 3, options)
        self._options = options
        self._setup = CameraSetup(sensor, options)
        self._serial = options.serial
        self._model = ""
        self._collector: Collector | None = None

    @property
    @abstractmethod
    def nodes(self) -> Nodes:
        """The open camera's settings."""

    @property
    def can_be_triggered(self) -> bool:
        """Whether a projector triggers it; see `rfpipe.rigs.sequences.SequenceCamera`."""
        return self._options.sequence_line is not None

    def seconds_between(self, exposure: float) -> float:
        """Return the least time between two triggers; as `SequenceCamera` has it."""
        return seconds_between(exposure, frame_rate(self.nodes))

    def arm(self, exposure: float, count: int) -> None:
        """Wait for triggers by the projector; as `SequenceCamera` has it.

        Raises
        ------
        CaptureError
            When the camera is lost, or refuses the line.
        """
        with self._lock:
            if self._closed:
                raise CaptureError("the camera is closed; open it anew")
            self._disarm()
            try:
                if self._is_lost():
                    self._reconnect("it was disconnected")
                self._stop()
                self._setup.set_exposure(self.nodes, exposure)
                self._setup.set_trigger(self.nodes, str(self._options.sequence_line))
                self._start()
            except CaptureError:  # it is there, and refuses
                self._by_software()
                raise
            except self.faults as error:
                self._drop()
                raise CaptureError(f"{self._name}: {self._said(error)}") from error
            patience = exposure + self._options.timeout_seconds
            self._collector = Collector(self._next, self._expect, self.faults, count, patience)

    def collect(self) -> Counts:
        """Return the frames since `arm`; as `SequenceCamera` has it."""
        with self._lock:
            collector, self._collector = self._collector, None
            if collector is None:
                raise CaptureError(f"{self._name}: isn't armed")
            frames, failed = collector.finish()
            self.statistics["frames"] += len(frames)
            self.statistics["failed"] += failed
            self.statistics["timed_out"] += collector.count - len(frames) - failed
            self._by_software()
        item = self.sensor.frame_shape(self.shape, self.channels)[1:]
        good = [frame.reshape(item) for frame in frames if frame.shape == self.shape]
        return np.stack(good) if good else np.zeros((0, *item), np.uint16)

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        with self._lock:
            self._disarm()  # or frames would be fetched of a camera that isn't there
        super().close()

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return {
            "kind": self.kind,
            "model": self._model,
            "serial": self._serial,
            "shape": list(self.shape),
            **self._setup.describe(),
        }

    @abstractmethod
    def _start(self) -> None:
        """Have the camera take a frame at each trigger."""

    @abstractmethod
    def _stop(self) -> None:
        """Have it take none, and drop those that are on their way."""

    @abstractmethod
    def _next(self, seconds: float) -> tuple[Counts | None, str]:
        """Return the next frame, or None and what is wrong: ``""`` where none came in time."""

    def _expect(self) -> None:
        """Make room for one more frame, where the library has none of its own."""

    def _restart(self) -> None:
        self._stop()
        self._start()

    def _awaited(self, seconds: float) -> tuple[Counts | None, str]:
        """Return the frame that was triggered, or None and what is wrong."""
        frame, problem = self._next(seconds)
        if problem:
            return self._failed(problem)
        if frame is None:
            return self._timed_out(f"no frame within {1000 * seconds:.0f} ms")
        if frame.shape != self.shape:
            return self._failed(f"the frame has {frame.shape} pixels, expected {self.shape}")
        return frame, ""

    def _disarm(self) -> None:
        """Stop fetching frames of a sequence that nobody collects."""
        collector, self._collector = self._collector, None
        if collector is not None:
            collector.finish(wait=False)

    def _by_software(self) -> None:
        """Go back to triggers by this program; a camera that can't is looked for at the next."""
        if self._is_lost():
            return
        wrong: tuple[type[Exception], ...] = (CaptureError, *self.faults)
        try:
            self._stop()
            self._setup.set_trigger(self.nodes, SOFTWARE)
            self._start()
        except wrong as error:
            self._drop()
            _log.warning("%s: %s", self._name, self._said(error))
