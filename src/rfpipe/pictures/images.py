"""Pictures: files in and out, by OpenImageIO, and radiance rendered for a screen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

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

    picture = opened(path)
    chosen = light_channels(path, list(picture.spec().channelnames))
    pixels = pixels_of(path, picture, picture.get_pixels(oiio.FLOAT))
    return pixels[..., chosen if len(chosen) == 3 else chosen[0]]


def opened(path: Path) -> Any:
    """Return a picture file read by OpenImageIO, its numbers as they stand; errors `read_image`."""
    import OpenImageIO as oiio

    picture = oiio.ImageBuf(str(path))
    if not picture.read(0, 0, True):  # not through a cache in float
        raise InputError(f"{path}: can't be read as a picture: {picture.geterror()}")
    if path.suffix.lower() == ".exr" and picture.nsubimages > 1:
        raise InputError(
            f"{path}: holds {picture.nsubimages} pictures, as parts of one file; expected one here"
        )
    return picture


def pixels_of(path: Path, file: Any, pixels: NDArray[Any] | None) -> NDArray[Any]:
    """Return pixels that OIIO has read of a file, (H, W, channels); InputError for None."""
    if pixels is None:
        raise InputError(f"{path}: can't be read as a picture: {file.geterror()}")
    return pixels


def light_channels(path: Path, names: list[str]) -> list[int]:
    """Return the places of R, G and B, in any order, or of the one channel; else InputError."""
    if {"R", "G", "B"} <= set(names):
        return [names.index(name) for name in "RGB"]
    light = [index for index, name in enumerate(names) if name != "A"]
    if len(light) == 1:
        return light
    raise InputError(f"{path}: has the channels {names}; expected one channel, or R, G and B")


def write_image(
    path: Path,
    image: NDArray[np.floating],
    white: float | None = None,
    about: Mapping[str, str] | None = None,
) -> None:
    """Write radiance as a picture.

    Parameters
    ----------
    path
        ``.exr`` keeps the radiance (float32); ``.png`` is for looking at: 8 bits, sRGB.
    image
        Radiance, shape (H, W, 1) or (H, W, 3).
    white
        Radiance shown as white in a PNG; the image's maximum when None.
    about
        What the file says of itself, as attributes of its header.

    Raises
    ------
    InputError
        When the suffix is another one, or the file can't be written.
    """
    import OpenImageIO as oiio

    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(_SUFFIXES)}")
    pixels, kind = image, "float"
    if path.suffix.lower() == ".png":
        top = float(image.max()) if white is None else white
        pixels, kind = srgb(image, top or 1.0)[..., : image.shape[-1]], "uint8"
    picture = oiio.ImageBuf(np.ascontiguousarray(pixels, np.float32))
    for name, text in (about or {}).items():
        picture.specmod().attribute(name, text)
    _write(path, picture, kind)


def write_parts(
    path: Path, names: Sequence[str], shape: tuple[int, ...], pictures: Iterable[NDArray[Any]]
) -> None:
    """Write radiance, pictures of one shape (H, W, C), as the named parts of one EXR file, float32.

    InputError when it can't be written.
    """
    import OpenImageIO as oiio

    height, width, channels = shape
    specs = [oiio.ImageSpec(width, height, channels, "float") for _ in names]
    for spec, name in zip(specs, names, strict=True):
        spec.attribute("oiio:subimagename", name)
    file: Any = oiio.ImageOutput.create(str(path))
    written = file.open(str(path), specs)
    for index, picture in enumerate(pictures):
        written = written and (not index or file.open(str(path), specs[index], "AppendSubimage"))
        written = written and file.write_image(np.ascontiguousarray(picture, np.float32))
    if not (file.close() and written):
        raise InputError(f"{path}: can't be written: {file.geterror()}")


def srgb(radiance: NDArray[Any], white: float) -> NDArray[np.float64]:
    """Render radiance for a screen.

    Radiance (*shape, C), C 1 or 3, is shown as white from `white` on.

    Returns
    -------
    ndarray of float64, shape (*shape, 3)
        In [0, 1], with the transfer curve of sRGB (IEC 61966-2-1).
    """
    linear = np.clip(np.asarray(radiance, np.float64) / white, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    rgb: NDArray[np.float64] = np.broadcast_to(encoded, (*encoded.shape[:-1], 3))
    return rgb


def resized(picture: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return a picture (H, W) or (H, W, C) at another size: pixels averaged, or interpolated."""
    import OpenImageIO as oiio

    source = oiio.ImageBuf(np.ascontiguousarray(np.atleast_3d(picture), np.float32))
    height, width = shape
    roi = oiio.ROI(0, width, 0, height, 0, 1, 0, source.nchannels)
    target = oiio.ImageBufAlgo.resize(source, "triangle", 0.0, roi)
    if target.has_error:
        raise InputError(f"a picture can't be resized to {height} x {width}: {target.geterror()}")
    pixels = np.asarray(target.get_pixels(oiio.FLOAT), np.float32)
    return pixels.reshape(height, width, *picture.shape[2:])


def write_code_picture(path: Path, light: NDArray[Any], gamma: float = 1.0) -> None:
    """Write weights (H, W), 0 to 1, as a grey PNG for a projector of light ``code**gamma``."""
    import OpenImageIO as oiio

    codes = np.rint(255 * np.clip(light, 0, 1) ** (1 / gamma)).astype(np.uint8)
    _write(path, oiio.ImageBuf(np.ascontiguousarray(codes[..., None])), "uint8")


def _write(path: Path, picture: Any, kind: str) -> None:
    if not picture.write(str(path), kind):
        raise InputError(f"{path}: can't be written: {picture.geterror()}")
