"""Photo cameras of Canon, Nikon, Sony and others, through libgphoto2: raw files, in manual mode.

Tested with libgphoto2's virtual camera and synthetic raw files, but not with a physical camera: the
names of Canon's, Nikon's and Sony's settings are those in libgphoto2's source.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from rfpipe.array_types import Counts
from rfpipe.config.base import Text
from rfpipe.devices.bracket import BracketCamera, FrameOptions
from rfpipe.devices.gphoto_library import (
    Photo,
    ShutterTime,
    list_cameras,
    load_gphoto2,
    nearest_times,
    shutter_times,
)
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.pictures.raw import Raw, read_raw

RAW_FORMATS = ("RAW", "NEF (Raw)", "Raw", "NEF", "RAW (14bit)", "cRAW")
"""Makers' names of raw files without a JPEG, best first."""

FIXED = {
    "isoauto": "Off", "autoiso": "Off", "longexpnr": "Off", "autofocus": "Off",
}  # fmt: skip
"""Settings against adaptation and dark-frame subtraction, made where a camera has them."""

MANUAL = ("expprogram", "autoexposuremode", "autoexposuremodedial")
"""Settings that report the mode dial; read-only."""

_log = logging.getLogger(__name__)


class PhotoOptions(FrameOptions):
    """A photo camera, by gphoto2."""

    without_effect_on_frames: ClassVar[frozenset[str]] = frozenset(
        {*FrameOptions.without_effect_on_frames, "keep_pictures"}
    )

    model: Text | None = Field(
        None,
        description="Part of the model's name, such as D750 or EOS R5, or null for the only camera "
        "connected.",
    )
    iso: Annotated[int, Field(ge=25, le=409_600)] = Field(
        100, description="Sensitivity, fixed; the lowest has the least noise."
    )
    nominal_times: bool = Field(
        False,
        description="true: exposures last as long as their names say, such as 1/60 s; false: they "
        "last a power of two, 1/64 s, as most shutters are timed.",
    )
    keep_pictures: bool = Field(
        False, description="true: pictures also stay on the camera's card; false: they are deleted."
    )
    settings: dict[str, bool | int | float | str] = Field(
        default_factory=dict,
        description="Further settings, as 'gphoto2 --list-config' names them, such as "
        "{whitebalance: Daylight}.",
    )
    timeout_seconds: float = Field(
        30.0, gt=0, le=600, description=FrameOptions.model_fields["timeout_seconds"].description
    )

    @model_validator(mode="after")
    def _keeps_the_mosaic(self) -> Self:
        if any(value % 2 for value in (*self.offset, *(self.shape or ()))):
            raise ValueError("offset and shape should be even numbers, as the mosaic is 2 x 2")
        return self


class PhotoCamera(BracketCamera):
    """A Canon, Nikon or Sony camera that takes raw brackets; not tested with a physical camera.

    Size, colour mosaic, black level and white level come from the first picture and replace the
    sensor's. Exposure times are the nearest ones of the camera. `PhotoOptions` lists the options.

    CaptureError where gphoto2 or rawpy is missing, no camera responds, or it refuses a setting;
    InputError where two exposures have the same nearest time.
    """

    kind = "gphoto2"
    Options = PhotoOptions
    advice = "Check its cable, battery and card, and that its mode dial is at M"

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        super().__init__(sensor, **options)
        self.channels = 3
        self.faults = (load_gphoto2().GPhoto2Error,)
        self._model = ""
        self._times: dict[float, ShutterTime] = {}
        self._shutter = ""
        self.shape = self._open()

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {
            "model": self._model,
            "offset": list(self._options.offset),
            "iso": self._options.iso,
            "shutter": [self._times[exposure].name for exposure in self.sensor.exposures],
            "bayer": self.sensor.bayer,
            "black_level_counts": self.sensor.black_level_counts,
            "white_level_counts": self.sensor.white_level,
            "settings": dict(sorted(self._options.settings.items())),
        }

    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        self._before_trigger(exposure)
        data = self._take_picture(self._times[exposure])
        if data is None:
            return None, ""
        try:
            raw = read_raw(data, "the picture")
        except InputError as error:
            return None, str(error)
        recorded = raw.exposure_s  # may be rounded, as in the name of the exposure time
        if recorded is not None and abs(recorded / exposure - 1) > 0.25:
            return None, f"the picture's metadata record an exposure of {recorded:.3g} s"
        return np.minimum(self._part(raw), np.uint16(self.sensor.white_level)), ""

    def _take_picture(self, shutter: ShutterTime) -> bytes | None:
        """Release the shutter and return the file."""
        photo: Photo = self._handle
        if self._shutter != shutter.name:
            photo.set("shutterspeed", shutter.name)
            self._shutter = shutter.name
        photo.release()
        patience = shutter.seconds + self._options.timeout_seconds
        return photo.picture(patience, keep=self._options.keep_pictures)

    def _part(self, raw: Raw) -> Counts:
        """Crop to the configured region, or to an even number of rows and columns."""
        (top, left), (height, width) = self._options.offset, raw.counts.shape
        height, width = self._options.shape or ((height - top) // 2 * 2, (width - left) // 2 * 2)
        return raw.counts[top : top + height, left : left + width]

    def _open(self) -> tuple[int, int]:
        """Connect, set up, and read the sensor's properties from a first picture."""
        self._connect()
        try:
            times = shutter_times(
                self._handle.choices("shutterspeed"), nominal=self._options.nominal_times
            )
            raw = self._first_picture(nearest_times(self.sensor.exposures, times)[0])
            if not self._times:
                self._adopt_sensor(raw, times)
        except BaseException:
            self._disconnect()
            raise
        height, width = self._part(raw).shape
        return height, width

    def _connect(self) -> None:
        """Open the camera and write its settings."""
        model, port = self._find()
        self._name, self._model, self._shutter = f"camera {model}", model, ""
        try:
            self._handle = Photo(model, port)
            self._set_up()
        except load_gphoto2().GPhoto2Error as error:
            self._disconnect()
            raise CaptureError(
                f"{self._name}: can't be opened: {self._error_text(error)}. Close other programs "
                "that use it (a desktop's file manager does: gio mount -s gphoto2), and check that "
                "it is awake"
            ) from error
        except CaptureError:
            self._disconnect()
            raise

    def _find(self) -> tuple[str, str]:
        """Return model and port of the camera to use, or raise CaptureError."""
        cameras, part = list_cameras(), (self._options.model or "").lower()
        matching = [camera for camera in cameras if part in camera[0].lower()]
        if len(matching) == 1:
            return matching[0]
        names = ", ".join(f"{model} at {port}" for model, port in cameras)
        raise CaptureError(
            f"{self._options.model or 'any camera'}: {len(cameras)} photo cameras respond"
            f"{': ' if names else ''}{names}. Check power, cable and that the camera is awake, and "
            "name the camera by camera.options.model"
        )

    def _set_up(self) -> None:
        """Write the settings, and switch off all automatic functions."""
        photo, options = self._handle, self._options
        for name in MANUAL:
            mode = photo.get(name)
            if mode is not None and not str(mode).upper().startswith("M"):
                raise CaptureError(
                    f"{self._name}: its mode is {mode}; turn the dial to M (manual), or exposure "
                    "times are not fixed"
                )
        for name, off in FIXED.items():
            if off in photo.choices(name):
                photo.set(name, off)
        photo.set("capturetarget", "Memory card" if options.keep_pictures else "Internal RAM")
        photo.set("iso", str(options.iso))
        for name in ("imageformat", "imagequality"):
            choices = photo.choices(name)
            if raw := next((form for form in RAW_FORMATS if form in choices), None):
                photo.set(name, raw)
        for name, setting in options.settings.items():
            if not photo.set(name, setting):
                raise CaptureError(f"{self._name}: has no setting {name} that can be written")

    def _first_picture(self, shutter: ShutterTime) -> Raw:
        """Take and read the first picture."""
        self._before_trigger(shutter.seconds)
        try:
            data = self._take_picture(shutter)
        except load_gphoto2().GPhoto2Error as error:
            raise CaptureError(
                f"{self._name}: takes no picture: {self._error_text(error)}"
            ) from error
        if data is None:
            raise CaptureError(f"{self._name}: took no picture. {self.advice}")
        try:
            return read_raw(data, "the first picture")
        except InputError as error:
            raise CaptureError(
                f"{self._name}: {error}. Set the camera to raw files alone, in its menu or by "
                "camera.options.settings"
            ) from error

    def _adopt_sensor(self, raw: Raw, times: list[ShutterTime]) -> None:
        """Replace the sensor's properties by those of the first picture and the camera's times."""
        if raw.bayer is None:
            raise CaptureError(
                f"{self._name}: its raw files have no colour mosaic of 2 x 2 pixels, such as RGGB; "
                "no other is supported"
            )
        selected = nearest_times(self.sensor.exposures, times)
        for exposure, time_ in zip(self.sensor.exposures, selected, strict=True):
            level = logging.INFO if abs(time_.seconds / exposure - 1) < 0.05 else logging.WARNING
            _log.log(
                level, "%s: takes %s (%g s) for an exposure of %g s",
                self._name, time_.name, time_.seconds, exposure,
            )  # fmt: skip
        bits = raw.white.bit_length()
        self.sensor = replace(
            self.sensor,
            exposures=tuple(time_.seconds for time_ in selected),
            bits=bits,
            bayer=raw.bayer,
            black_level_counts=round(raw.black),
            white_level_counts=None if raw.white == 2**bits - 1 else raw.white,
        )
        self._times = {time_.seconds: time_ for time_ in selected}

    def _release(self, handle: Photo) -> None:
        handle.close()
