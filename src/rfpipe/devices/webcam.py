"""Webcams and other sources that OpenCV's VideoCapture opens: V4L2, GStreamer, files, streams.

Webcams are poor measuring cameras: 8 bits, after processing in the camera. Processing that can be
switched off is switched off, and the remainder is logged; the calibration's linearity step tests
whether it can be inverted. Tested with image sequences that OpenCV opens as a device, and with the
controls of a UVC camera in software, but not with a physical camera or a V4L2 device.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.array_types import Counts
from rfpipe.config.base import Settings, Text
from rfpipe.devices.bracket import BracketCamera, load_library
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.devices import PictureExtent

V4L2_TICKS = 1e4
"""Units of exposure time per second: V4L2 counts 100 microseconds."""

_log = logging.getLogger(__name__)


class WebcamOptions(Settings):
    """A webcam, by OpenCV."""

    bits: ClassVar[int] = 8
    bayer: ClassVar[str | None] = None

    device: int | Text = Field(
        0,
        description="Number of the device, such as 0 for /dev/video0; or a path, an address or a "
        "GStreamer pipeline: anything that OpenCV's VideoCapture opens.",
    )
    backend: Literal["any", "v4l2", "gstreamer", "ffmpeg", "images"] = Field(
        "any", description="OpenCV's backend: any, v4l2, gstreamer, ffmpeg or images."
    )
    channels: Literal[1, 3] = Field(
        3, description="3: the colours that the camera computes; 1: only its green channel."
    )
    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None,
        description="Height and width of the frames in pixels, or null for the camera's default.",
    )
    skip_frames: int = Field(
        4,
        ge=0,
        le=100,
        description="Frames dropped before each used frame: they may have been exposed "
        "before the picture or the exposure time changed.",
    )


class Webcam(BracketCamera):
    """A webcam; takes brackets if its exposure time can be set, else single frames.

    Not tested with a physical camera. `WebcamOptions` lists the options. `adapts` names the
    adaptive or nonlinear processing that could not be switched off.

    CaptureError where OpenCV is missing, or the device doesn't open or deliver a frame; InputError
    where the sensor has a mosaic or not 8 bits, or where exposure times can't be set.
    """

    kind = "webcam"
    Options = WebcamOptions
    advice = "Check its cable and hub, and that no other program uses it"

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        if (sensor.bits, sensor.bayer) != (8, None):
            raise InputError(
                f"sensor.bits is {sensor.bits} and sensor.bayer {sensor.bayer}; a webcam's frames "
                "have 8 bits and no mosaic: set 8 and null"
            )
        super().__init__(sensor, **options)
        self.channels = self._options.channels
        self._cv2 = load_library("cv2", "webcam")
        self.faults = (self._cv2.error,)
        self.adapts: tuple[str, ...] = ()
        self._current_exposure: float | None = None
        self._has_times = False
        self._name = f"webcam {self._options.device}"
        self.shape = self._open()
        self._adopt_exposure_times()

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {
            "device": str(self._options.device),
            "backend": self._options.backend,
            "channels": self.channels,
            "skip_frames": self._options.skip_frames,
            "adapts": list(self.adapts),
        }

    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        if self._has_times and self._current_exposure != exposure:
            self._set_exposure(exposure)
        self._before_trigger(exposure)
        for _ in range(self._options.skip_frames):
            self._handle.grab()
        arrived, frame = self._handle.read()
        if not arrived or frame is None:
            return None, "no frame came"
        return self._counts(frame), ""

    def _counts(self, frame: NDArray[Any]) -> Counts:
        """Convert OpenCV's BGR frame to RGB counts (H, W[, 3])."""
        if frame.dtype != np.uint8:
            raise CaptureError(f"{self._name}: gives frames of {frame.dtype}; expected uint8")
        grey = frame.ndim == 2
        if self.channels == 1:
            return (frame if grey else frame[..., 1]).astype(np.uint16)
        if grey:
            raise CaptureError(f"{self._name}: is a grey camera; set camera.options.channels to 1")
        return frame[..., 2::-1].astype(np.uint16)

    def _opened(self) -> Any:
        """Open the device with OpenCV."""
        backend = getattr(self._cv2, f"CAP_{self._options.backend.upper()}")
        return self._cv2.VideoCapture(self._options.device, backend)

    def _open(self) -> tuple[int, int]:
        """Open the device, switch off automatic functions, and take a first frame."""
        self._handle, self._current_exposure = self._opened(), None
        if not self._handle.isOpened():
            self._disconnect()
            raise CaptureError(
                f"{self._name}: can't be opened. Check that it exists (v4l2-ctl --list-devices), "
                "that no other program uses it, that you may read it (group video), and "
                "camera.options.device and camera.options.backend"
            )
        try:
            self._set_up()
            arrived, frame = self._handle.read()
            if not arrived or frame is None:
                raise CaptureError(f"{self._name}: opens, but delivers no frame. {self.advice}")
            height, width = self._counts(frame).shape[:2]
        except BaseException:
            self._disconnect()
            raise
        size = self._options.shape
        if size is not None and (height, width) != tuple(size):
            self._disconnect()
            raise CaptureError(
                f"{self._name}: delivers frames of {height} x {width} pixels; "
                f"camera.options.shape is {size[0]} x {size[1]}: set it to a size that the camera "
                "supports"
            )
        return height, width

    def _set_up(self) -> None:
        """Write all settings except the exposure time, and warn of those that failed."""
        options, adapts = self._options, []
        self._set("FOURCC", self._cv2.VideoWriter_fourcc(*"YUYV"))  # not compressed
        if options.shape is not None:
            self._set("FRAME_HEIGHT", options.shape[0])
            self._set("FRAME_WIDTH", options.shape[1])
        is_v4l2 = self._handle.getBackendName() == "V4L2"
        for name, function, off in (
            ("AUTO_EXPOSURE", "automatic exposure", 1 if is_v4l2 else 0.25),
            ("AUTO_WB", "automatic white balance", 0),
            ("AUTOFOCUS", "autofocus", 0),
            ("BACKLIGHT", "backlight compensation", 0),
            ("SHARPNESS", "sharpening", 0),
            ("GAMMA", "gamma", 100),
        ):
            if not self._set(name, off):
                adapts.append(function)
        stream = _fourcc_text(int(self._handle.get(self._cv2.CAP_PROP_FOURCC)))
        if stream in ("MJPG", "JPEG", "H264", "HEVC"):
            adapts.append(f"compression ({stream})")
        self.adapts = tuple(adapts)
        text = ", ".join(self.adapts)
        _log.warning(
            "%s: webcams process their 8-bit frames%s. Calibrate it: the linearity step tests "
            "whether the processing can be inverted",
            self._name, f"; these functions could not be switched off: {text}" * bool(text),
        )  # fmt: skip

    def _set(self, name: str, value: float) -> bool:
        """Write a setting; False if the camera doesn't accept it."""
        prop = getattr(self._cv2, f"CAP_PROP_{name}")
        return bool(self._handle.set(prop, value)) and self._handle.get(prop) == value

    def _set_exposure(self, exposure: float) -> float | None:
        """Set the exposure time in seconds; return the camera's time, None if it can't be set."""
        self._current_exposure = exposure
        if self._handle.getBackendName() != "V4L2":
            return None
        prop = self._cv2.CAP_PROP_EXPOSURE
        success = self._handle.set(prop, max(1, round(exposure * V4L2_TICKS)))
        return float(self._handle.get(prop)) / V4L2_TICKS if success else None

    def _adopt_exposure_times(self) -> None:
        """Replace the sensor's exposure times by the camera's rounded times."""
        nominal = self.sensor.exposures
        actual = [self._set_exposure(exposure) for exposure in nominal]
        times = [time for time in actual if time]
        if len(times) < len(nominal):
            if len(nominal) > 1:
                self.close()
                raise InputError(
                    f"{self._name}: its exposure time can't be set; give sensor.exposures one "
                    f"time, not {len(nominal)}"
                )
            _log.warning("%s: its exposure time can't be set and is unknown", self._name)
            return
        for exposure, time in zip(nominal, times, strict=True):
            if abs(time / exposure - 1) > 0.01:
                _log.warning("%s: uses %g s for an exposure of %g s", self._name, time, exposure)
        self._has_times, self._current_exposure = True, None
        try:
            self.sensor = replace(self.sensor, exposures=tuple(times))
        except InputError as error:  # two times round to the same one
            self.close()
            raise InputError(f"{self._name}: after rounding sensor.exposures: {error}") from error

    def _release(self, handle: Any) -> None:
        handle.release()


def _fourcc_text(fourcc: int) -> str:
    """Return the four characters of a stream's format."""
    return "".join(chr((fourcc >> shift) & 0x7F) for shift in (0, 8, 16, 24)).upper()
