"""Picture files as a camera's program leaves them: TIFF, PNG, EXR, and raw."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.pictures.images import light_channels
from rfpipe.pictures.raw import read_raw

RAW = (
    ".3fr", ".arw", ".cr2", ".cr3", ".dng", ".erf", ".iiq", ".nef", ".nrw", ".orf", ".pef", ".raf",
    ".raw", ".rw2", ".srw",
)  # fmt: skip
"""Names of raw files end so; rawpy reads them, as one colour mosaic."""

_PLAIN = (".exr", ".png", ".tif", ".tiff")
_EXPOSURE = ("ExposureTime", "Exif:ExposureTime", "expTime")
_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True)
class Header:
    """What a file says of its picture without its pixels.

    Attributes
    ----------
    size : (int, int)
        Height and width.
    channels : int
        1, or 3 for R, G and B; alpha isn't counted.
    kind : str
        ``counts`` (integers) or ``light`` (floats).
    exposure_s : float or None
        Exposure time in seconds, if it says.
    """

    size: tuple[int, int]
    channels: int
    kind: str
    exposure_s: float | None


@dataclass(frozen=True)
class Picture:
    """A picture.

    Attributes
    ----------
    header : Header
    pixels : ndarray of uint16 or float32, shape (H, W, channels)
        Counts as they stand in the file, whatever its bits; light as it stands.
    bits : int
        Of an integer in the file: 8 or 16; 32 of floats.
    """

    header: Header
    pixels: NDArray[Any]
    bits: int


def picture_files(folder: Path, more: tuple[str, ...] = ()) -> list[Path]:
    """Return the pictures in a folder, numbers in their names taken for numbers.

    Parameters
    ----------
    folder : Path
    more : tuple of str
        How names may end, too, beside those of TIFF, PNG, EXR and raw files.

    Raises
    ------
    InputError
        When there is no such folder, or no picture in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; expected one of pictures")
    known = {*_PLAIN, *RAW, *more}
    found = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in known and not path.name.startswith(".")
    ]
    if not found:
        raise InputError(
            f"{folder}: holds no pictures; expected files that end in "
            f"{', '.join([*_PLAIN, *more])} or, raw, in {', '.join(RAW)}"
        )
    return sorted(found, key=_natural)


def read_header(path: Path) -> Header:
    """Read what a file says of its picture.

    Raises
    ------
    InputError
        When it can't be read as one, or has neither one channel nor R, G and B.
    """
    if path.suffix.lower() in RAW:
        return read_picture(path).header
    spec = _opened(path).spec()
    return _header(path, spec)


def read_picture(path: Path) -> Picture:
    """Read a picture; errors as `read_header`."""
    if path.suffix.lower() in RAW:
        return _raw(path)
    import OpenImageIO as oiio

    opened = _opened(path)
    spec = opened.spec()
    header = _header(path, spec)
    is_byte = spec.format == oiio.UINT8
    if header.kind == "light":
        pixels = opened.get_pixels(oiio.FLOAT)
    else:
        pixels = opened.get_pixels(oiio.UINT8 if is_byte else oiio.UINT16)
    if pixels is None:
        raise InputError(f"{path}: can't be read as a picture: {opened.geterror()}")
    chosen = light_channels(path, list(spec.channelnames))
    dtype = np.float32 if header.kind == "light" else np.uint16
    bits = 32 if header.kind == "light" else 8 if is_byte else 16
    return Picture(header, np.ascontiguousarray(pixels[..., chosen].astype(dtype)), bits)


def _opened(path: Path) -> Any:
    import OpenImageIO as oiio

    picture = oiio.ImageBuf(str(path))
    if not picture.read(0, 0, True):  # as it stands, not through a cache in float
        raise InputError(f"{path}: can't be read as a picture: {picture.geterror()}")
    return picture


def _header(path: Path, spec: Any) -> Header:
    channels = len(light_channels(path, list(spec.channelnames)))
    is_light = str(spec.format) in ("float", "half", "double")
    exposure = next(
        (float(value) for name in _EXPOSURE if (value := spec.getattribute(name)) is not None), None
    )
    kind = "light" if is_light else "counts"
    return Header((spec.height, spec.width), channels, kind, exposure or None)


def _raw(path: Path) -> Picture:
    """Read a raw file's visible photosites, nothing subtracted."""
    raw = read_raw(path)
    height, width = raw.counts.shape
    header = Header((height, width), 1, "counts", raw.exposure_s)
    return Picture(header, raw.counts[..., None], 16)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Sort IMG_9 before IMG_10."""
    parts = _DIGITS.split(path.name.lower())
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]
