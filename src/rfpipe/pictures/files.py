"""Picture files of cameras and other programs: pixels, exposure, and order."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from rfpipe.errors import InputError
from rfpipe.pictures.formats import READERS, Reading, read_plain
from rfpipe.pictures.openimage import Stored, light_channels, stored_pictures
from rfpipe.pictures.raw import RAW, developed, raw_header, raw_picture
from rfpipe.pictures.records import Header, Part, Picture

__all__ = [
    "RAW",
    "Header",
    "Part",
    "Picture",
    "natural",
    "picture_files",
    "read_header",
    "read_parts",
    "read_picture",
]

PLAIN = (
    ".bmp", ".exr", ".pfm", ".pgm", ".pnm", ".png", ".ppm", ".tga", ".tif", ".tiff",
)  # fmt: skip
"""Suffixes of files without lossy compression, which OpenImageIO reads."""

_PAGED = ("openexr", "tiff")  # formats whose pictures are parts
_DIGITS = re.compile(r"(\d+)")


def picture_files(folder: Path, more: tuple[str, ...] = ()) -> list[Path]:
    """List the pictures in a folder, sorted by name, with numbers in names in numerical order.

    Parameters
    ----------
    folder : Path
    more : tuple of str
        Suffixes besides those of `PLAIN` and `RAW`.

    Raises
    ------
    InputError
        When the folder doesn't exist, or has no pictures.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder", remedy="give a folder of pictures")
    suffixes = {*PLAIN, *RAW, *more}
    files = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".")
    ]
    if not files:
        raise InputError(
            f"{folder}: holds no pictures; expected files that end in "
            f"{', '.join(dict.fromkeys([*PLAIN, *more]))} or, raw, in {', '.join(RAW)}"
        )
    return sorted(files, key=lambda file: natural(file.name))


def read_header(path: Path, *, develop_raw: bool = False) -> Header:
    """Read the header of a file's only picture; parameters and errors as `read_picture`."""
    return _only(path, develop_raw).header


def read_picture(path: Path, *, develop_raw: bool = False) -> Picture:
    """Read a file's only picture.

    Parameters
    ----------
    path : Path
    develop_raw : bool
        Whether raw files are demosaiced, as `rfpipe.pictures.raw.developed`; otherwise their
        photosites are one channel of counts.

    Returns
    -------
    Picture
        Pixels in the order of the sensor: Exif's orientation, which depends on how the camera was
        held, is not applied.

    Raises
    ------
    InputError
        When the file is not a picture, is damaged or cut, holds several pictures, or has neither
        one channel nor R, G and B.
    """
    return _only(path, develop_raw).read()


def read_parts(path: Path, *, develop_raw: bool = False) -> list[Part]:
    """List the pictures in a file: parts of EXR, pages of TIFF, or the only picture.

    Layers within a part, as in the channel name ``left.R``, are ignored. Parameters and errors as
    `read_picture`.
    """
    if path.suffix.lower() in RAW:
        read = partial(developed if develop_raw else raw_picture, path)
        return [Part(path, path.name, raw_header(path, develop=develop_raw), read)]
    stored = stored_pictures(path)
    if len(stored) > 1 and stored[0].format_name not in _PAGED:
        raise InputError(
            f"{path}: holds {len(stored)} pictures, an animation or sizes of one picture; expected "
            "one picture per file"
        )
    if len(stored) == 1:
        return [_part(stored[0], path.name)]
    for part in stored:
        part.spec.channelnames = [name.rpartition(".")[2] for name in part.spec.channelnames]
    names = [part.attribute("oiio:subimagename") or f"{part.index}" for part in stored]
    return [_part(part, name) for part, name in zip(stored, names, strict=True)]


def _only(path: Path, develop_raw: bool) -> Part:
    """Return the only picture of a file."""
    parts = read_parts(path, develop_raw=develop_raw)
    if len(parts) > 1:
        raise InputError(
            f"{path}: holds {len(parts)} pictures, as parts of one file; expected one here"
        )
    return parts[0]


def _part(stored: Stored, name: str) -> Part:
    """Return a part that reads a stored picture on demand."""
    reading = READERS.get(stored.format_name, read_plain)(stored)
    return Part(stored.path, name, reading.header, partial(_picture, stored, reading))


def _picture(stored: Stored, reading: Reading) -> Picture:
    """Read the pixels of a stored picture."""
    pixels = stored.pixels()[..., light_channels(stored)]
    if pixels.dtype.kind == "i" and (least := int(pixels.min(initial=0))) < 0:
        raise InputError(
            f"{stored.path}: holds negative counts, down to {least}; counts start at 0",
            remedy="Add what was subtracted, or save it as floats of linear light",
        )
    kind = np.float32 if stored.is_light else np.uint16 if stored.white < 2**16 else np.uint32
    corrected = reading.correct(pixels)
    return Picture(reading.header, np.ascontiguousarray(corrected, kind), reading.white)


def natural(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key by which numbers in names count as numbers: IMG_9 before IMG_10."""
    parts = _DIGITS.split(name.lower())
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]
