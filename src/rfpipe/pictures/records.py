"""Records of a picture: its header, its pixels, and its place in a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Encoding = Literal["srgb", "linear", "other"]
"""Relation of a file's numbers to light: sRGB's curve, proportional, or another curve."""


@dataclass(frozen=True)
class Header:
    """Properties of a picture, without its pixels.

    Attributes
    ----------
    size : (int, int)
        Height and width in pixels.
    channels : int
        1, or 3 for R, G and B. Alpha is not counted.
    kind : str
        ``counts`` (integers) or ``light`` (floats).
    exposure_s : float or None
        Exposure time in seconds.
    iso : float or None
        Sensitivity, as ISO 12232 has it.
    f_number : float or None
        Focal length over the diameter of the aperture.
    encoding : {"srgb", "linear", "other"} or None
        Transfer curve according to the format, the colour profile or Exif; None when none of these
        states it.
    mosaic : str or None
        Colour mosaic of a raw file, from the upper left corner: ``RGGB``, ``X-Trans``, or the
        letters of another mosaic. None for pictures without one.
    orientation : int
        Orientation of TIFF 6.0 and Exif, 1 to 8, that is not applied to the pixels; 1 is upright.
    """

    size: tuple[int, int]
    channels: int
    kind: str
    exposure_s: float | None = None
    iso: float | None = None
    f_number: float | None = None
    encoding: Encoding | None = None
    mosaic: str | None = None
    orientation: int = 1

    def matches(self, header: Header) -> bool:
        """Test whether size, channels, kind and mosaic are those of another header."""
        names = ("size", "channels", "kind", "mosaic")
        return all(getattr(self, name) == getattr(header, name) for name in names)


@dataclass(frozen=True)
class Picture:
    """A picture.

    Attributes
    ----------
    header : Header
    pixels : ndarray of uint16, uint32 or float32, shape (H, W, channels)
        Counts as stored in the file (uint32 when the file has 32 bits), or light.
    white : int
        Full scale of counts, the maximum of the file's type, such as 255 or 32,767; 1 of light.
    """

    header: Header
    pixels: NDArray[Any]
    white: int

    @property
    def bits(self) -> int:
        """Number of bits of full scale, such as 8 or 16; 32 of light."""
        return 32 if self.header.kind == "light" else self.white.bit_length()

    @property
    def fractions(self) -> NDArray[np.float32]:
        """Counts over full scale, or light as stored; float32, shape (H, W, channels)."""
        if self.header.kind == "light":
            return self.pixels
        kind = np.float32 if self.white < 2**24 else np.float64  # exact for all counts
        return np.asarray(np.divide(self.pixels, self.white, dtype=kind), np.float32)


class Part(NamedTuple):
    """A picture in a file.

    Attributes
    ----------
    file : Path
    name : str
        The part's name or number; the file's name where the file holds one picture.
    header : Header
    read : callable
        Returns the Picture, or raises InputError.
    """

    file: Path
    name: str
    header: Header
    read: Callable[[], Picture]

    def __str__(self) -> str:
        return f"{self.file}" + (f", part {self.name}" if self.name != self.file.name else "")
