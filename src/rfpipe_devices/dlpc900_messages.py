"""Bytes of TI's DLPC900 controller, as its programmer's guide (DLPU018J) has them.

Numbers are little-endian. A message over USB (a HID device) is a header of flags, sequence byte and
payload length, then command and data, cut into packets of 64 bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from struct import pack, unpack

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError

HARDWARE_STATUS = 0x1A0A
DISPLAY_MODE = 0x1A1B
DISPLAY_START = 0x1A24
IMAGE_BEGIN = 0x1A2A
IMAGE_DATA = 0x1A2B
LUT_CONFIGURE = 0x1A31
LUT_ORDER = 0x1A32
LUT_DEFINE = 0x1A34

PACKET = 64
"""Bytes of a packet."""

MOST_DATA = 504
"""Bytes of an image that a message holds: 512 less header, command and the bytes' number."""

BITS_AN_IMAGE = 24
"""Binary pictures that are loaded as one image."""

_READ, _REPLY, _FAILED = 0x80, 0x40, 0x20
_WHITE = 0b111
_SIGNATURE = b"Spld"
_ENHANCED_RLE = 2


def message(command: int, data: bytes, number: int, *, read: bool = False) -> list[bytes]:
    """Return the packets of a message, each of `PACKET` bytes."""
    flags = _REPLY | (_READ if read else 0)
    whole = pack("<BBHH", flags, number, len(data) + 2, command) + data
    padded = whole + bytes(-len(whole) % PACKET)
    return [padded[first : first + PACKET] for first in range(0, len(padded), PACKET)]


def answer_of(packet: bytes, command: int, number: int) -> bytes:
    """Return the data of an answer.

    Raises
    ------
    CaptureError
        When it is none to this message, or says that the command failed.
    """
    if len(packet) < 4:
        raise CaptureError(f"projector: {len(packet)} bytes answer command {command:#06x}")
    flags, answered, length = unpack("<BBH", packet[:4])
    if flags & _FAILED:
        raise CaptureError(
            f"projector: refuses command {command:#06x}. Is its firmware that of a DLPC900, 3.0 or "
            "later, and no other program using it?"
        )
    if answered != number:
        raise CaptureError(f"projector: answers message {answered} where {number} was sent")
    return packet[4 : 4 + length]


def lut_entry(index: int, microseconds: int, place: int, bits: int = 1) -> bytes:
    """Return the definition of a pattern in white light.

    Parameters
    ----------
    index : int
        Of the pattern.
    microseconds : int
        For how long it is shown; a trigger output frames it.
    place : int
        Its place, or that of its lowest bit, among the loaded binary pictures.
    bits : int
        1 to 8, in one image.
    """
    image, bit = divmod(place, BITS_AN_IMAGE)
    shown = 1 | (bits - 1) << 1 | _WHITE << 4  # cleared afterwards; runs on untriggered
    return (
        pack("<H", index)
        + microseconds.to_bytes(3, "little")
        + bytes([shown])
        + bytes(3)  # no dark time
        + bytes(1)
        + pack("<H", image | bit << 11)
    )


def encoded_image(pictures: NDArray[np.bool_]) -> bytes:
    """Return up to `BITS_AN_IMAGE` binary pictures (n, H, W) as one compressed image."""
    _, height, width = pictures.shape
    values = np.zeros((height, width), np.uint32)
    for bit, picture in enumerate(pictures):
        values |= picture.astype(np.uint32) << np.uint32(bit)
    pixels = np.stack([values >> 16, values >> 8, values], axis=-1).astype(np.uint8)
    rows = b"".join(_encoded_rows(values, pixels))
    data = rows + bytes([0, 1, 0])
    header = (
        _SIGNATURE
        + pack("<HHI", width, height, len(data))
        + b"\xff" * 8
        + bytes(4)
        + bytes([0, _ENHANCED_RLE, 1])
    )
    return header + bytes(48 - len(header)) + data


def _encoded_rows(values: NDArray[np.uint32], pixels: NDArray[np.uint8]) -> Iterator[bytes]:
    width = values.shape[1]
    for row, line in enumerate(values):
        if row and np.array_equal(line, values[row - 1]):
            yield bytes([0, 1]) + _length(width)
            continue
        ends = np.append(np.flatnonzero(np.diff(line)) + 1, width)
        starts = np.insert(ends[:-1], 0, 0)
        if (ends - starts < 2).any():  # a single pixel is no run: the whole row as it stands
            yield bytes([0]) + _length(width) + pixels[row].tobytes()
            continue
        for start, end in zip(starts, ends, strict=True):
            yield _length(int(end - start)) + pixels[row, start].tobytes()


def _length(count: int) -> bytes:
    """Return a number of pixels, in one byte or two."""
    return bytes([count]) if count < 128 else bytes([count & 0x7F | 0x80, count >> 7])
