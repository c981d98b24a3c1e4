"""How a Basler camera is set up for measuring: nothing adapts, nothing bends counts."""

from __future__ import annotations

import math
import re
import warnings
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.pylon_options import PylonOptions

__all__ = ["SOFTWARE", "CameraSetup", "load_pylon", "said"]

Value: TypeAlias = bool | int | float | str
"""Of a camera's setting."""

MICROSECONDS = 1e6

EXPOSURE_TOLERANCE = 1e-3
"""Fraction by which a camera may round an exposure time; the merge trusts the nominal ones."""

SETTING_TOLERANCE = 0.02
"""Fraction by which it may round another number, such as the gain."""

TRIGGER_MARGIN = 0.05
"""Of the least time between two triggers: one that comes too early is missed."""

SOFTWARE = "Software"
"""Source of triggers that this program gives."""

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
"""What must not adapt or bend counts, made where a camera has it."""

_BAYER_NAMES = {"RGGB": "BayerRG", "GRBG": "BayerGR", "GBRG": "BayerGB", "BGGR": "BayerBG"}


@dataclass(frozen=True)
class CameraSetup:
    """The settings of a camera, and how they are made.

    Parameters
    ----------
    sensor : CameraModel
        Its bits and mosaic choose the pixel format.
    options : PylonOptions
        Place and size of the frames, gain, and further settings (nodes), which are made last, and
        must exist.

    Raises
    ------
    InputError
        When no pixel format has the sensor's bits.
    """

    sensor: CameraModel
    options: PylonOptions

    def __post_init__(self) -> None:
        if self.sensor.bits not in (8, 10, 12, 16):
            raise InputError(
                f"sensor.bits is {self.sensor.bits}; a Basler camera has 8, 10, 12 or 16"
            )

    @property
    def pixel_format(self) -> str:
        """The driver's name of what the sensor delivers, such as BayerRG12."""
        bayer = self.sensor.bayer
        return f"{'Mono' if bayer is None else _BAYER_NAMES[bayer]}{self.sensor.bits}"

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return {
            "pixel_format": self.pixel_format,
            "offset": list(self.options.offset),
            "gain_db": self.options.gain_db,
            "nodes": dict(sorted(self.options.nodes.items())),
        }

    def apply(self, camera: Any) -> tuple[int, int]:
        """Make all settings but the exposure time.

        Parameters
        ----------
        camera : pypylon.pylon.InstantCamera
            Open, and not grabbing.

        Returns
        -------
        (int, int)
            The frames' height and width.

        Raises
        ------
        CaptureError
            When the camera refuses a setting: names it, and what the camera would take.
        """
        if _is_writable(camera.UserSetLoad):
            camera.UserSetSelector.Value = "Default"  # not what the last program left
            camera.UserSetLoad.Execute()
        for name, value in FIXED.items():
            if _is_writable(getattr(camera, name)):
                _set(camera, name, value)
        _set(camera, "PixelFormat", self.pixel_format)
        shape = self._set_region(camera)
        for selector in camera.TriggerSelector.Symbolics:
            _set(camera, "TriggerSelector", selector)
            _set(camera, "TriggerMode", "On" if selector == "FrameStart" else "Off")
        _set(camera, "TriggerSelector", "FrameStart")
        self.set_trigger(camera, SOFTWARE)
        self._set_gain(camera)
        for name, value in self.options.nodes.items():
            _set(camera, name, value)
        return shape

    def set_exposure(self, camera: Any, exposure: float) -> None:
        """Set the exposure time in seconds, and make sure that the camera took it.

        Raises
        ------
        CaptureError
            When it can't expose so long or so short, or rounds the time.
        """
        node = camera.ExposureTime
        if not _is_writable(node):  # of cameras before SFNC 2
            node = camera.ExposureTimeAbs
        wanted = exposure * MICROSECONDS
        if not node.Min <= wanted <= node.Max:
            raise CaptureError(
                f"camera: an exposure of {exposure:g} s is not in its range, "
                f"{node.Min / MICROSECONDS:g} to {node.Max / MICROSECONDS:g} s; change "
                "sensor.exposures"
            )
        node.Value = wanted
        if abs(node.Value - wanted) > EXPOSURE_TOLERANCE * wanted:
            raise CaptureError(
                f"camera: rounds an exposure of {exposure:g} s to {node.Value / MICROSECONDS:g} "
                "s; set sensor.exposures to what it can do"
            )

    def set_trigger(self, camera: Any, source: str) -> None:
        """Say what triggers a frame: `SOFTWARE`, or an input such as Line1, at its rising edge.

        Raises
        ------
        CaptureError
            When the camera refuses it: names what it would take.
        """
        _set(camera, "TriggerSource", source)
        if source != SOFTWARE and _is_writable(camera.TriggerActivation):
            _set(camera, "TriggerActivation", "RisingEdge")

    def seconds_between(self, exposure: float, camera: Any) -> float:
        """Return the least time from one trigger to the next."""
        between = exposure
        for name in ("ResultingFrameRate", "ResultingFrameRateAbs"):  # SFNC 2, and before
            with suppress(Exception):
                between = max(between, 1 / float(getattr(camera, name).Value))
                break
        return between * (1 + TRIGGER_MARGIN)

    def _set_region(self, camera: Any) -> tuple[int, int]:
        """Choose the part of the sensor."""
        offsets = dict(zip(("OffsetY", "OffsetX"), self.options.offset, strict=True))
        for name in offsets:
            if _is_writable(getattr(camera, name)):
                _set(camera, name, 0)  # or the extents are limited by the last offset
        height, width = self.options.shape or (int(camera.Height.Max), int(camera.Width.Max))
        _set(camera, "Height", height)
        _set(camera, "Width", width)
        for name, value in offsets.items():
            if value > 0:
                _set(camera, name, value)
        return height, width

    def _set_gain(self, camera: Any) -> None:
        if _is_writable(camera.Gain):
            _set(camera, "Gain", float(self.options.gain_db))
        elif self.options.gain_db == 0:
            _set(camera, "GainRaw", int(camera.GainRaw.Min))
        else:
            raise CaptureError(
                "camera: has no gain in decibels; set camera.gain_db to 0 and camera.nodes to "
                "{GainRaw: ...}"
            )


def load_pylon() -> tuple[Any, Any]:
    """Return the driver's modules ``pylon`` and ``genicam``, or raise CaptureError."""
    try:
        with warnings.catch_warnings():
            # its wrapper's types warn, and end the process where a warning is an error
            warnings.simplefilter("ignore", DeprecationWarning)
            from pypylon import genicam, pylon
    except ImportError as error:
        raise CaptureError(
            f"pypylon can't be loaded: {error}. Install it: pip install 'rfpipe[rig]'"
        ) from error
    return pylon, genicam


def said(error: Exception) -> str:
    """Return an error of the driver without the names of its source files."""
    return re.split(r" : \w+ thrown", str(error))[0].strip().rstrip(".")


def _is_writable(node: Any) -> bool:
    return bool(load_pylon()[1].IsWritable(node))


def _set(camera: Any, name: str, value: Value) -> None:
    """Make one setting, or say what the camera has against it."""
    node = getattr(camera, name)
    try:
        node.Value = value
        taken = node.Value
    except (load_pylon()[1].GenericException, TypeError) as error:
        raise CaptureError(
            f"camera: refuses {name} = {value}: {said(error)}{_choices(node)}"
        ) from error
    if isinstance(value, float) and math.isclose(
        taken, value, rel_tol=SETTING_TOLERANCE, abs_tol=1e-6
    ):
        return
    if taken != value:
        raise CaptureError(f"camera: takes {name} = {taken} where {value} was asked for")


def _choices(node: Any) -> str:
    """Return what a node would take, for an error message."""
    with suppress(Exception):
        return f". It takes {', '.join(node.Symbolics)}"
    with suppress(Exception):
        return f". It takes {node.Min} to {node.Max} in steps of {node.Inc}"
    return ""
