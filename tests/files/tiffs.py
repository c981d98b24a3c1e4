"""TIFF files that OpenImageIO doesn't write: any photometry, extra samples, tags and pages."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["tiff_bytes"]

_BYTE, _ASCII, _SHORT, _LONG, _UNDEFINED, _SRATIONAL = 1, 2, 3, 4, 7, 10
_RATIONAL = 5
_FORMATS = {"u": 1, "i": 2, "f": 3}
_EXIF = 34665
_SIGNED = (37377, 37379, 37380)  # shutter speed, brightness, exposure bias

Tags = Mapping[int, int | float | bytes | str]


def tiff_bytes(
    *pages: NDArray[Any],
    photometric: int | None = None,
    extra_samples: Sequence[int] = (),
    tags: Tags | None = None,
    exif: Tags | None = None,
    page_tags: Mapping[int, Tags] | None = None,
    bits: int | None = None,
) -> bytes:
    """Return an uncompressed little-endian TIFF file with one strip per page.

    Parameters
    ----------
    *pages : ndarray, shape (H, W) or (H, W, C)
        Samples of any numeric type.
    photometric : int
        0 for MinIsWhite, 1 for MinIsBlack, 2 for RGB. By default 1 or 2, from the channels.
    extra_samples : sequence of int
        0 unspecified, 1 associated alpha, 2 unassociated alpha.
    tags, exif : mapping, optional
        Further tags of each page and of its Exif directory: integers, rationals, text or bytes.
    page_tags : mapping, optional
        Further tags of single pages, by number.
    bits : int, optional
        Bits per sample that the file states, by default the bits of the array's type.
    """
    file = bytearray(struct.pack("<2sHI", b"II", 42, 0))
    link = 4
    for number, page in enumerate(pages):
        samples = np.atleast_3d(page)
        height, width, channels = samples.shape
        data = np.ascontiguousarray(samples, samples.dtype.newbyteorder("<")).tobytes()
        start = len(file)
        file += data + b"\0" * (len(data) % 2)
        depth = bits or 8 * samples.itemsize
        color = (1 if channels < 3 else 2) if photometric is None else photometric
        entries: dict[int, Any] = {
            256: width,
            257: height,
            258: _shorts([depth] * channels),
            259: 1,
            262: color,
            273: start,
            277: channels,
            278: height,
            279: len(data),
            339: _shorts([_FORMATS[samples.dtype.kind]] * channels),
        }
        if extra_samples:
            entries[338] = _shorts(extra_samples)
        if exif:
            entries[_EXIF] = (_LONG, 1, struct.pack("<I", _directory(file, exif)))
        entries |= {**(tags or {}), **(page_tags or {}).get(number, {})}
        directory = _directory(file, entries)
        struct.pack_into("<I", file, link, directory)
        link = len(file) - 4
    return bytes(file)


def _shorts(values: Sequence[int]) -> tuple[int, int, bytes]:
    return _SHORT, len(values), struct.pack(f"<{len(values)}H", *values)


def _directory(file: bytearray, tags: Mapping[int, Any]) -> int:
    """Append a directory of tags, and return its offset in the file."""
    entries = []
    for tag, value in sorted(tags.items()):
        kind, count, data = _encoded(value, tag in _SIGNED)
        if len(data) > 4:
            place = len(file)
            file += data + b"\0" * (len(data) % 2)
            data = struct.pack("<I", place)
        entries.append(struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0"))
    start = len(file)
    file += struct.pack("<H", len(entries)) + b"".join(entries) + bytes(4)
    return start


def _encoded(value: Any, is_signed: bool) -> tuple[int, int, bytes]:
    """Return the kind, count and bytes of a tag's value."""
    if isinstance(value, tuple):
        return value
    if isinstance(value, bytes):
        return _UNDEFINED, len(value), value
    if isinstance(value, str):
        return _ASCII, len(value) + 1, value.encode() + b"\0"
    if isinstance(value, float):
        kind, code = (_SRATIONAL, "<2i") if is_signed else (_RATIONAL, "<2I")
        return kind, 1, struct.pack(code, round(value * 2**20), 2**20)
    kind, code = (_SHORT, "<H") if value < 2**16 else (_LONG, "<I")
    return kind, 1, struct.pack(code, value)
