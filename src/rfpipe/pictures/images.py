"""Pictures: files in and out, by OpenImageIO, and radiance rendered for a screen."""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.output import damage_of, suffix_of, whole_file, write_atomically
from rfpipe.pictures.files import read_parts, read_picture

PICTURE_SUFFIXES = (".exr", ".png")
"""Of the files that `write_image` writes."""

JPEG_QUALITY = 95
"""Of the pictures that `write_jpeg` writes, 0 to 100."""

_ROUNDING = 0.6 / 255  # of 8 bits

UPRIGHT: dict[int, Callable[[NDArray[Any]], NDArray[Any]]] = {
    1: lambda pixels: pixels,
    2: lambda pixels: pixels[:, ::-1],
    3: lambda pixels: pixels[::-1, ::-1],
    4: lambda pixels: pixels[::-1],
    5: lambda pixels: np.swapaxes(pixels, 0, 1),
    6: lambda pixels: np.rot90(pixels, -1),
    7: lambda pixels: np.rot90(np.swapaxes(pixels, 0, 1), 2),
    8: np.rot90,
}
"""Functions that turn pixels (H, W, C) upright, by the orientation of TIFF 6.0 and Exif."""


def read_image(path: Path) -> NDArray[np.float32]:
    """Read a picture as linear weights.

    Parameters
    ----------
    path : Path
        A file of any format that OpenImageIO reads, or a raw file. Integers are scaled to [0, 1];
        no transfer curve is undone. Alpha is left out.

    Returns
    -------
    ndarray of float32, shape (H, W) or (H, W, 3)
        Upright, as the file's orientation has it.

    Raises
    ------
    InputError
        As `rfpipe.pictures.files.read_picture`.
    """
    picture = read_picture(path, develop_raw=True)
    pixels = UPRIGHT[picture.header.orientation](picture.fractions)
    return pixels[..., 0] if picture.header.channels == 1 else pixels


def write_image(
    path: Path,
    image: NDArray[np.floating],
    white: float | None = None,
    attributes: Mapping[str, str] | None = None,
) -> None:
    """Write radiance as a picture, complete or not at all.

    Parameters
    ----------
    path
        ``.exr`` keeps the radiance (float32); ``.png`` is for looking at: 8 bits, sRGB.
    image
        Radiance, shape (H, W, 1) or (H, W, 3).
    white
        Radiance shown as white in a PNG; the image's maximum when None.
    attributes
        Attributes of the file's header.

    Raises
    ------
    InputError
        When the suffix is another one.
    StoreError
        When the file can't be written.
    """
    import OpenImageIO as oiio

    pixels, kind = image, "float"
    if suffix_of(path, PICTURE_SUFFIXES) == ".png":
        top = float(image.max()) if white is None else white
        pixels, kind = srgb(image, top or 1.0)[..., : image.shape[-1]], "uint8"
    picture = oiio.ImageBuf(np.ascontiguousarray(pixels, np.float32))
    for name, text in (attributes or {}).items():
        picture.specmod().attribute(name, text)
    _write(path, picture, kind)


def write_parts(
    path: Path, names: Sequence[str], shape: tuple[int, ...], pictures: Iterable[NDArray[Any]]
) -> None:
    """Write radiance, pictures of one shape (H, W, C), as the named parts of one EXR file, float32.

    The file is complete or absent. StoreError when it can't be written.
    """
    import OpenImageIO as oiio

    height, width, channels = shape
    specs = [oiio.ImageSpec(width, height, channels, "float") for _ in names]
    for spec, name in zip(specs, names, strict=True):
        spec.attribute("oiio:subimagename", name)
    digests: list[bytes] = []

    def check(partial: Path) -> None:
        with _raising_damage(path, partial):
            parts = read_parts(partial)
            if [_digest(part.read().pixels) for part in parts] != digests:
                raise InputError("it holds other pixels")

    with whole_file(path, 4 * len(names) * math.prod(shape), check=check) as partial:
        file: Any = oiio.ImageOutput.create(str(partial))
        written = file.open(str(partial), specs)
        for index, picture in enumerate(pictures):
            pixels = np.ascontiguousarray(picture, np.float32)
            digests.append(_digest(pixels))
            written = written and (
                not index or file.open(str(partial), specs[index], "AppendSubimage")
            )
            written = written and file.write_image(pixels)
        if not (file.close() and written):
            raise damage_of(path, partial, file.geterror())


def _digest(pixels: NDArray[Any]) -> bytes:
    return hashlib.sha256(np.ascontiguousarray(pixels).tobytes()).digest()


@contextmanager
def _raising_damage(path: Path, partial: Path) -> Iterator[None]:
    """Turn an InputError into the OSError of a damaged file."""
    try:
        yield
    except InputError as error:
        text = str(error).removeprefix(f"{partial}: ")
        raise damage_of(path, partial, text) from error


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
    """Write weights (H, W) or (H, W, 3), 0 to 1, as a PNG whose light is ``code**gamma``."""
    import OpenImageIO as oiio

    codes = np.rint(255 * np.clip(light, 0, 1) ** (1 / gamma)).astype(np.uint8)
    _write(path, oiio.ImageBuf(np.ascontiguousarray(np.atleast_3d(codes))), "uint8")


def write_jpeg(path: Path, codes: NDArray[np.uint8]) -> None:
    """Write 8 bits (H, W, 3) as a JPEG file in which all channels have the full resolution."""
    from PIL import Image  # OpenImageIO's writer ends the process on a full disk

    content = io.BytesIO()
    Image.fromarray(codes).save(content, "jpeg", quality=JPEG_QUALITY, subsampling="4:4:4")
    write_atomically(path, content.getvalue(), resumes=False)


def _write(path: Path, picture: Any, kind: str) -> None:
    """Write a picture, and read it back: OpenImageIO writes cut PNG files without an error."""
    import OpenImageIO as oiio

    pixels = np.asarray(picture.get_pixels(oiio.FLOAT))

    def check(partial: Path) -> None:
        with _raising_damage(path, partial):
            stored = read_picture(partial).fractions
            close = np.isclose(stored, pixels, rtol=0, atol=_ROUNDING, equal_nan=True)
            if kind == "float":
                close = (stored == pixels) | np.isnan(pixels)
            if stored.shape != pixels.shape or not close.all():
                raise InputError("it holds other pixels")

    with whole_file(path, pixels.nbytes, check=check) as partial:
        if not picture.write(str(partial), kind):
            raise damage_of(path, partial, picture.geterror())
