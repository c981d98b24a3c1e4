"""Basler cameras, through their driver pylon."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.devices import Closing
from rfpipe.rigs.pylon_options import PylonOptions
from rfpipe.rigs.pylon_sequence import Collector
from rfpipe.rigs.pylon_setup import SOFTWARE, CameraSetup, load_pylon, said

__all__ = ["PylonCamera"]

Counts = NDArray[np.uint16]

_log = logging.getLogger(__name__)


class PylonCamera(Closing):
    """A Basler camera that takes brackets by software trigger.

    All automatic functions are off and the gain is fixed. A frame that fails or doesn't come in
    time is taken again; a camera that is lost is looked for, set up and asked again. What arrives
    late is dropped, never taken for the next exposure.

    Parameters
    ----------
    sensor : CameraModel
        Exposures, bits and mosaic, which choose the pixel format, and what is known of the noise.
    options
        As `PylonOptions` has them, by name, the same where they aren't given; the pixel format is
        the sensor's.

    Attributes
    ----------
    statistics : dict of str to int
        ``frames`` taken; ``failed``: frames that came damaged; ``timed_out``: that didn't come;
        ``reconnected``: times that the camera was lost and found.

    Raises
    ------
    CaptureError
        When pypylon is missing, no camera answers, or it refuses a setting: says which.
    """

    Options = PylonOptions

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        if unknown := options.keys() - PylonOptions.model_fields:
            raise TypeError(f"a Basler camera has no options {', '.join(sorted(unknown))}")
        self.sensor = sensor
        self.channels = 1 if sensor.bayer is None else 3
        self.statistics = {"frames": 0, "failed": 0, "timed_out": 0, "reconnected": 0}
        self._options = PylonOptions.model_construct(**options)  # the camera knows its own ranges
        self._setup = CameraSetup(sensor, self._options)
        self._serial = self._options.serial
        self._model = ""
        self._lock = threading.Lock()
        self._closed = False
        self._pylon, self._genicam = load_pylon()
        self._camera: Any = None
        self._collector: Collector | None = None
        self.shape = self._open()

    def expose(self) -> Counts:
        """Take one bracket; see `rfpipe.rigs.devices.Camera.expose`."""
        frames = np.empty(self.sensor.frame_shape(self.shape, self.channels), np.uint16)
        with self._lock:
            for index, exposure in enumerate(self.sensor.exposures):
                frame = self._exposure(exposure)
                frames[index] = frame[..., None] if self.channels == 1 else frame
        return frames

    @property
    def can_be_triggered(self) -> bool:
        """Whether a projector triggers it; see `rfpipe.rigs.sequences.SequenceCamera`."""
        return self._options.sequence_line is not None

    def seconds_between(self, exposure: float) -> float:
        """Return the least time between two triggers; as `SequenceCamera` has it."""
        return self._setup.seconds_between(exposure, self._camera)

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
                if self._camera is None or self._camera.IsCameraDeviceRemoved():
                    self._reconnect("it was disconnected")
                self._camera.StopGrabbing()
                self._setup.set_exposure(self._camera, exposure)
                self._setup.set_trigger(self._camera, str(self._options.sequence_line))
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
                self._setup.set_trigger(self._camera, SOFTWARE)
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

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        with self._lock:
            self._closed = True
            self._drop()

    def _before_trigger(self, exposure: float) -> None:
        """Is called before each trigger; a real camera needs nothing more."""

    def _exposure(self, exposure: float) -> Counts:
        """Take one frame, again where it fails."""
        if self._closed:
            raise CaptureError("the camera is closed; open it anew")
        problem, attempts = "", self._options.retries + 1
        for attempt in range(attempts):
            try:
                if self._camera is None or self._camera.IsCameraDeviceRemoved():
                    self._reconnect("it was disconnected")
                frame, problem = self._triggered(exposure)
                if frame is not None:
                    self.statistics["frames"] += 1
                    return frame
                self._restart()
            except self._genicam.GenericException as error:
                problem = said(error)
                self._reconnect(problem)
            _log.warning(
                "camera %s, exposure %g s, attempt %d of %d: %s",
                self._serial, exposure, attempt + 1, attempts, problem,
            )  # fmt: skip
        raise CaptureError(
            f"camera {self._serial}: no good frame of {exposure:g} s in {attempts} attempts; "
            f"the last: {problem}. Check its cable and the load of its port (packet "
            "size, USB hub), or raise camera.timeout_seconds or camera.retries"
        )

    def _triggered(self, exposure: float) -> tuple[Counts | None, str]:
        """Take one frame; return it, or None and what is wrong."""
        pylon = self._pylon
        self._setup.set_exposure(self._camera, exposure)
        patience = round(1000 * (exposure + self._options.timeout_seconds))
        waiting = self._camera.WaitForFrameTriggerReady(patience, pylon.TimeoutHandling_Return)
        if not waiting:
            self.statistics["timed_out"] += 1
            return None, f"not ready for a trigger within {patience} ms"
        self._before_trigger(exposure)
        self._camera.ExecuteSoftwareTrigger()
        with self._camera.RetrieveResult(patience, pylon.TimeoutHandling_Return) as result:
            if not result.IsValid():
                self.statistics["timed_out"] += 1
                return None, f"no frame within {patience} ms"
            if not result.GrabSucceeded():
                self.statistics["failed"] += 1
                return None, result.GetErrorDescription()
            frame = np.array(result.GetArray(), np.uint16)
        if frame.shape != self.shape:
            self.statistics["failed"] += 1
            return None, f"the frame has {frame.shape} pixels, expected {self.shape}"
        return frame, ""

    def _open(self) -> tuple[int, int]:
        """Find the camera, set it up and start it; return the frames' shape."""
        info = self._found()
        self._serial = info.GetSerialNumber()
        try:
            self._camera = self._pylon.InstantCamera(
                self._pylon.TlFactory.GetInstance().CreateDevice(info)
            )
            self._camera.Open()
            self._model = info.GetModelName()
            shape = self._setup.apply(self._camera)
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
        serials = [info.GetSerialNumber() for info in connected]
        if self._serial is not None and self._serial in serials:
            return connected[serials.index(self._serial)]
        if self._serial is None and len(connected) == 1:
            return connected[0]
        wanted = "any camera" if self._serial is None else f"camera {self._serial}"
        raise CaptureError(
            f"{wanted}: {len(connected)} cameras answer{': ' if serials else ''}"
            f"{', '.join(serials)}. Check power, cable and network, and name the camera by "
            "camera.serial"
        )

    def _restart(self) -> None:
        """Stop and start, so that a frame that comes late is not taken for the next one."""
        self._camera.StopGrabbing()
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def _reconnect(self, reason: str) -> None:
        """Find the camera again."""
        _log.warning("camera %s was lost: %s", self._serial, reason)
        problem = reason
        for attempt in range(self._options.reconnects):
            self._drop()
            time.sleep(self._options.reconnect_seconds)
            try:
                shape = self._open()
            except CaptureError as error:
                problem = str(error)
                _log.warning("attempt %d of %d: %s", attempt + 1, self._options.reconnects, error)
                continue
            if shape != self.shape:
                raise CaptureError(
                    f"camera {self._serial}: has {shape} pixels since it came back, {self.shape} "
                    "before"
                )
            self.statistics["reconnected"] += 1
            _log.warning("camera %s is back", self._serial)
            return
        raise CaptureError(
            f"camera {self._serial} was lost ({reason}) and not found again in "
            f"{self._options.reconnects} attempts; the last: {problem}. Check its power, cable and "
            "network, and that no other program took it"
        )

    def _drop(self) -> None:
        """Let go of the device, whatever state it is in."""
        camera, self._camera = self._camera, None
        if camera is None:
            return
        for step in (camera.StopGrabbing, camera.Close, camera.DestroyDevice):
            with suppress(self._genicam.GenericException):
                step()
