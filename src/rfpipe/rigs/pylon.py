"""Basler cameras, through their driver pylon."""

from __future__ import annotations

import logging
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.cameras.bracket import BracketCamera, chosen, options_of
from rfpipe.rigs.cameras.genicam import SOFTWARE, CameraSetup, RefusedError, seconds_between
from rfpipe.rigs.pylon_options import PylonOptions
from rfpipe.rigs.pylon_sequence import Collector
from rfpipe.rigs.pylon_setup import PylonNodes, load_pylon, said

__all__ = ["PylonCamera"]

Counts = NDArray[np.uint16]

_log = logging.getLogger(__name__)


class PylonCamera(BracketCamera):
    """A Basler camera that takes brackets by software trigger.

    All automatic functions are off and the gain is fixed. Failed frames and a lost camera are
    treated as every `BracketCamera` does.

    Parameters
    ----------
    sensor : CameraModel
        Exposures, bits and mosaic, which choose the pixel format, and what is known of the noise.
    options
        As `PylonOptions` has them, by name, the same where they aren't given; the pixel format is
        the sensor's.

    Raises
    ------
    CaptureError
        When pypylon is missing, no camera answers, or it refuses a setting: says which.
    """

    Options = PylonOptions
    bench = "rfpipe.rigs.bench:BenchCamera"

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        self._options = options_of(PylonOptions, options, "a Basler camera")
        super().__init__(sensor, 1 if sensor.bayer is None else 3, self._options)
        self._setup = CameraSetup(sensor, self._options)
        self._serial = self._options.serial
        self._model = ""
        self._pylon, self._genicam = load_pylon()
        self.faults = self._genicam.GenericException, RefusedError
        self._camera: Any = None
        self._collector: Collector | None = None
        self.shape = self._open()

    @property
    def can_be_triggered(self) -> bool:
        """Whether a projector triggers it; see `rfpipe.rigs.sequences.SequenceCamera`."""
        return self._options.sequence_line is not None

    def seconds_between(self, exposure: float) -> float:
        """Return the least time between two triggers; as `SequenceCamera` has it."""
        return seconds_between(exposure, PylonNodes(self._camera).frame_rate())

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
            try:
                if self._is_lost():
                    self._reconnect("it was disconnected")
                self._camera.StopGrabbing()
                nodes = PylonNodes(self._camera)
                self._setup.set_exposure(nodes, exposure)
                self._setup.set_trigger(nodes, str(self._options.sequence_line))
                self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
            except self._genicam.GenericException as error:
                self._drop()
                raise CaptureError(f"camera {self._serial}: {said(error)}") from error
            patience = exposure + self._options.timeout_seconds
            self._collector = Collector(self._camera, count, patience)

    def collect(self) -> Counts:
        """Return the frames since `arm`; as `SequenceCamera` has it."""
        with self._lock:
            collector, self._collector = self._collector, None
            if collector is None:
                raise CaptureError(f"camera {self._serial}: isn't armed")
            frames, failed = collector.finish()
            self.statistics["frames"] += len(frames)
            self.statistics["failed"] += failed
            self.statistics["timed_out"] += collector.count - len(frames) - failed
            try:
                self._camera.StopGrabbing()
                self._setup.set_trigger(PylonNodes(self._camera), SOFTWARE)
                self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
            except self._genicam.GenericException as error:
                self._drop()
                _log.warning("camera %s: %s", self._serial, said(error))
        item = self.sensor.frame_shape(self.shape, self.channels)[1:]
        good = [frame.reshape(item) for frame in frames if frame.shape == self.shape]
        return np.stack(good) if good else np.zeros((0, *item), np.uint16)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return {
            "kind": "pylon",
            "model": self._model,
            "serial": self._serial,
            "shape": list(self.shape),
            **self._setup.describe(),
        }

    def _is_lost(self) -> bool:
        return self._camera is None or bool(self._camera.IsCameraDeviceRemoved())

    def _said(self, error: Exception) -> str:
        return said(error)

    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        """Take one frame; return it, or None and what is wrong."""
        pylon = self._pylon
        self._setup.set_exposure(PylonNodes(self._camera), exposure)
        patience = round(1000 * (exposure + self._options.timeout_seconds))
        waiting = self._camera.WaitForFrameTriggerReady(patience, pylon.TimeoutHandling_Return)
        if not waiting:
            return self._timed_out(f"not ready for a trigger within {patience} ms")
        self._before_trigger(exposure)
        self._camera.ExecuteSoftwareTrigger()
        with self._camera.RetrieveResult(patience, pylon.TimeoutHandling_Return) as result:
            if not result.IsValid():
                return self._timed_out(f"no frame within {patience} ms")
            if not result.GrabSucceeded():
                return self._failed(result.GetErrorDescription())
            frame = np.array(result.GetArray(), np.uint16)
        if frame.shape != self.shape:
            return self._failed(f"the frame has {frame.shape} pixels, expected {self.shape}")
        return frame, ""

    def _open(self) -> tuple[int, int]:
        """Find the camera, set it up and start it; return the frames' shape."""
        info = self._found()
        self._serial = info.GetSerialNumber()
        self._name = f"camera {self._serial}"
        try:
            self._camera = self._pylon.InstantCamera(
                self._pylon.TlFactory.GetInstance().CreateDevice(info)
            )
            self._camera.Open()
            self._model = info.GetModelName()
            shape = self._setup.apply(PylonNodes(self._camera))
            self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
        except self._genicam.GenericException as error:
            self._drop()
            raise CaptureError(
                f"camera {self._serial}: can't be opened: {said(error)}. Close other programs "
                "that hold it (pylon Viewer), and check its power and cable"
            ) from error
        except CaptureError:
            self._drop()
            raise
        _log.info(
            "camera %s (%s): %s, %d x %d",
            self._serial, self._model, self._setup.pixel_format, *shape,
        )  # fmt: skip
        return shape

    def _found(self) -> Any:
        """Return the driver's entry of the camera."""
        connected = list(self._pylon.TlFactory.GetInstance().EnumerateDevices())
        return connected[chosen((info.GetSerialNumber() for info in connected), self._serial)]

    def _restart(self) -> None:
        """Stop and start, so that a frame that comes late is not taken for the next one."""
        self._camera.StopGrabbing()
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def _drop(self) -> None:
        """Let go of the device, whatever state it is in."""
        camera, self._camera = self._camera, None
        if camera is None:
            return
        for step in (camera.StopGrabbing, camera.Close, camera.DestroyDevice):
            with suppress(self._genicam.GenericException):
                step()
