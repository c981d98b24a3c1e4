"""Picture files as a camera's program leaves them: TIFF, PNG, EXR, and raw."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.pictures.images import light_channels, opened, pixels_of
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


class Part(NamedTuple):
    """A picture in a file, by the part's name or, where it holds one, the file's, yet to be read.

    `read` returns it, or raises as `read_picture`.
    """

    file: Path
    name: str
    header: Header
    read: Callable[[], Picture]

    def __str__(self) -> str:
        return f"{self.file}" + (f", part {self.name}" if self.name != self.file.name else "")


def picture_files(folder: Path, more: tuple[str, ...] = ()) -> list[Path]:
    """Return the pictures in a folder, numbers in their names taken for numbers.

    Names end as those of TIFF, PNG, EXR and raw files, or as in `more`. Raises InputError when
    there is no such folder, or no picture in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; expected one of pictures")
    suffixes = {*_PLAIN, *RAW, *more}
    files = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".")
    ]
    if not files:
        raise InputError(
            f"{folder}: holds no pictures; expected files that end in "
            f"{', '.join([*_PLAIN, *more])} or, raw, in {', '.join(RAW)}"
        )
    return sorted(files, key=lambda file: natural(file.name))


def read_header(path: Path) -> Header:
    """Read what a file says of its picture.

    Raises
    ------
    InputError
        When it can't be read as one, or has neither one channel nor R, G and B.
    """
    if path.suffix.lower() in RAW:
        return read_picture(path).header
    return _header(path, opened(path).spec())


def read_picture(path: Path) -> Picture:
    """Read a picture, of a raw file the photosites as they are; errors as `read_header`."""
    if path.suffix.lower() in RAW:
        raw = read_raw(path)
        height, width = raw.counts.shape
        return Picture(
            Header((height, width), 1, "counts", raw.exposure_s), raw.counts[..., None], 16
        )
    picture = opened(path)
    return _picture(path, picture.spec(), picture, picture.get_pixels)


def read_parts(path: Path) -> list[Part]:
    """Return the pictures in a file: the parts of an EXR file, in its order, or the only one.

    Layers in channels' names, as in ``left.R``, are left out. Errors as `read_header`.
    """
    import OpenImageIO as oiio

    file: Any = oiio.ImageInput.open(str(path)) if path.suffix.lower() == ".exr" else None
    specs: list[Any] = []
    while file and file.seek_subimage(len(specs), 0):
        specs.append(file.spec(len(specs)))
    if len(specs) < 2:
        return [Part(path, path.name, read_header(path), partial(read_picture, path))]
    parts = []
    for index, spec in enumerate(specs):
        spec.channelnames = [name.rpartition(".")[2] for name in spec.channelnames]
        name = spec.getattribute("oiio:subimagename") or f"{index}"
        pixels_as = partial(file.read_image, index, 0, 0, spec.nchannels)
        read = partial(_picture, path, spec, file, pixels_as)
        parts.append(Part(path, name, _header(path, spec), read))
    return parts


def _picture(path: Path, spec: Any, file: Any, pixels_as: Callable[[Any], Any]) -> Picture:
    """Return the picture of OIIO's spec, whose file gives pixels as a kind of numbers."""
    import OpenImageIO as oiio

    header = _header(path, spec)
    kind, bits = oiio.UINT16, 16
    if header.kind == "light":
        kind, bits = oiio.FLOAT, 32
    elif spec.format == oiio.UINT8:
        kind, bits = oiio.UINT8, 8
    chosen = light_channels(path, list(spec.channelnames))
    pixels = pixels_of(path, file, pixels_as(kind))[..., chosen]
    dtype = np.float32 if header.kind == "light" else np.uint16
    return Picture(header, np.ascontiguousarray(pixels, dtype), bits)


def _header(path: Path, spec: Any) -> Header:
    channels = len(light_channels(path, list(spec.channelnames)))
    is_light = str(spec.format) in ("float", "half", "double")
    exposure = next(
        (float(value) for name in _EXPOSURE if (value := spec.getattribute(name)) is not None), None
    )
    kind = "light" if is_light else "counts"
    return Header((spec.height, spec.width), channels, kind, exposure or None)


def natural(name: str) -> list[tuple[int, int, str]]:
    """Return by what names sort as people count them: IMG_9 before IMG_10."""
    parts = _DIGITS.split(name.lower())
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]
