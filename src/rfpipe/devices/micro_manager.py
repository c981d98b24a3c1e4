"""Cameras and projectors of Micro-Manager's catalogue, through its library MMCore.

Each device has an MMCore of its own, loaded with one adapter or with a configuration file. Tested
with Micro-Manager's demo camera and with a projector in software, but not with physical devices.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rfpipe.array_types import Counts, Float
from rfpipe.config.base import Settings, Text
from rfpipe.devices.bracket import BracketCamera, RegionOptions, load_library
from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.provenance import fingerprint
from rfpipe.rigs.devices import WEIGHT_STEPS, Closing, check_picture, code_table

Value = bool | int | float | str
"""Value of a device's property."""

FAULTS = RuntimeError, ValueError, OSError
"""Exceptions into which pymmcore converts errors of MMCore."""

Role = Literal["Camera", "SLM"]
"""Role of a device in MMCore; its projectors are spatial light modulators."""


class AdapterOptions(Settings):
    """A device of Micro-Manager's catalogue."""

    adapters: Text = Field(
        description="Folder of Micro-Manager's device adapters, the files libmmgr_dal_*."
    )
    config: Text | None = Field(
        None,
        description="Configuration file of Micro-Manager (.cfg) with this device and those that it "
        "needs, such as a serial port; or null, to load library and device.",
    )
    library: Text | None = Field(
        None, description="Adapter of the device, such as DemoCamera; null with a configuration."
    )
    device: Text | None = Field(
        None,
        description="Name of the device in its adapter, such as DCam; or its label in the "
        "configuration, null for the camera or SLM that the configuration selects.",
    )
    properties: dict[str, Value] = Field(
        default_factory=dict,
        description="Properties of the device, as Micro-Manager's property browser names them, "
        'such as {PixelType: 16bit, BitDepth: 12}; quote "On" and "Off".',
    )

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        """Check that the device comes from an adapter, or from a configuration."""
        if (self.config is None) == (self.library is None) or (self.library and not self.device):
            raise ValueError("library and device should be set, or config")
        return self


class MicroManagerCameraOptions(AdapterOptions, RegionOptions):
    """A camera of Micro-Manager's catalogue."""


class MicroManagerProjectorOptions(AdapterOptions):
    """A projector (SLM) of Micro-Manager's catalogue."""

    exposure_seconds: float | None = Field(
        None,
        gt=0,
        description="Seconds for which a projector with a lamp of its own shows a picture; null "
        "leaves its setting. Longer than a bracket.",
    )
    settle_seconds: float = Field(
        0.1, ge=0, le=60, description="Wait after displaying a picture, in seconds."
    )


class MicroManagerCamera(BracketCamera):
    """A camera of Micro-Manager's catalogue, triggered frame by frame.

    `MicroManagerCameraOptions` lists the options. CaptureError where MMCore or an adapter is
    missing, or the camera refuses a setting or counts other than `sensor` states.
    """

    kind = "micro_manager"
    Options = MicroManagerCameraOptions
    faults = FAULTS

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        super().__init__(sensor, **options)
        self.channels = 1 if sensor.bayer is None else 3
        self.shape = self._open()

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        region = {"offset": list(self._options.offset)}
        return super().describe() | region | described(self._options)

    def _open(self) -> tuple[int, int]:
        self._handle, label = loaded_core(self._options, "Camera")
        self._name = f"camera {label}"
        try:
            self._set_region()
            bits, bytes_per_pixel = self._handle.getImageBitDepth(), self._handle.getBytesPerPixel()
            if bits != self.sensor.bits or bytes_per_pixel > 2:
                raise CaptureError(
                    f"{self._name}: gives {bits} bits in {bytes_per_pixel} bytes per pixel; "
                    f"expected grey or raw counts of {self.sensor.bits} bits: set sensor.bits, or "
                    "the camera's pixel type in camera.options.properties"
                )
            return self._handle.getImageHeight(), self._handle.getImageWidth()
        except FAULTS as error:
            self._disconnect()
            raise CaptureError(f"{self._name}: {self._error_text(error)}") from error
        except CaptureError:
            self._disconnect()
            raise

    def _set_region(self) -> None:
        """Set the region of the sensor, and verify it."""
        core = self._handle
        core.clearROI()
        sensor = core.getImageHeight(), core.getImageWidth()
        height, width = self._options.shape or sensor
        top, left = self._options.offset
        region = [left, top, width, height]
        if core.getROI() != region:
            core.setROI(*region)
        if core.getROI() != region or top + height > sensor[0] or left + width > sensor[1]:
            raise CaptureError(
                f"{self._name}: can't read {height} x {width} pixels at {top}, {left}; the sensor "
                f"has {sensor[0]} x {sensor[1]}: change camera.options.shape and offset"
            )

    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        core, nominal = self._handle, 1000 * exposure
        if core.getExposure() != nominal:
            core.setExposure(nominal)
        actual = core.getExposure()
        if abs(actual - nominal) > 1e-3 * nominal:  # the merge uses the nominal times
            raise CaptureError(
                f"{self._name}: uses {actual / 1000:g} s for an exposure of {exposure:g} s; set "
                "sensor.exposures to a time that it supports"
            )
        self._before_trigger(exposure)
        core.snapImage()
        return core.getImage().astype(np.uint16), ""

    def _release(self, handle: Any) -> None:
        with suppress(*FAULTS):
            handle.unloadAllDevices()


class MicroManagerProjector(Closing):
    """A projector (SLM) of Micro-Manager's catalogue, with 8 bits of grey.

    `MicroManagerProjectorOptions` lists the options; `response` is the light measured at each code,
    see `code_table`. CaptureError where MMCore or an adapter is missing, or the projector fails.
    """

    Options = MicroManagerProjectorOptions

    def __init__(self, response: NDArray[Any] | None = None, **options: Any) -> None:
        self._options = MicroManagerProjectorOptions(**options)
        self._codes = code_table(response)
        self.settle_seconds = self._options.settle_seconds
        self._lock = threading.Lock()
        self._core, self._label = loaded_core(self._options, "SLM")
        try:
            self.shape = self._core.getSLMHeight(self._label), self._core.getSLMWidth(self._label)
            self._is_grey = self._core.getSLMBytesPerPixel(self._label) == 1
            if self._options.exposure_seconds is not None:
                self._core.setSLMExposure(self._label, 1000 * self._options.exposure_seconds)
        except FAULTS as error:
            self.close()
            raise CaptureError(f"projector {self._label}: {error}") from error

    def show(self, picture: Float) -> None:
        """Show a picture; see `rfpipe.rigs.devices.Projector.show`."""
        self.show_now(picture)
        time.sleep(self.settle_seconds)

    def show_now(self, picture: Float) -> None:
        """Show a picture without waiting for its light; see `rfpipe.rigs.devices.Projector`."""
        weights = check_picture(picture, self.shape)
        codes = self._codes[np.rint(weights * np.float32(WEIGHT_STEPS)).astype(np.uint16)]
        pixels = codes if self._is_grey else codes[..., None].repeat(3, axis=2)
        with self._lock:
            if self._core is None:
                raise CaptureError("the projector is closed; open it again")
            try:
                self._core.setSLMImage(self._label, pixels)
                self._core.displaySLMImage(self._label)
                self._core.waitForDevice(self._label)
            except FAULTS as error:
                raise CaptureError(
                    f"projector {self._label}: {error}. Check its power and cable"
                ) from error

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the light."""
        return {
            "kind": "micro_manager",
            "shape": list(self.shape),
            "exposure_seconds": self._options.exposure_seconds,
            "codes": fingerprint(self._codes),
            **described(self._options),
        }

    def close(self) -> None:
        """Close the projector; closing twice is no error."""
        with self._lock:
            core, self._core = self._core, None
        if core is not None:
            with suppress(*FAULTS):
                core.unloadAllDevices()


def loaded_core(options: AdapterOptions, role: Role) -> tuple[Any, str]:
    """Load a device into a new MMCore; return the core and the device's label.

    CaptureError where MMCore is missing, or the device can't be loaded or refuses a property.
    """
    core = load_library("pymmcore", "micromanager").CMMCore()
    core.setDeviceAdapterSearchPaths([options.adapters])
    label = options.device or ""
    try:
        if options.config is None:
            core.loadDevice(label, options.library, label)
            core.initializeDevice(label)
        else:
            core.loadSystemConfiguration(options.config)
            label = label or getattr(core, f"get{role}Device")()
        getattr(core, f"set{role}Device")(label)
    except FAULTS as error:
        core.unloadAllDevices()
        raise CaptureError(
            f"{options.config or options.library}: {label or role} can't be loaded: {error}. Check "
            f"that the adapters in {options.adapters} fit pymmcore ({core.getAPIVersionInfo()}), "
            "and that no other program uses the device"
        ) from error
    for name, value in options.properties.items():
        try:
            core.setProperty(label, name, str(value))
        except FAULTS as error:
            names = core.getDevicePropertyNames(label)
            valid = core.getAllowedPropertyValues(label, name) if name in names else names
            core.unloadAllDevices()
            raise CaptureError(
                f"{label}: refuses {name} = {value}. Valid: {', '.join(valid) or error}"
            ) from error
    return core, label


def described(options: AdapterOptions) -> dict[str, Any]:
    """Plain data for descriptions: the device, its properties, and the configuration's digest."""
    text = Path(options.config).read_text(encoding="utf-8") if options.config else None
    return {
        "library": options.library,
        "device": options.device,
        "config": None if text is None else fingerprint(text),
        "properties": dict(sorted(options.properties.items())),
    }
