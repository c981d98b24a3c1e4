"""Picture files in and out, by OpenImageIO."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

__all__ = ["read_image", "write_image"]

_SUFFIXES = (".exr", ".png")


def read_image(path: Path) -> NDArray[np.float32]:
    """Read a picture as linear weights.

    Parameters
    ----------
    path
        A file of any format that OpenImageIO reads. Integers are scaled to [0, 1]; no transfer
        curve is undone. Alpha is left out.

    Returns
    -------
    ndarray of float32, shape (H, W) or (H, W, 3)

    Raises
    ------
    InputError
        When the file can't be read, or has neither one channel nor R, G and B.
    """
    import OpenImageIO as oiio

    picture = oiio.ImageBuf(str(path))
    pixels = picture.get_pixels(oiio.FLOAT) if picture.read() else None
    if pixels is None:
        raise InputError(f"{path}: can't be read as a picture: {picture.geterror()}")
    names = list(picture.spec().channelnames)
    if {"R", "G", "B"} <= set(names):  # in a file they stand in any order
        return pixels[..., [names.index(name) for name in "RGB"]]
    light = [index for index, name in enumerate(names) if name != "A"]
    if len(light) == 1:
        return pixels[..., light[0]]
    raise InputError(f"{path}: has the channels {names}; expected one channel, or R, G and B")


def write_image(path: Path, image: NDArray[np.floating], white: float | None = None) -> None:
    """Write radiance as a picture.

    Parameters
    ----------
    path
        ``.exr`` keeps the radiance (float32); ``.png`` is for looking at: 8 bits, sRGB.
    image
        Radiance, shape (H, W, 1) or (H, W, 3).
    white
        Radiance shown as white in a PNG; the image's maximum when None.

    Raises
    ------
    InputError
        When the suffix is another one, or the file can't be written.
    """
    import OpenImageIO as oiio

    from rfpipe.photometry.response import srgb

    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(_SUFFIXES)}")
    pixels, kind = image, "float"
    if path.suffix.lower() == ".png":
        top = float(image.max()) if white is None else white
        pixels, kind = srgb(image, top or 1.0)[..., : image.shape[-1]], "uint8"
    picture = oiio.ImageBuf(np.ascontiguousarray(pixels, np.float32))
    if not picture.write(str(path), kind):
        raise InputError(f"{path}: can't be written: {picture.geterror()}")
