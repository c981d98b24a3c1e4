"""What the drivers of cameras may be told, where they may be told the same."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rfpipe.config.base import Settings

__all__ = [
    "BAYER_NAMES",
    "GenicamOptions",
    "Offset",
    "PictureExtent",
    "PixelFormat",
    "ReconnectSeconds",
    "Reconnects",
    "Retries",
    "TimeoutSeconds",
]  # fmt: skip

PixelFormat = Literal[
    "Mono8", "Mono10", "Mono12", "Mono16",
    "BayerRG8", "BayerRG10", "BayerRG12", "BayerRG16",
    "BayerGR8", "BayerGR10", "BayerGR12", "BayerGR16",
    "BayerGB8", "BayerGB10", "BayerGB12", "BayerGB16",
    "BayerBG8", "BayerBG10", "BayerBG12", "BayerBG16",
]  # fmt: skip
"""Formats of GenICam (PFNC) that measure: not packed, not made into colours by the camera."""

BAYER_NAMES = {"RGGB": "BayerRG", "GRBG": "BayerGR", "GBRG": "BayerGB", "BGGR": "BayerBG"}
"""What GenICam calls each colour mosaic."""

Offset = Annotated[int, Field(ge=0, le=32768)]
PictureExtent = Annotated[int, Field(ge=1, le=32768)]

TimeoutSeconds = Annotated[
    float,
    Field(
        gt=0,
        le=600,
        description="Seconds until a frame counts as lost, beyond its exposure time; above 0, at "
        "most 600.",
    ),
]
Retries = Annotated[
    int, Field(ge=0, le=100, description="How often a failed frame is taken again, 0 to 100.")
]
Reconnects = Annotated[
    int, Field(ge=0, le=1000, description="How often a lost camera is looked for, 0 to 1000.")
]
ReconnectSeconds = Annotated[
    float,
    Field(ge=0, le=600, description="Wait before each of these attempts in seconds, 0 to 600."),
]


class GenicamOptions(Settings):
    """A camera of the GenICam standard."""

    SAID_ELSEWHERE: ClassVar[frozenset[str]] = frozenset({"pixel_format"})  # by the sensor

    serial: str | None = Field(
        None, min_length=1, description="Serial number, or null for the only camera connected."
    )
    pixel_format: PixelFormat = Field(
        "Mono12",
        description="Mono8, Mono10, Mono12 or Mono16, or one of a colour mosaic: BayerRG, "
        "BayerGR, BayerGB or BayerBG with 8, 10, 12 or 16 bits. sensor.bits and sensor.bayer say "
        "the same.",
    )
    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None, description="Height and width of the frames in pixels, or null for the whole sensor."
    )
    offset: tuple[Offset, Offset] = Field(
        (0, 0),
        description="Place of the frames on the sensor: rows from its upper edge, columns from "
        "its left edge.",
    )
    gain_db: float = Field(
        0.0, ge=0, le=48, description="Gain in decibels, fixed, 0 to 48; 0 has the least noise."
    )
    timeout_seconds: TimeoutSeconds = 2.0
    retries: Retries = 3
    reconnects: Reconnects = 5
    reconnect_seconds: ReconnectSeconds = 2.0
    nodes: dict[str, bool | int | float | str] = Field(
        default_factory=dict,
        description="Further settings of the camera, as its manual names them, such as "
        "{SensorReadoutMode: Fast}.",
    )
    sequence_line: str | None = Field(
        None,
        min_length=1,
        description="Input at which a projector with sequences triggers the camera, as its manual "
        "names it, such as Line1; null where there is no such projector.",
    )

    @property
    def bits(self) -> int:
        """Bits of the pixel format."""
        return int(self.pixel_format.removeprefix("Mono").removeprefix("Bayer").lstrip("RGB"))

    @property
    def bayer(self) -> str | None:
        """Colour mosaic of the pixel format, None for grey."""
        family = self.pixel_format.rstrip("0123456789")
        return next((mosaic for mosaic, name in BAYER_NAMES.items() if name == family), None)

    @property
    def channels(self) -> int:
        """Colour channels of merged images: 1, or 3 of a colour mosaic."""
        return 1 if self.bayer is None else 3
