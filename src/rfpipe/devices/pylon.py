"""Basler cameras, through their library pylon."""

from __future__ import annotations

import re
import warnings
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from rfpipe.array_types import Counts
from rfpipe.devices.bracket import load_library
from rfpipe.devices.genicam import GenicamCamera, RefusedError, Value, select_camera
from rfpipe.photometry.camera import CameraModel

BUFFERS = 10
"""Frame buffers outside sequences."""


class PylonCamera(GenicamCamera):
    """A Basler camera: brackets by software trigger, sequences by a projector's trigger.

    `GenicamOptions` lists the options. CaptureError where pypylon is missing, no camera responds,
    or it refuses a setting, which the message names.
    """

    kind = "pylon"
    bench = "rfpipe.devices.bench:software_bench"

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        super().__init__(sensor, **options)
        self._pylon, self._genicam = _load_pylon()
        self.faults = self._genicam.GenericException, RefusedError
        self.shape = self._open()

    @property
    def nodes(self) -> PylonNodes:
        """The open camera's settings."""
        return PylonNodes(self._handle)

    def _is_lost(self) -> bool:
        return self._handle is None or bool(self._handle.IsCameraDeviceRemoved())

    def _error_text(self, error: Exception) -> str:
        return _error_text(error)

    def _is_ready(self, seconds: float) -> bool:
        patience, ending = round(1000 * seconds), self._pylon.TimeoutHandling_Return
        return bool(self._handle.WaitForFrameTriggerReady(patience, ending))

    def _trigger(self) -> None:
        self._handle.ExecuteSoftwareTrigger()

    def _next_frame(self, seconds: float) -> tuple[Counts | None, str]:
        patience, ending = round(1000 * seconds), self._pylon.TimeoutHandling_Return
        with self._handle.RetrieveResult(patience, ending) as result:
            if not result.IsValid():
                return None, ""
            if not result.GrabSucceeded():
                return None, result.GetErrorDescription() or "the frame is damaged"
            return np.array(result.GetArray(), np.uint16), ""

    def _connect(self) -> None:
        factory = self._pylon.TlFactory.GetInstance()
        devices = list(factory.EnumerateDevices())
        serials = [device.GetSerialNumber() for device in devices]
        info = devices[select_camera(serials, self._serial)]
        self._serial = info.GetSerialNumber()
        self._handle = self._pylon.InstantCamera(factory.CreateDevice(info))
        self._handle.Open()
        self._model = info.GetModelName()

    def _start(self, room: int = 0) -> None:
        self._handle.MaxNumBuffer.Value = max(room, BUFFERS)
        self._handle.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def _stop(self) -> None:
        self._handle.StopGrabbing()

    def _release(self, handle: Any) -> None:
        for step in (handle.StopGrabbing, handle.Close, handle.DestroyDevice):
            with suppress(self._genicam.GenericException):
                step()


@dataclass(frozen=True)
class PylonNodes:
    """Settings of an open `pypylon.pylon.InstantCamera`; implements `NodeMap`."""

    camera: Any

    def is_writable(self, name: str) -> bool:
        return bool(_load_pylon()[1].IsWritable(getattr(self.camera, name)))

    def write(self, name: str, value: Value) -> Value:
        node = getattr(self.camera, name)
        try:
            node.Value = value
            actual: Value = node.Value
        except (_load_pylon()[1].GenericException, TypeError) as error:
            raise RefusedError(_error_text(error)) from error
        return actual

    def execute(self, name: str) -> None:
        getattr(self.camera, name).Execute()

    def bounds(self, name: str) -> tuple[float, float]:
        node = getattr(self.camera, name)
        return node.Min, node.Max

    def number(self, name: str) -> float | None:
        with suppress(Exception):
            return float(getattr(self.camera, name).Value)
        return None

    def choices(self, name: str) -> tuple[str, ...]:
        return tuple(getattr(self.camera, name).Symbolics)


def _load_pylon() -> tuple[Any, Any]:
    """Return the modules ``pylon`` and ``genicam`` of pypylon, or raise CaptureError."""
    with warnings.catch_warnings():
        # the types of its wrapper warn, which would raise where warnings are errors
        warnings.simplefilter("ignore", DeprecationWarning)
        return load_library("pypylon.pylon", "rig"), load_library("pypylon.genicam", "rig")


def _error_text(error: Exception) -> str:
    """Return an error message of pylon without the names of its source files."""
    return re.split(r" : \w+ thrown", str(error))[0].strip().rstrip(".")
