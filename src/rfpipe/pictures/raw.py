"""Raw files: counts of the photosites as the camera stored them, or demosaiced linear colour."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.installation import needing
from rfpipe.pictures.records import Header, Picture

__all__ = ["Raw", "check_raw_mosaic", "developed", "read_raw"]

RAW = (
    ".3fr", ".arw", ".cr2", ".cr3", ".dng", ".erf", ".iiq", ".nef", ".nrw", ".orf", ".pef", ".raf",
    ".raw", ".rw2", ".srw",
)  # fmt: skip
"""Suffixes of raw files, which rawpy reads."""


@dataclass(frozen=True)
class Raw:
    """A raw picture.

    Attributes
    ----------
    counts : ndarray of uint16, shape (H, W)
        Counts of the visible photosites, nothing subtracted.
    exposure_s : float or None
        Exposure time in seconds.
    bayer : str or None
        Colour mosaic from the upper left corner, such as RGGB; None for any other mosaic than
        one of 2 x 2 with one R, two G and one B, and without one.
    black : float
        Black level in counts, the mean over the mosaic; 0 where the file has none.
    white : int
        Counts at which the camera saturates, according to the file.
    mosaic : str or None
        As `bayer`, but ``X-Trans`` or the letters of any other mosaic, row by row, where it is
        not one of these; None for a sensor without a mosaic.
    iso, f_number : float or None
        Sensitivity and aperture.
    """

    counts: NDArray[np.uint16]
    exposure_s: float | None
    bayer: str | None
    black: float
    white: int
    mosaic: str | None = None
    iso: float | None = None
    f_number: float | None = None


def read_raw(source: Path | bytes, name: str = "") -> Raw:
    """Read a raw file.

    Parameters
    ----------
    source : Path or bytes
        The file, or its contents.
    name : str
        Name in messages; the path by default.

    Raises
    ------
    InputError
        When it isn't a raw file, has no single count for each photosite, or rawpy is missing.
    """
    name = name or str(source)
    with _open(source, name) as raw:
        import rawpy

        if raw.raw_type != rawpy.RawType.Flat:
            raise InputError(
                f"{name}: has several colours at each photosite, it is demosaiced already (as "
                "linear DNG); expected one count per photosite",
                remedy="Save it as TIFF of 16 bits, linear",
            )
        counts = np.array(raw.raw_image_visible)
        mosaic = _mosaic(raw)
        metadata = raw.other
        seconds, iso, f_number = metadata.shutter_speed, metadata.iso_speed, metadata.aperture
        black = float(np.mean(raw.black_level_per_channel))
        white = int(raw.white_level)
        saturated = raw.camera_white_level_per_channel
    if counts.ndim != 2:
        raise InputError(f"{name}: holds {counts.ndim} axes; expected one count per photosite")
    # some makers state for each picture where its channels end, below the model's level
    if saturated is not None and min(saturated) > 0:
        white = min(white, *map(int, saturated))
    return Raw(
        counts.astype(np.uint16),
        _positive(seconds),
        mosaic if mosaic and sorted(mosaic) == sorted("RGGB") else None,
        black,
        white,
        mosaic,
        _positive(iso),
        _positive(f_number),
    )


def raw_header(path: Path, *, develop: bool = False) -> Header:
    """Read the header of a raw file, as `raw_picture` or, with `develop`, `developed` has it."""
    with _open(path, str(path)) as raw:
        return _header(path, raw, develop)


def raw_picture(path: Path) -> Picture:
    """Return the photosites of a raw file as a picture of one channel of counts."""
    header = raw_header(path)
    return Picture(header, read_raw(path).counts[..., None], 65_535)


def developed(path: Path) -> Picture:
    """Demosaic a raw file to linear colours, by LibRaw.

    The black level is subtracted (noise below it is cut off at 0), and the white level scaled to
    65,535. Colours are the camera's: no white balance, no colour matrix, no automatic brightness,
    and no rotation. Bayer mosaics are interpolated linearly, X-Trans mosaics by LibRaw's method.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Picture
        Counts of 16 bits, shape (H, W, 3), or (H, W, 1) from a sensor without colours.

    Raises
    ------
    InputError
        When the file isn't a raw file, can't be demosaiced, or rawpy is missing.
    """
    with _open(path, str(path)) as raw:
        import rawpy

        header = _header(path, raw, develop=True)
        pixels = raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            output_bps=16,
            user_wb=[1.0, 1.0, 1.0, 1.0],
            output_color=rawpy.ColorSpace.raw,
            user_flip=0,
            adjust_maximum_thr=0.0,
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
        )
    pixels = np.atleast_3d(pixels)[..., : header.channels]
    return Picture(header, np.ascontiguousarray(pixels, np.uint16), 65_535)


def _header(path: Path, raw: Any, develop: bool) -> Header:
    """Return the header of an opened raw file."""
    if develop and raw.num_colors not in (1, 3):
        raise InputError(
            f"{path}: has a mosaic of {raw.num_colors} colours; expected R, G and B",
            remedy="Save it as TIFF of 16 bits, linear",
        )
    metadata, sizes = raw.other, raw.sizes
    return Header(
        (sizes.height, sizes.width),
        raw.num_colors if develop else 1,
        "counts",
        _positive(metadata.shutter_speed),
        _positive(metadata.iso_speed),
        _positive(metadata.aperture),
        "linear",
        None if develop else _mosaic(raw),
    )


def check_raw_mosaic(path: Path, header: Header, bayer: str | None) -> None:
    """Raise InputError when a raw file's mosaic differs from the setting ``camera.bayer``.

    Other files than raw ones, such as TIFF, state no mosaic and pass.

    Parameters
    ----------
    path : Path
    header : Header
    bayer : str or None
        The setting.
    """
    if path.suffix.lower() not in RAW or header.mosaic == bayer:
        return
    setting = f"camera.bayer is {bayer or 'null'}"
    if header.mosaic is None:
        raise InputError(
            f"{path}: has no colour mosaic, but {setting}", remedy="Set camera.bayer to null"
        )
    if sorted(header.mosaic) != sorted("RGGB"):
        raise InputError(
            f"{path}: has the colour mosaic {header.mosaic}, which is not one of 2 x 2 of R, G, G "
            f"and B; {setting}",
            remedy="Convert it to linear TIFF of 16 bits, with camera.bayer null",
        )
    raise InputError(
        f"{path}: has the colour mosaic {header.mosaic}, but {setting}",
        remedy=f"Set camera.bayer to {header.mosaic}",
    )


@contextmanager
def _open(source: Path | bytes, name: str) -> Iterator[Any]:
    """Open a raw file by rawpy; its errors raise InputError."""
    with needing("pictures", f"reading the raw file {name}"):
        import rawpy
    try:
        opened = io.BytesIO(source) if isinstance(source, bytes) else str(source)
        with rawpy.imread(opened) as raw:
            yield raw
    except rawpy.LibRawError as error:
        raise InputError(f"{name}: can't be read as a raw file: {error}") from error


def _positive(value: float) -> float | None:
    return float(value) if value > 0 else None


def _mosaic(raw: Any) -> str | None:
    """Return the mosaic of the visible photosites: its letters, X-Trans, or None for gray."""
    pattern = raw.raw_pattern
    names = raw.color_desc.decode()
    if pattern is None or raw.num_colors == 1:
        return None
    rows, columns = pattern.shape
    if (rows, columns) == (6, 6):
        return "X-Trans"
    return "".join(names[index] for index in raw.raw_colors_visible[:rows, :columns].ravel())
