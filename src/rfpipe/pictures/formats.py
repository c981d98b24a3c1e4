"""Readers: one function a format, from a stored picture to its header and the correction of pixels.

A reader raises InputError for pictures that rfpipe can't turn into light.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.pictures.openimage import (
    Correction,
    Stored,
    header_of,
    profile_encoding,
    unchanged,
)
from rfpipe.pictures.records import Encoding, Header

__all__ = ["READERS", "Reading", "read_plain"]

_MIN_IS_WHITE, _RGB, _PALETTE, _YCBCR = 0, 2, 3, 6  # TIFF 6.0, PhotometricInterpretation
_CICP_LINEAR, _CICP_SRGB = 8, 13  # ITU-T H.273, TransferCharacteristics
_LONGEST_LINE, _MOST_LINES = 4096, 1000


class Reading(NamedTuple):
    """A picture's header, the correction of its stored samples, and full scale after it."""

    header: Header
    white: int
    correct: Correction = unchanged


def read_plain(stored: Stored) -> Reading:
    """Read a format whose samples need no correction: PFM, TGA, BMP and others."""
    return Reading(header_of(stored, profile_encoding(stored)), stored.white)


def read_pnm(stored: Stored) -> Reading:
    """Read PGM or PPM of any full scale, which OpenImageIO stretches to 8 or 16 bits; or PFM."""
    with stored.path.open("rb") as file:
        tokens = re.sub(rb"#[^\n]*", b"", file.read(_LONGEST_LINE)).split(maxsplit=4)
    if tokens[0] not in (b"P2", b"P3", b"P5", b"P6"):
        return read_plain(stored)
    white, stretched = int(tokens[3]), stored.white

    def restore(pixels: NDArray[Any]) -> NDArray[Any]:
        counts = -(-pixels.astype(np.int64) * white // stretched)  # it rounds down, this rounds up
        return counts.astype(pixels.dtype)

    return Reading(header_of(stored, None), white, restore)


def read_jpeg(stored: Stored) -> Reading:
    """Read JPEG, GIF or WebP: sRGB unless a profile states another curve. CMYK is refused."""
    if (colors := stored.attribute("jpeg:ColorSpace")) is not None and colors != "YCbCr":
        raise InputError(f"{stored.path}: holds {colors} colours; expected gray or R, G and B")
    return Reading(header_of(stored, profile_encoding(stored) or "srgb"), stored.white)


def read_png(stored: Stored) -> Reading:
    """Read PNG: its curve is that of a profile, of Exif, or of the chunks sRGB, cICP and gAMA."""
    chunks = dict(_png_chunks(stored.path))
    if b"acTL" in chunks:
        (count,) = struct.unpack_from(">I", chunks[b"acTL"])
        if count > 1:
            raise InputError(
                f"{stored.path}: holds {count} pictures, an animation; expected one picture "
                "per file"
            )
    encoding = profile_encoding(stored)
    if b"cICP" in chunks:
        curves: dict[int, Encoding] = {_CICP_LINEAR: "linear", _CICP_SRGB: "srgb"}
        encoding = curves.get(chunks[b"cICP"][1], "other")
    elif encoding is None and b"sRGB" in chunks:
        encoding = "srgb"
    elif encoding is None and b"gAMA" in chunks:
        gamma = struct.unpack(">I", chunks[b"gAMA"])[0] / 100_000
        is_linear, is_srgb = abs(gamma - 1) < 0.01, abs(gamma - 1 / 2.2) < 0.01
        encoding = "linear" if is_linear else "srgb" if is_srgb else "other"
    return Reading(header_of(stored, encoding), stored.white)


def _png_chunks(path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Yield type and data of the small chunks before a PNG file's pixels.

    OpenImageIO doesn't distinguish a file that states sRGB from one that states nothing.
    """
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8 and head[4:] != b"IDAT":
            length = int.from_bytes(head[:4], "big")
            if length <= 8:
                yield head[4:], file.read(length)
            else:
                file.seek(length, 1)
            file.seek(4, 1)  # checksum


def read_tiff(stored: Stored) -> Reading:
    """Read TIFF: MinIsWhite is inverted, and 9 to 15 bits are not stretched to 16.

    Colours that are neither gray nor R, G and B are refused.
    """
    photometric = int(stored.number("tiff:PhotometricInterpretation") or 0)
    is_color = photometric in (_RGB, _PALETTE, _YCBCR)
    if (space := stored.attribute("tiff:ColorSpace")) in ("CMYK", "CIELAB", "ICCLAB", "ITULAB"):
        raise InputError(f"{stored.path}: holds {space} colours; expected gray or R, G and B")
    if stored.spec.nchannels == 4 and not is_color:
        raise InputError(
            f"{stored.path}: has 4 bands, not R, G, B and alpha; expected one, or R, G and B",
            remedy="Save the bands that you mean as a picture",
        )
    header = header_of(stored, profile_encoding(stored))
    bits = int(stored.number("oiio:BitsPerSample") or 0)
    is_packed = str(stored.spec.format) == "uint16" and 8 < bits < 16
    shift, white = (16 - bits, 2**bits - 1) if is_packed else (0, stored.white)
    # OpenImageIO inverts unsigned samples of up to 8 bits
    is_inverted = photometric == _MIN_IS_WHITE and str(stored.spec.format) != "uint8"
    if not is_inverted:
        return Reading(header, white, lambda pixels: pixels >> shift if shift else pixels)
    if stored.is_light:
        raise InputError(
            f"{stored.path}: holds floats whose 0 is white (MinIsWhite), and does not say what is "
            "black",
            remedy="Save it as MinIsBlack",
        )

    def invert(pixels: NDArray[Any]) -> NDArray[Any]:
        return (white - (pixels.astype(np.int64) >> shift)).astype(pixels.dtype)

    return Reading(header, white, invert)


def read_exr(stored: Stored) -> Reading:
    """Read EXR: pixels are placed in the display window, padded by 0, and cropped to it."""
    spec = stored.spec
    size = (spec.full_height, spec.full_width)
    row_offset, column_offset = spec.y - spec.full_y, spec.x - spec.full_x
    header = header_of(stored, None if not stored.is_light else "linear", size)
    if (row_offset, column_offset, *size) == (0, 0, spec.height, spec.width):
        return Reading(header, stored.white)
    rows = slice(max(row_offset, 0), min(row_offset + spec.height, size[0]))
    columns = slice(max(column_offset, 0), min(column_offset + spec.width, size[1]))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        raise InputError(
            f"{stored.path}: has no pixel within its display window, {size[0]} x {size[1]}: its "
            f"data begin {row_offset} pixels below and {column_offset} right of its corner",
            remedy="Save it again",
        )

    def place(pixels: NDArray[Any]) -> NDArray[Any]:
        placed = np.zeros((*size, pixels.shape[-1]), pixels.dtype)
        inside = pixels[rows.start - row_offset : rows.stop - row_offset]
        placed[rows, columns] = inside[
            :, columns.start - column_offset : columns.stop - column_offset
        ]
        return placed

    return Reading(header, stored.white, place)


def read_hdr(stored: Stored) -> Reading:
    """Read Radiance RGBE: any order of rows and columns; EXPOSURE and COLORCORR are divided out.

    Both may stand in a header repeatedly and multiply (Ward, The Radiance picture file format).
    OpenImageIO 3.2 has the last EXPOSURE only, no COLORCORR, and two of eight orders exchanged.
    """
    factor = np.ones(3)
    lines = _radiance_lines(stored.path)
    for line in lines:
        name, _, text = line.partition("=")
        if name in ("EXPOSURE", "COLORCORR"):
            factor *= _factors(stored.path, line, text, 1 if name == "EXPOSURE" else 3)
    order = lines[-1].split()  # such as -Y 512 +X 1024: the slower axis first
    height, width = stored.spec.height, stored.spec.width
    if len(order) != 4 or {order[0][1:], order[2][1:]} != {"X", "Y"}:
        raise InputError(f"{stored.path}: has the order {lines[-1]!r}; expected -Y rows +X columns")
    if order[0][1:] == "X":
        height, width = width, height
    header = header_of(stored, "linear", (height, width))
    return Reading(
        header, stored.white, partial(_radiance, order=(order[0], order[2]), factor=factor)
    )


def _radiance_lines(path: Path) -> list[str]:
    """Return the header's lines of a Radiance file, the last of which has order and size."""
    lines = list[str]()
    with path.open("rb") as file:
        for _ in range(_MOST_LINES):
            line = file.readline(_LONGEST_LINE).decode("latin-1").rstrip("\r\n")
            if not line:
                return [*lines, file.readline(_LONGEST_LINE).decode("latin-1").strip()]
            lines.append(line)
    raise InputError(f"{path}: has no end of its Radiance header; it is damaged")


def _factors(path: Path, line: str, text: str, count: int) -> NDArray[np.float64]:
    """Return the positive numbers of a header's line."""
    try:
        values = np.array(text.split(), np.float64)
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not (np.isfinite(values) & (values > 0)).all():
        raise InputError(f"{path}: has the line {line!r}; expected {count} positive numbers")
    return values


def _radiance(
    pixels: NDArray[Any], order: tuple[str, str], factor: NDArray[np.float64]
) -> NDArray[Any]:
    """Put pixels upright, and divide by the factors that they were multiplied by."""
    if order[0][1:] == "X":
        pixels = np.swapaxes(pixels, 0, 1)
    if "+Y" in order:
        pixels = pixels[::-1]
    if "-X" in order:
        pixels = pixels[:, ::-1]
    return pixels / factor.astype(np.float32)


READERS: dict[str, Callable[[Stored], Reading]] = {
    "gif": read_jpeg,
    "hdr": read_hdr,
    "jpeg": read_jpeg,
    "openexr": read_exr,
    "png": read_png,
    "pnm": read_pnm,
    "tiff": read_tiff,
    "webp": read_jpeg,
}
"""Readers by OpenImageIO's names of the formats; `read_plain` for all others."""
