"""Small raw files: TIFF files of photosites with the tags of DNG."""

from __future__ import annotations

import struct
from math import isqrt

import numpy as np
from numpy.typing import NDArray

__all__ = ["dng_bytes"]

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_BLACK_AND_WHITE_CFA = 32803
_COLORS = {"R": 0, "G": 1, "B": 2}


def dng_bytes(
    mosaic: NDArray[np.uint16],
    seconds: float,
    bayer: str = "RGGB",
    black: int = 0,
    white: int = 65_535,
) -> bytes:
    """Return an uncompressed DNG file; its length depends on the shape only.

    Parameters
    ----------
    mosaic : ndarray of uint16, shape (H, W)
        Counts.
    seconds : float
        Exposure time.
    bayer : str
        Colour mosaic from the upper left corner, 2 x 2 or 6 x 6, row by row.
    black, white : int
        Black and white level that the file states, in counts.
    """
    height, width = mosaic.shape
    period = isqrt(len(bayer))
    identity = b"".join(struct.pack("<2i", value, 1) for value in np.eye(3, dtype=int).ravel())
    # tag, type, count, and the value; values of more than four bytes follow separately
    entries: list[tuple[int, int, int, int | bytes | None]] = [
        (254, _LONG, 1, 0),  # the full-resolution picture
        (256, _LONG, 1, width),
        (257, _LONG, 1, height),
        (258, _SHORT, 1, 16),
        (259, _SHORT, 1, 1),  # not compressed
        (262, _SHORT, 1, _BLACK_AND_WHITE_CFA),
        (271, _ASCII, 4, b"Own\0"),
        (272, _ASCII, 4, b"One\0"),
        (273, _LONG, 1, None),  # offset of the counts
        (274, _SHORT, 1, 1),
        (277, _SHORT, 1, 1),
        (278, _LONG, 1, height),
        (279, _LONG, 1, mosaic.nbytes),
        (33421, _SHORT, 2, struct.pack("<2H", period, period)),
        (33422, _BYTE, period**2, bytes(_COLORS[color] for color in bayer)),
        (33434, _RATIONAL, 1, struct.pack("<2I", round(seconds * 2**20), 2**20)),
        (50706, _BYTE, 4, bytes([1, 4, 0, 0])),
        (50708, _ASCII, 4, b"One\0"),
        (50714, _LONG, 1, black),
        (50717, _LONG, 1, white),
        (50721, _SRATIONAL, 9, identity),
    ]
    start = 8 + 2 + 12 * len(entries) + 4
    beside = b"".join(value for *_, value in entries if isinstance(value, bytes) and len(value) > 4)
    directory, offset = b"", start
    for tag, kind, count, stated in entries:
        value = start + len(beside) if stated is None else stated
        if isinstance(stated, bytes) and len(stated) > 4:
            value, offset = offset, offset + len(stated)
        data = value if isinstance(value, bytes) else struct.pack("<I", value)
        directory += struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0")
    head = struct.pack("<2sHIH", b"II", 42, 8, len(entries))
    return head + directory + bytes(4) + beside + mosaic.astype("<u2").tobytes()
