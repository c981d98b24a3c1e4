"""Cameras of the GenICam standard: settings and triggers, independent of the library used."""

from __future__ import annotations

import logging
import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Any, Protocol, TypeAlias

import numpy as np
from pydantic import Field

from rfpipe.array_types import Counts
from rfpipe.devices.bracket import BracketCamera, FrameOptions
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.camera import CameraModel

Value: TypeAlias = bool | int | float | str
"""Value of a camera's setting."""

FIXED: dict[str, Value] = {
    "GainAuto": "Off",
    "ExposureAuto": "Off",
    "ExposureMode": "Timed",
    "BalanceWhiteAuto": "Off",
    "BlackLevelAuto": "Off",
    "Gamma": 1.0,
    "GammaEnable": False,
    "LUTEnable": False,
    "DigitalShift": 0,
    "SharpnessEnhancement": 0.0,
    "NoiseReduction": 0.0,
    "AcquisitionFrameRateEnable": False,
    "AcquisitionMode": "Continuous",
}
"""Settings against adaptive and nonlinear processing, written where a camera has them."""

_FRAME_RATES = "ResultingFrameRate", "ResultingFrameRateAbs", "AcquisitionResultingFrameRate"
"""Makers' names of the frame rate, in hertz, that the current settings allow."""

_log = logging.getLogger(__name__)


class GenicamOptions(FrameOptions):
    """A camera of the GenICam standard."""

    serial: str | None = Field(
        None, min_length=1, description="Serial number, or null for the only camera connected."
    )
    gain_db: float = Field(
        0.0, ge=0, le=48, description="Gain in decibels, fixed; 0 has the least noise."
    )
    nodes: dict[str, bool | int | float | str] = Field(
        default_factory=dict,
        description="Further settings of the camera, as its manual names them, such as "
        "{SensorReadoutMode: Fast}.",
    )
    sequence_line: str | None = Field(
        None,
        min_length=1,
        description="Input at which a projector with sequences triggers the camera, as its manual "
        "names it, such as Line1; null without such a projector.",
    )


class RefusedError(CaptureError):
    """A camera refuses a setting, or is disconnected."""


class NodeMap(Protocol):
    """A camera's settings by name, through one library for GenICam cameras."""

    def is_writable(self, name: str) -> bool:
        """Test whether the camera has the setting and it can be written now."""

    def write(self, name: str, value: Value) -> Value:
        """Write a setting and return the value that the camera reports, or raise RefusedError."""

    def execute(self, name: str) -> None:
        """Run a command of the camera."""

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the least and the largest value of a number."""

    def choices(self, name: str) -> tuple[str, ...]:
        """Return the values of an enumeration."""

    def number(self, name: str) -> float | None:
        """Return the value of a number; None where the camera doesn't provide it."""


class GenicamCamera(BracketCamera):
    """A GenICam camera: brackets by software trigger, sequences by a projector's trigger.

    All automatic functions are off and the gain is fixed. The sensor's bits and mosaic determine
    the pixel format; InputError where no format has these bits. `GenicamOptions` lists the options.
    """

    Options = GenicamOptions

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        if sensor.bits not in (8, 10, 12, 16):
            raise InputError(f"sensor.bits is {sensor.bits}; a GenICam camera has 8, 10, 12 or 16")
        super().__init__(sensor, **options)
        self.channels = 1 if sensor.bayer is None else 3
        mosaic = "Mono" if sensor.bayer is None else f"Bayer{sensor.bayer[:2]}"
        self._pixel_format = f"{mosaic}{sensor.bits}"
        self._serial = self._options.serial
        self._model = ""
        self._armed: tuple[float, int] | None = None

    @property
    @abstractmethod
    def nodes(self) -> NodeMap:
        """The open camera's settings."""

    @abstractmethod
    def _connect(self) -> None:
        """Find and open the camera; set `_handle`, `_serial` and `_model`."""

    @abstractmethod
    def _start(self, room: int = 0) -> None:
        """Start taking a frame at each trigger, with buffers for `room` frames."""

    @abstractmethod
    def _stop(self) -> None:
        """Stop taking frames, and drop frames in transfer."""

    @abstractmethod
    def _trigger(self) -> None:
        """Trigger a frame."""

    @abstractmethod
    def _next_frame(self, seconds: float) -> tuple[Counts | None, str]:
        """Return the next frame, or None and the problem: ``""`` for a timeout."""

    def _is_ready(self, seconds: float) -> bool:  # noqa: ARG002
        """Wait until the camera is ready for a trigger; False after `seconds`."""
        return True

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {
            "model": self._model,
            "serial": self._serial,
            "pixel_format": self._pixel_format,
            "offset": list(self._options.offset),
            "gain_db": self._options.gain_db,
            "nodes": dict(sorted(self._options.nodes.items())),
        }

    @property
    def can_be_triggered(self) -> bool:
        """True if a projector triggers the camera; see `rfpipe.rigs.devices.SequenceCamera`."""
        return self._options.sequence_line is not None

    def seconds_between(self, exposure: float) -> float:
        """Return the shortest time between two triggers in seconds; see `SequenceCamera`."""
        rate = next(filter(None, map(self.nodes.number, _FRAME_RATES)), None)
        if rate is None and self.nodes.number("AcquisitionFrameRate") is not None:
            rate = self.nodes.bounds("AcquisitionFrameRate")[1]  # as size and format allow it
        # a huge rate means no bound; 5 % margin, since a trigger that comes too early is missed
        return 1.05 * (max(exposure, 1 / rate) if rate and rate > 0 else exposure)

    def arm(self, exposure: float, count: int) -> None:
        """Wait for triggers by the projector; see `SequenceCamera`.

        CaptureError where the camera is lost, or refuses the input `sequence_line`.
        """
        with self._lock:
            self._check_open()
            try:
                self._stop()
                self._set_exposure(exposure)
                self._set_trigger(str(self._options.sequence_line))
                self._start(count)
            except CaptureError:  # connected, but refuses a setting
                self._use_software_trigger()
                raise
            except self.faults as error:
                self._disconnect()
                raise CaptureError(f"{self._name}: {self._error_text(error)}") from error
            self._armed = exposure, count

    def collect(self) -> Counts:
        """Return the frames since `arm`; see `SequenceCamera`."""
        with self._lock:
            if self._armed is None:
                raise CaptureError(f"{self._name}: isn't armed")
            (exposure, count), self._armed = self._armed, None
            item = self.sensor.frame_shape(self.shape, self.channels)[1:]
            frames, n_good, n_failed = np.empty((count, *item), np.uint16), 0, 0
            for frame in self._triggered_frames(exposure, count):
                if frame is None or frame.shape != self.shape:
                    n_failed += 1
                else:
                    frames[n_good] = frame.reshape(item)
                    n_good += 1
            self.statistics["frames"] += n_good
            self.statistics["failed"] += n_failed
            self.statistics["timed_out"] += count - n_good - n_failed
            self._use_software_trigger()
        return frames[:n_good]

    def _triggered_frames(self, exposure: float, count: int) -> Iterator[Counts | None]:
        """Yield up to `count` frames, None for a damaged one, until one is missing.

        A camera that is lost ends them; the sequencer then plays missing patterns again.
        """
        seconds = exposure + self._options.timeout_seconds
        with suppress(*self.faults):
            for _ in range(count):
                if self._is_lost():
                    return
                frame, problem = self._next_frame(seconds)
                if frame is None and not problem:
                    return
                yield frame

    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        seconds = exposure + self._options.timeout_seconds
        self._set_exposure(exposure)
        if not self._is_ready(seconds):
            return None, "not ready for a trigger in time"
        self._before_trigger(exposure)
        self._trigger()
        return self._next_frame(seconds)

    def _open(self) -> tuple[int, int]:
        try:
            self._connect()
            self._name = f"camera {self._serial}"
            shape = self._set_up()
            self._start()
        except CaptureError:
            self._disconnect()
            raise
        except self.faults as error:
            self._disconnect()
            raise CaptureError(
                f"camera {self._serial}: can't be opened: {self._error_text(error)}. Close other "
                "programs that use it, and check its power and cable"
            ) from error
        _log.info("%s (%s): %s, %d x %d", self._name, self._model, self._pixel_format, *shape)
        return shape

    def _restart(self) -> None:
        self._stop()
        self._start()

    def _use_software_trigger(self) -> None:
        """Switch to software triggers; a camera that fails is reconnected at the next frame."""
        if self._is_lost():
            return
        failures: tuple[type[Exception], ...] = (CaptureError, *self.faults)
        try:
            self._stop()
            self._set_trigger("Software")
            self._start()
        except failures as error:
            self._disconnect()
            _log.warning("%s: %s", self._name, self._error_text(error))

    def _set_up(self) -> tuple[int, int]:
        """Write all settings except the exposure time; return the frames' height and width."""
        nodes, options = self.nodes, self._options
        if nodes.is_writable("UserSetLoad"):
            self._set("UserSetSelector", "Default")  # undo the settings of other programs
            nodes.execute("UserSetLoad")
        for name, value in FIXED.items():
            if nodes.is_writable(name):
                self._set(name, value)
        self._set("PixelFormat", self._pixel_format)
        shape = self._set_region()
        for selector in nodes.choices("TriggerSelector"):
            self._set("TriggerSelector", selector)
            self._set("TriggerMode", "On" if selector == "FrameStart" else "Off")
        self._set("TriggerSelector", "FrameStart")
        self._set("TriggerMode", "On")  # for cameras with one mode for all selectors
        self._set_trigger("Software")
        if nodes.is_writable("Gain"):
            self._set("Gain", float(options.gain_db))
        elif options.gain_db == 0:
            self._set("GainRaw", int(nodes.bounds("GainRaw")[0]))
        else:
            raise CaptureError(
                "camera: has no gain in decibels; set camera.options.gain_db to 0 and "
                "camera.options.nodes to {GainRaw: ...}"
            )
        for name, value in options.nodes.items():
            self._set(name, value)
        return shape

    def _set_region(self) -> tuple[int, int]:
        """Set the region of the sensor; return its height and width."""
        offsets = dict(zip(("OffsetY", "OffsetX"), self._options.offset, strict=True))
        for name in offsets:
            if self.nodes.is_writable(name):
                self._set(name, 0)  # the current offset limits the extents
        largest = tuple(int(self.nodes.bounds(name)[1]) for name in ("Height", "Width"))
        height, width = self._options.shape or largest
        for name, value in (("Height", height), ("Width", width), *offsets.items()):
            if value > 0:
                self._set(name, value)
        return height, width

    def _set_exposure(self, exposure: float) -> None:
        """Set the exposure time in seconds, and verify it."""
        # cameras before SFNC 2 have ExposureTimeAbs
        name = "ExposureTime" if self.nodes.is_writable("ExposureTime") else "ExposureTimeAbs"
        nominal = 1e6 * exposure
        least, largest = self.nodes.bounds(name)
        if not least <= nominal <= largest:
            raise CaptureError(
                f"camera: an exposure of {exposure:g} s is not in its range, {least / 1e6:g} to "
                f"{largest / 1e6:g} s; change sensor.exposures"
            )
        actual = float(self._write(name, nominal))
        if abs(actual - nominal) > 1e-3 * nominal:  # the merge uses the nominal times
            raise CaptureError(
                f"camera: rounds an exposure of {exposure:g} s to {actual / 1e6:g} s; set "
                "sensor.exposures to a time that it supports"
            )

    def _set_trigger(self, source: str) -> None:
        """Set the source of triggers: Software, or the rising edge of an input such as Line1."""
        self._set("TriggerSource", source)
        if source != "Software" and self.nodes.is_writable("TriggerActivation"):
            self._set("TriggerActivation", "RisingEdge")

    def _set(self, name: str, value: Value) -> None:
        """Write one setting, and verify it: the camera may round numbers by 2 %."""
        actual = self._write(name, value)
        is_near = isinstance(value, float) and math.isclose(
            float(actual), value, rel_tol=0.02, abs_tol=1e-6
        )
        if not is_near and actual != value:
            raise CaptureError(f"camera: sets {name} to {actual} instead of {value}")

    def _write(self, name: str, value: Value) -> Value:
        """Write one setting and return the camera's value; an error lists the valid values."""
        nodes, valid = self.nodes, ""
        try:
            return nodes.write(name, value)
        except RefusedError as error:
            with suppress(Exception):
                valid = f". Valid: {' to '.join(f'{bound:g}' for bound in nodes.bounds(name))}"
            with suppress(Exception):
                valid = f". Valid: {', '.join(nodes.choices(name))}"
            raise RefusedError(f"camera: refuses {name} = {value}: {error}{valid}") from error


def select_camera(serial_numbers: Iterable[str], serial: str | None) -> int:
    """Return the index of the camera to use among the connected ones, or raise CaptureError.

    Without `serial`, exactly one camera must be connected.
    """
    serials = list(serial_numbers)
    if serial is not None and serial in serials:
        return serials.index(serial)
    if serial is None and len(serials) == 1:
        return 0
    name = "any camera" if serial is None else f"camera {serial}"
    raise CaptureError(
        f"{name}: {len(serials)} cameras respond{': ' if serials else ''}{', '.join(serials)}. "
        "Check power, cable and network, and name the camera by camera.options.serial"
    )
