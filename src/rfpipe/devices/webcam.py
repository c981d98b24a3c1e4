"""Webcams and whatever else OpenCV's VideoCapture opens: V4L2, GStreamer, files, streams.

The worst of cameras for measuring: 8 bits, through a processing of their own. What a camera lets
one switch off is switched off, and what is left is said; a calibration's linearity step proves
whether it can be undone. Tested on image sequences that OpenCV opens as a device, and on a UVC
camera's controls in software. Never tried on a camera of metal, nor on a device of V4L2.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.config.base import Settings, Text
from rfpipe.devices.bracket import BracketCamera, load_library
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.devices import PictureExtent

Counts = NDArray[np.uint16]

V4L2_TICKS = 1e4
"""Of an exposure time, a second: V4L2 counts 100 microseconds."""

_log = logging.getLogger(__name__)


class WebcamOptions(Settings):
    """A webcam, by OpenCV."""

    bits: ClassVar[int] = 8
    bayer: ClassVar[str | None] = None

    device: int | Text = Field(
        0,
        description="Number of the device, such as 0 for /dev/video0; or a path, an address or a "
        "GStreamer pipeline, whatever OpenCV's VideoCapture opens.",
    )
    backend: Literal["any", "v4l2", "gstreamer", "ffmpeg", "images"] = Field(
        "any", description="What OpenCV opens it with: any, v4l2, gstreamer, ffmpeg or images."
    )
    channels: Literal[1, 3] = Field(
        3, description="3: colour, as the camera made it; 1: its green alone."
    )
    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None, description="Height and width of the frames in pixels, or null for the camera's own."
    )
    skip_frames: int = Field(
        4,
        ge=0,
        le=100,
        description="Frames dropped before each one that counts, as they were on their way while "
        "picture or exposure time changed, 0 to 100.",
    )


class Webcam(BracketCamera):
    """A webcam that takes brackets where it lets one set its exposure time.

    Without that, it takes one exposure, whose time is the camera's own affair. Never tried on a
    camera of metal. Options as `WebcamOptions` has them; `adapts` names what bends or adapts counts
    and could not be switched off.

    CaptureError where OpenCV is missing, or the device doesn't open or give a frame; InputError
    where the sensor has other than 8 bits or a mosaic, or exposures that the camera can't be told.
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
        self._set_to: float | None = None
        self._has_times = False
        self._name = f"webcam {self._options.device}"
        self.shape = self._open()
        self._take_over_times()

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
        if self._has_times and self._set_to != exposure:
            self._set_exposure(exposure)
        self._before_trigger(exposure)
        for _ in range(self._options.skip_frames):
            self._handle.grab()
        arrived, frame = self._handle.read()
        if not arrived or frame is None:
            return None, "no frame came"
        return self._counts(frame), ""

    def _counts(self, frame: NDArray[Any]) -> Counts:
        """Return OpenCV's blue, green and red as counts (H, W[, 3]), red first."""
        if frame.dtype != np.uint8:
            raise CaptureError(f"{self._name}: gives {frame.dtype}; expected frames of 8 bits")
        grey = frame.ndim == 2
        if self.channels == 1:
            return (frame if grey else frame[..., 1]).astype(np.uint16)
        if grey:
            raise CaptureError(f"{self._name}: is a grey camera; set camera.options.channels to 1")
        return frame[..., 2::-1].astype(np.uint16)

    def _opened(self) -> Any:
        """Return OpenCV's capture of the device."""
        backend = getattr(self._cv2, f"CAP_{self._options.backend.upper()}")
        return self._cv2.VideoCapture(self._options.device, backend)

    def _open(self) -> tuple[int, int]:
        """Open the device, switch off all that adapts, and take a first frame."""
        self._handle, self._set_to = self._opened(), None
        if not self._handle.isOpened():
            self._drop()
            raise CaptureError(
                f"{self._name}: can't be opened. Check that it is there (v4l2-ctl --list-devices), "
                "that no other program uses it, that you may read it (group video), and "
                "camera.options.device and camera.options.backend"
            )
        try:
            self._set_up()
            arrived, frame = self._handle.read()
            if not arrived or frame is None:
                raise CaptureError(f"{self._name}: opens, but gives no frame. {self.advice}")
            height, width = self._counts(frame).shape[:2]
        except BaseException:
            self._drop()
            raise
        size = self._options.shape
        if size is not None and (height, width) != tuple(size):
            self._drop()
            raise CaptureError(
                f"{self._name}: gives frames of {height} x {width} pixels where "
                f"camera.options.shape asks for {size[0]} x {size[1]}; set it to a size that the "
                "camera has"
            )
        return height, width

    def _set_up(self) -> None:
        """Make all settings but the exposure time, and warn of those that failed."""
        options, adapts = self._options, []
        self._set("FOURCC", self._cv2.VideoWriter_fourcc(*"YUYV"))  # not compressed
        if options.shape is not None:
            self._set("FRAME_HEIGHT", options.shape[0])
            self._set("FRAME_WIDTH", options.shape[1])
        is_v4l2 = self._handle.getBackendName() == "V4L2"
        for name, what, off in (
            ("AUTO_EXPOSURE", "automatic exposure", 1 if is_v4l2 else 0.25),
            ("AUTO_WB", "automatic white balance", 0),
            ("AUTOFOCUS", "autofocus", 0),
            ("BACKLIGHT", "backlight compensation", 0),
            ("SHARPNESS", "sharpening", 0),
            ("GAMMA", "gamma", 100),
        ):
            if not self._set(name, off):
                adapts.append(what)
        stream = _letters(int(self._handle.get(self._cv2.CAP_PROP_FOURCC)))
        if stream in ("MJPG", "JPEG", "H264", "HEVC"):
            adapts.append(f"compression ({stream})")
        self.adapts = tuple(adapts)
        text = ", ".join(self.adapts)
        _log.warning(
            "%s: is no measuring camera: 8 bits, made by a processing of its own%s. Calibrate it: "
            "the linearity step proves whether what is left can be undone",
            self._name, f"; it may still have {text}, which could not be switched off" * bool(text),
        )  # fmt: skip

    def _set(self, name: str, value: float) -> bool:
        """Make a setting; tell whether the camera took it."""
        prop = getattr(self._cv2, f"CAP_PROP_{name}")
        return bool(self._handle.set(prop, value)) and self._handle.get(prop) == value

    def _set_exposure(self, exposure: float) -> float | None:
        """Set the exposure time in seconds; return the camera's, or None if it has none to set."""
        self._set_to = exposure
        if self._handle.getBackendName() != "V4L2":
            return None
        prop = self._cv2.CAP_PROP_EXPOSURE
        success = self._handle.set(prop, max(1, round(exposure * V4L2_TICKS)))
        return float(self._handle.get(prop)) / V4L2_TICKS if success else None

    def _take_over_times(self) -> None:
        """Replace the sensor's exposure times by those that the camera takes."""
        nominal = self.sensor.exposures
        actual = [self._set_exposure(exposure) for exposure in nominal]
        times = [time for time in actual if time]
        if len(times) < len(nominal):
            if len(nominal) > 1:
                self.close()
                raise InputError(
                    f"{self._name}: doesn't let one set its exposure time; give sensor.exposures "
                    f"one time, not {len(nominal)}"
                )
            _log.warning("%s: its exposure time is its own affair", self._name)
            return
        for exposure, time in zip(nominal, times, strict=True):
            if abs(time / exposure - 1) > 0.01:
                _log.warning("%s: takes %g s for an exposure of %g s", self._name, time, exposure)
        self._has_times, self._set_to = True, None
        try:
            self.sensor = replace(self.sensor, exposures=tuple(times))
        except InputError as error:  # of two times it can't tell apart
            self.close()
            raise InputError(f"{self._name}: as it takes sensor.exposures, {error}") from error

    def _release(self, handle: Any) -> None:
        handle.release()


def _letters(fourcc: int) -> str:
    """Return the four letters of a stream's format."""
    return "".join(chr((fourcc >> shift) & 0x7F) for shift in (0, 8, 16, 24)).upper()
