"""What a Basler camera may be told."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rfpipe.config.base import Settings

__all__ = ["PixelFormat", "PylonOptions"]

PixelFormat = Literal[
    "Mono8", "Mono10", "Mono12", "Mono16",
    "BayerRG8", "BayerRG10", "BayerRG12", "BayerRG16",
    "BayerGR8", "BayerGR10", "BayerGR12", "BayerGR16",
    "BayerGB8", "BayerGB10", "BayerGB12", "BayerGB16",
    "BayerBG8", "BayerBG10", "BayerBG12", "BayerBG16",
]  # fmt: skip
Offset = Annotated[int, Field(ge=0, le=32768)]
PictureExtent = Annotated[int, Field(ge=1, le=32768)]

_MOSAICS = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}


class PylonOptions(Settings):
    """A Basler camera."""

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
    timeout_seconds: float = Field(
        2.0,
        gt=0,
        le=600,
        description="Seconds until a frame counts as lost, beyond its exposure time; above 0, at "
        "most 600.",
    )
    retries: int = Field(
        3, ge=0, le=100, description="How often a failed frame is taken again, 0 to 100."
    )
    reconnects: int = Field(
        5, ge=0, le=1000, description="How often a lost camera is looked for, 0 to 1000."
    )
    reconnect_seconds: float = Field(
        2.0, ge=0, le=600, description="Wait before each of these attempts in seconds, 0 to 600."
    )
    sequence_line: str | None = Field(
        None,
        min_length=1,
        description="Input at which a projector with sequences triggers the camera, as its manual "
        "names it, such as Line1; null where there is no such projector.",
    )
    nodes: dict[str, bool | int | float | str] = Field(
        default_factory=dict,
        description="Further settings of the camera, as its manual names them, such as "
        "{SensorReadoutMode: Fast}.",
    )

    @property
    def bits(self) -> int:
        """Bits of the pixel format."""
        return int(self.pixel_format.removeprefix("Mono").removeprefix("Bayer").lstrip("RGB"))

    @property
    def bayer(self) -> str | None:
        """Colour mosaic of the pixel format, None for grey."""
        if self.pixel_format.startswith("Mono"):
            return None
        return _MOSAICS[self.pixel_format.removeprefix("Bayer")[:2]]
