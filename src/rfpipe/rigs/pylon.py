"""Basler cameras, through their driver pylon."""

from __future__ import annotations

import logging
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.cameras.bracket import chosen, options_of
from rfpipe.rigs.cameras.genicam import RefusedError
from rfpipe.rigs.cameras.genicam_camera import GenicamCamera
from rfpipe.rigs.cameras.options import GenicamOptions
from rfpipe.rigs.pylon_setup import PylonNodes, load_pylon, said

__all__ = ["PylonCamera"]

Counts = NDArray[np.uint16]

_log = logging.getLogger(__name__)


class PylonCamera(GenicamCamera):
    """A Basler camera that takes brackets by software trigger, and sequences by a projector's.

    All automatic functions are off and the gain is fixed. Failed frames and a lost camera are
    treated as every `BracketCamera` does.

    Parameters
    ----------
    sensor : CameraModel
        Exposures, bits and mosaic, which choose the pixel format, and what is known of the noise.
    options
        As `GenicamOptions` has them, by name, the same where they aren't given; the pixel format is
        the sensor's.

    Raises
    ------
    CaptureError
        When pypylon is missing, no camera answers, or it refuses a setting: says which.
    """

    kind = "pylon"
    Options = GenicamOptions
    bench = "rfpipe.rigs.bench:BenchCamera"

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        super().__init__(sensor, options_of(GenicamOptions, options, "a Basler camera"))
        self._pylon, self._genicam = load_pylon()
        self.faults = self._genicam.GenericException, RefusedError
        self._camera: Any = None
        self.shape = self._open()

    @property
    def nodes(self) -> PylonNodes:
        """The open camera's settings."""
        return PylonNodes(self._camera)

    def _is_lost(self) -> bool:
        return self._camera is None or bool(self._camera.IsCameraDeviceRemoved())

    def _said(self, error: Exception) -> str:
        return said(error)

    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        """Take one frame; return it, or None and what is wrong."""
        self._setup.set_exposure(self.nodes, exposure)
        seconds = exposure + self._options.timeout_seconds
        patience = round(1000 * seconds)
        if not self._camera.WaitForFrameTriggerReady(patience, self._pylon.TimeoutHandling_Return):
            return self._timed_out(f"not ready for a trigger within {patience} ms")
        self._before_trigger(exposure)
        self._camera.ExecuteSoftwareTrigger()
        return self._awaited(seconds)

    def _next(self, seconds: float) -> tuple[Counts | None, str]:
        patience, ending = round(1000 * seconds), self._pylon.TimeoutHandling_Return
        with self._camera.RetrieveResult(patience, ending) as result:
            if not result.IsValid():
                return None, ""
            if not result.GrabSucceeded():
                return None, result.GetErrorDescription() or "the frame is damaged"
            return np.array(result.GetArray(), np.uint16), ""

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
            shape = self._setup.apply(self.nodes)
            self._start()
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

    def _start(self) -> None:
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def _stop(self) -> None:
        self._camera.StopGrabbing()

    def _drop(self) -> None:
        """Let go of the device, whatever state it is in."""
        camera, self._camera = self._camera, None
        if camera is None:
            return
        for step in (camera.StopGrabbing, camera.Close, camera.DestroyDevice):
            with suppress(self._genicam.GenericException):
                step()
