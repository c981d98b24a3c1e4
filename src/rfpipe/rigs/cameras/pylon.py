"""Basler cameras, through their driver pylon."""

from __future__ import annotations

import re
import warnings
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.cameras.bracket import chosen, load_library
from rfpipe.rigs.cameras.genicam import GenicamCamera, RefusedError, Value

Counts = NDArray[np.uint16]


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
    bench = "rfpipe.rigs.bench:BenchCamera"

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        super().__init__(sensor, **options)
        self._pylon, self._genicam = _load_pylon()
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
        return _said(error)

    def _is_ready(self, seconds: float) -> bool:
        patience, ending = round(1000 * seconds), self._pylon.TimeoutHandling_Return
        return bool(self._camera.WaitForFrameTriggerReady(patience, ending))

    def _trigger(self) -> None:
        self._camera.ExecuteSoftwareTrigger()

    def _next(self, seconds: float) -> tuple[Counts | None, str]:
        patience, ending = round(1000 * seconds), self._pylon.TimeoutHandling_Return
        with self._camera.RetrieveResult(patience, ending) as result:
            if not result.IsValid():
                return None, ""
            if not result.GrabSucceeded():
                return None, result.GetErrorDescription() or "the frame is damaged"
            return np.array(result.GetArray(), np.uint16), ""

    def _connect(self) -> None:
        factory = self._pylon.TlFactory.GetInstance()
        connected = list(factory.EnumerateDevices())
        info = connected[chosen((one.GetSerialNumber() for one in connected), self._serial)]
        self._serial = info.GetSerialNumber()
        self._camera = self._pylon.InstantCamera(factory.CreateDevice(info))
        self._camera.Open()
        self._model = info.GetModelName()

    def _start(self) -> None:
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def _stop(self) -> None:
        self._camera.StopGrabbing()

    def _drop(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            for step in (camera.StopGrabbing, camera.Close, camera.DestroyDevice):
                with suppress(self._genicam.GenericException):
                    step()


@dataclass(frozen=True)
class PylonNodes:
    """The settings of an open `pypylon.pylon.InstantCamera`; `Nodes` of `GenicamCamera`."""

    camera: Any

    def is_writable(self, name: str) -> bool:
        """Tell whether the camera has the setting, and takes values for it now."""
        return bool(_load_pylon()[1].IsWritable(getattr(self.camera, name)))

    def write(self, name: str, value: Value) -> Value:
        """Make one setting, or raise RefusedError with the values that the camera takes."""
        node = getattr(self.camera, name)
        try:
            node.Value = value
            taken: Value = node.Value
        except (_load_pylon()[1].GenericException, TypeError) as error:
            raise RefusedError(
                f"camera: refuses {name} = {value}: {_said(error)}{_choices(node)}"
            ) from error
        return taken

    def execute(self, name: str) -> None:
        """Run a command of the camera."""
        getattr(self.camera, name).Execute()

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the least and the largest value of a number."""
        node = getattr(self.camera, name)
        return node.Min, node.Max

    def number(self, name: str) -> float | None:
        """Return a number; None where the camera doesn't tell it."""
        with suppress(Exception):
            return float(getattr(self.camera, name).Value)
        return None

    def choices(self, name: str) -> tuple[str, ...]:
        """Return the values of an enumeration."""
        return tuple(getattr(self.camera, name).Symbolics)


def _load_pylon() -> tuple[Any, Any]:
    """Return the driver's modules ``pylon`` and ``genicam``, or raise CaptureError."""
    with warnings.catch_warnings():
        # its wrapper's types warn, and end the process where a warning is an error
        warnings.simplefilter("ignore", DeprecationWarning)
        return load_library("pypylon.pylon", "rig"), load_library("pypylon.genicam", "rig")


def _said(error: Exception) -> str:
    """Return an error of the driver without the names of its source files."""
    return re.split(r" : \w+ thrown", str(error))[0].strip().rstrip(".")


def _choices(node: Any) -> str:
    """Return the values of a node for an error message."""
    with suppress(Exception):
        return f". It takes {', '.join(node.Symbolics)}"
    with suppress(Exception):
        return f". It takes {node.Min} to {node.Max} in steps of {node.Inc}"
    return ""
