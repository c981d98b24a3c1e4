"""Raw files: counts of the photosites as the camera stored them, and what it says of them."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, installing

__all__ = ["Raw", "read_raw"]


@dataclass(frozen=True)
class Raw:
    """A raw picture.

    Attributes
    ----------
    counts : ndarray of uint16, shape (H, W)
        Of the visible photosites, nothing subtracted.
    exposure_s : float or None
        Exposure time in seconds, if the file says.
    bayer : str or None
        Colour mosaic from the upper left corner, such as RGGB; None where there is no mosaic of
        2 x 2.
    black : float
        Black level in counts, the mean over the mosaic; 0 where the file doesn't say.
    white : int
        Counts at which the camera says that it saturates.
    """

    counts: NDArray[np.uint16]
    exposure_s: float | None
    bayer: str | None
    black: float
    white: int


def read_raw(source: Path | bytes, name: str = "") -> Raw:
    """Read a raw file.

    Parameters
    ----------
    source : Path or bytes
        The file, or what stands in it.
    name : str
        What messages call it; the path where it is not given.

    Raises
    ------
    InputError
        When it isn't one, or rawpy is missing.
    """
    name = name or str(source)
    try:
        import rawpy
    except ImportError as error:
        raise InputError(
            f"{name}: is a raw file, and {error.name} is missing to read it; "
            f"{installing('pictures')}"
        ) from error
    try:
        opened = io.BytesIO(source) if isinstance(source, bytes) else str(source)
        with rawpy.imread(opened) as raw:
            counts = np.array(raw.raw_image_visible)
            seconds = float(raw.other.shutter_speed)
            bayer = _mosaic(raw)
            black = float(np.mean(raw.black_level_per_channel))
            white = int(raw.white_level)
            saturated = raw.camera_white_level_per_channel
    except rawpy.LibRawError as error:
        raise InputError(f"{name}: can't be read as a raw file: {error}") from error
    if counts.ndim != 2:
        raise InputError(f"{name}: holds {counts.ndim} axes; expected one count a photosite")
    # some makers say for each picture where its channels end, below the model's own level
    if saturated is not None and min(saturated) > 0:
        white = min(white, *map(int, saturated))
    exposure = seconds if seconds > 0 else None
    return Raw(counts.astype(np.uint16), exposure, bayer, black, white)


def _mosaic(raw: object) -> str | None:
    """Return the mosaic of the visible photosites."""
    pattern = getattr(raw, "raw_pattern", None)
    if pattern is None or pattern.shape != (2, 2):
        return None
    colors = raw.raw_colors_visible[:2, :2].ravel()  # type: ignore[attr-defined]
    names = raw.color_desc.decode()  # type: ignore[attr-defined]
    letters = "".join(names[index] for index in colors)
    return letters if sorted(letters) == sorted("RGGB") else None
