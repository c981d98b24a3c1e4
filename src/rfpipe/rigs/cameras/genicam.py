"""How a camera of the GenICam standard is set up for measuring, through whatever library."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.cameras.options import BAYER_NAMES, GenicamOptions

__all__ = [
    "SOFTWARE",
    "CameraSetup",
    "Nodes",
    "RefusedError",
    "Value",
    "frame_rate",
    "seconds_between",
]

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

FRAME_RATES = "ResultingFrameRate", "ResultingFrameRateAbs", "AcquisitionResultingFrameRate"
"""Names that makers give the frames a second that the camera takes as it is set up."""

SET_FRAME_RATE = "AcquisitionFrameRate"

NO_BOUND = 1e6
"""Frames a second that no camera takes: its makers gave no bound."""

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


class RefusedError(CaptureError):
    """A camera doesn't take a setting: as it can't, or as it is gone."""


class Nodes(Protocol):
    """A camera's settings by name, as a library of GenICam reaches them."""

    def is_writable(self, name: str) -> bool:
        """Tell whether the camera has the setting, and takes values for it now."""

    def write(self, name: str, value: Value) -> Value:
        """Give a setting a value, and return what the camera took; RefusedError if it doesn't."""

    def execute(self, name: str) -> None:
        """Have the camera do what a command says."""

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the least and the largest value of a number."""

    def choices(self, name: str) -> tuple[str, ...]:
        """Return the values of an enumeration."""

    def number(self, name: str) -> float | None:
        """Return a number; None where the camera doesn't tell it."""


@dataclass(frozen=True)
class CameraSetup:
    """The settings of a camera, and how they are made.

    Parameters
    ----------
    sensor : CameraModel
        Its bits and mosaic choose the pixel format.
    options : GenicamOptions
        Place and size of the frames, gain, and further settings (nodes), which are made last, and
        must exist.

    Raises
    ------
    InputError
        When no pixel format has the sensor's bits.
    """

    sensor: CameraModel
    options: GenicamOptions

    def __post_init__(self) -> None:
        if self.sensor.bits not in (8, 10, 12, 16):
            raise InputError(
                f"sensor.bits is {self.sensor.bits}; a GenICam camera has 8, 10, 12 or 16"
            )

    @property
    def pixel_format(self) -> str:
        """The standard's name of what the sensor delivers, such as BayerRG12."""
        bayer = self.sensor.bayer
        return f"{'Mono' if bayer is None else BAYER_NAMES[bayer]}{self.sensor.bits}"

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return {
            "pixel_format": self.pixel_format,
            "offset": list(self.options.offset),
            "gain_db": self.options.gain_db,
            "nodes": dict(sorted(self.options.nodes.items())),
        }

    def apply(self, nodes: Nodes) -> tuple[int, int]:
        """Make all settings but the exposure time.

        Parameters
        ----------
        nodes : Nodes
            Of a camera that is open, and not grabbing.

        Returns
        -------
        (int, int)
            The frames' height and width.

        Raises
        ------
        CaptureError
            When the camera refuses a setting: names it, and what the camera would take.
        """
        if nodes.is_writable("UserSetLoad"):
            _set(nodes, "UserSetSelector", "Default")  # not what the last program left
            nodes.execute("UserSetLoad")
        for name, value in FIXED.items():
            if nodes.is_writable(name):
                _set(nodes, name, value)
        _set(nodes, "PixelFormat", self.pixel_format)
        shape = self._set_region(nodes)
        for selector in nodes.choices("TriggerSelector"):
            _set(nodes, "TriggerSelector", selector)
            _set(nodes, "TriggerMode", "On" if selector == "FrameStart" else "Off")
        _set(nodes, "TriggerSelector", "FrameStart")
        _set(nodes, "TriggerMode", "On")  # where a camera has one for all selectors
        self.set_trigger(nodes, SOFTWARE)
        self._set_gain(nodes)
        for name, value in self.options.nodes.items():
            _set(nodes, name, value)
        return shape

    def set_exposure(self, nodes: Nodes, exposure: float) -> None:
        """Set the exposure time in seconds, and make sure that the camera took it.

        Raises
        ------
        CaptureError
            When it can't expose so long or so short, or rounds the time.
        """
        # cameras before SFNC 2 have the other name
        name = "ExposureTime" if nodes.is_writable("ExposureTime") else "ExposureTimeAbs"
        wanted = exposure * MICROSECONDS
        least, largest = nodes.bounds(name)
        if not least <= wanted <= largest:
            raise CaptureError(
                f"camera: an exposure of {exposure:g} s is not in its range, "
                f"{least / MICROSECONDS:g} to {largest / MICROSECONDS:g} s; change "
                "sensor.exposures"
            )
        taken = float(nodes.write(name, wanted))
        if abs(taken - wanted) > EXPOSURE_TOLERANCE * wanted:
            raise CaptureError(
                f"camera: rounds an exposure of {exposure:g} s to {taken / MICROSECONDS:g} "
                "s; set sensor.exposures to what it can do"
            )

    def set_trigger(self, nodes: Nodes, source: str) -> None:
        """Say what triggers a frame: `SOFTWARE`, or an input such as Line1, at its rising edge.

        Raises
        ------
        CaptureError
            When the camera refuses it: names what it would take.
        """
        _set(nodes, "TriggerSource", source)
        if source != SOFTWARE and nodes.is_writable("TriggerActivation"):
            _set(nodes, "TriggerActivation", "RisingEdge")

    def _set_region(self, nodes: Nodes) -> tuple[int, int]:
        """Choose the part of the sensor."""
        offsets = dict(zip(("OffsetY", "OffsetX"), self.options.offset, strict=True))
        for name in offsets:
            if nodes.is_writable(name):
                _set(nodes, name, 0)  # or the extents are limited by the last offset
        largest = tuple(int(nodes.bounds(name)[1]) for name in ("Height", "Width"))
        height, width = self.options.shape or largest
        _set(nodes, "Height", height)
        _set(nodes, "Width", width)
        for name, value in offsets.items():
            if value > 0:
                _set(nodes, name, value)
        return height, width

    def _set_gain(self, nodes: Nodes) -> None:
        if nodes.is_writable("Gain"):
            _set(nodes, "Gain", float(self.options.gain_db))
        elif self.options.gain_db == 0:
            _set(nodes, "GainRaw", int(nodes.bounds("GainRaw")[0]))
        else:
            raise CaptureError(
                "camera: has no gain in decibels; set camera.gain_db to 0 and camera.nodes to "
                "{GainRaw: ...}"
            )


def frame_rate(nodes: Nodes) -> float | None:
    """Return how many frames a second a camera takes as it is set up; None: it doesn't tell."""
    rates = (nodes.number(name) for name in FRAME_RATES)
    if (rate := next((rate for rate in rates if rate), None)) is not None:
        return rate
    if nodes.number(SET_FRAME_RATE) is None:
        return None
    _, largest = nodes.bounds(SET_FRAME_RATE)  # what could be set, as size and format are
    return largest if 0 < largest < NO_BOUND else None


def seconds_between(exposure: float, frame_rate: float | None) -> float:
    """Return the least time from one trigger to the next, of a camera that tells its frame rate."""
    between = exposure if not frame_rate else max(exposure, 1 / frame_rate)
    return between * (1 + TRIGGER_MARGIN)


def _set(nodes: Nodes, name: str, value: Value) -> None:
    """Make one setting, and compare what the camera took."""
    taken = nodes.write(name, value)
    if isinstance(value, float) and math.isclose(
        float(taken), value, rel_tol=SETTING_TOLERANCE, abs_tol=1e-6
    ):
        return
    if taken != value:
        raise CaptureError(f"camera: takes {name} = {taken} where {value} was asked for")
