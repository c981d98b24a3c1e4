"""A folder of pictures, with the patterns that they show, as somebody else's program left it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.fitting.series import Series
from rfpipe.pictures import Header, Picture, picture_files, read_header, read_picture

if TYPE_CHECKING:
    from rfpipe.photometry import CameraModel

__all__ = ["FolderOptions", "Transfer", "read_series"]

Float = NDArray[np.float32]
Transfer = Literal["linear", "srgb"]

_OTHERS = (".bmp", ".hdr", ".jpeg", ".jpg", ".pfm")
_PICTURES, _PATTERNS = "pictures", "patterns"
_ARRAYS = ("patterns.npy", "patterns.npz")


@dataclass(frozen=True)
class FolderOptions:
    """What files don't say of themselves.

    Parameters
    ----------
    lights : (int, int), optional
        Pictures of one light at a time, in so many rows and columns, which go before patterns.
    camera : CameraModel, optional
        Numbers of the camera, whose brackets are merged, with their variance. None takes pictures
        as light: linear, one exposure of each pattern.
    black : Path, optional
        A picture without light, or a folder of some, to be subtracted.
    transfer : {"linear", "srgb"}
        What integers in pictures mean, and those in pictures of patterns.
    reduce : int
        Camera pixels, along either side, whose mean is taken for a ray.
    """

    lights: tuple[int, int] | None = None
    camera: CameraModel | None = None
    black: Path | None = None
    transfer: Transfer = "linear"
    reduce: int = 1


def read_series(folder: Path, options: FolderOptions | None = None) -> Series:
    """Read pictures and their patterns.

    Parameters
    ----------
    folder : Path
        Pictures lie in its folder ``pictures``, or in itself; patterns as pictures in its folder
        ``patterns``, or in ``patterns.npy`` or ``.npz``, (pictures, H, W) of weights. Both are
        taken in the order of the numbers in their names. Without patterns, ``options.lights``
        says that each picture has one light.
    options : FolderOptions, optional

    Returns
    -------
    Series
        All-off pictures among them, or `options.black`, are subtracted from the others.

    Raises
    ------
    InputError
        When a picture can't be read, or number, size or channels don't fit together.
    """
    options = options or FolderOptions()
    own = folder / _PICTURES
    files = picture_files(own if own.is_dir() else folder, _OTHERS)
    step = len(options.camera.exposures) if options.camera else 1
    if len(files) % step:
        raise InputError(
            f"{folder}: holds {len(files)} pictures, no multiple of the {step} exposures of the "
            "settings' camera"
        )
    patterns, shape = _patterns(folder, options, len(files) // step)
    headers = [read_header(path) for path in files]
    _check_alike(headers, files)
    size = tuple(extent // options.reduce for extent in headers[0].size)
    if not all(size):
        raise InputError(
            f"{files[0]}: is {headers[0].size} pixels; a mean over {options.reduce} leaves none"
        )
    black_files = _black_files(options.black, step)
    black = np.flatnonzero(~patterns.any(axis=1))
    if options.camera:
        brackets = [files[first : first + step] for first in range(0, len(files), step)]
        dark = [brackets[index] for index in black] + black_files
        radiance, variance = _merged(options, brackets, headers, dark)
    else:
        seconds = [header.exposure_s for header in headers]
        radiance = np.stack([_light(path, options, seconds, header) for path, header in
                             zip(files, headers, strict=True)])  # fmt: skip
        variance = np.zeros_like(radiance)
        if black.size or black_files:
            dark_light = [radiance[index] for index in black]
            dark_light += [
                _light(path, options, seconds, read_header(path)) for [path] in black_files
            ]
            radiance -= np.mean(dark_light, axis=0, dtype=np.float64).astype(np.float32)
    lit = patterns.any(axis=1)
    patterns, radiance, variance = patterns[lit], radiance[lit], variance[lit]
    if not options.camera:
        variance[:] = _of_repeats(patterns, radiance)
    height, width = size
    return Series((height, width), shape, patterns, radiance, variance)


def _patterns(folder: Path, options: FolderOptions, count: int) -> tuple[Float, tuple[int, int]]:
    """Return patterns (K, N), and the shape of their rays."""
    if options.lights:
        down, across = options.lights
        if down * across != count:
            raise InputError(
                f"{folder}: holds {count} pictures; {down} x {across} lights, one at a time, make "
                f"{down * across}"
            )
        return np.eye(count, dtype=np.float32), (down, across)
    weights = _weights(folder, options)
    if len(weights) != count:
        raise InputError(f"{folder}: holds {count} pictures of {len(weights)} patterns; one each")
    if not ((weights >= 0) & (weights < np.inf)).all():
        raise InputError(
            f"{folder}: patterns should be finite and not negative; light of both signs, such as "
            "Hadamard's, is shown as two patterns, or on half a light"
        )
    shape = weights.shape[1:]
    return weights.reshape(count, -1).astype(np.float32), (shape[0], shape[1])


def _weights(folder: Path, options: FolderOptions) -> NDArray[Any]:
    """Read patterns as (K, H, W)."""
    for name in _ARRAYS:
        if (folder / name).is_file():
            held = np.load(folder / name, allow_pickle=False)
            if not isinstance(held, np.ndarray):
                if len(held.files) != 1:
                    raise InputError(
                        f"{folder / name}: holds {', '.join(held.files)}; expected one array"
                    )
                held = held[held.files[0]]
            if held.ndim == 2:
                held = held[:, None]
            if held.ndim != 3 or held.dtype.kind not in "fiub":
                raise InputError(
                    f"{folder / name}: holds {held.dtype} {held.shape}; expected weights "
                    "(pictures, H, W)"
                )
            return np.asarray(held)
    own = folder / _PATTERNS
    if not own.is_dir():
        raise InputError(
            f"{folder}: has no patterns; expected a folder {_PATTERNS} of pictures, or "
            f"{' or '.join(_ARRAYS)}, or --lights for one light at a time"
        )
    pictures = []
    for path in picture_files(own, _OTHERS):
        picture = read_picture(path)
        if picture.header.channels == 3 and np.ptp(picture.pixels, axis=-1).any():
            raise InputError(f"{path}: is coloured; patterns are of white light")
        pictures.append(_linear(picture, options.transfer)[..., 0])
    if len({picture.shape for picture in pictures}) > 1:
        raise InputError(f"{own}: holds pictures of several sizes; patterns have one")
    return np.stack(pictures)


def _check_alike(headers: list[Header], files: list[Path]) -> None:
    for header, path in zip(headers, files, strict=True):
        if (header.size, header.channels, header.kind) != (
            headers[0].size, headers[0].channels, headers[0].kind,
        ):  # fmt: skip
            raise InputError(
                f"{path}: is {header.size[0]} x {header.size[1]} with {header.channels} channels "
                f"of {header.kind}; {files[0].name} is {headers[0].size[0]} x {headers[0].size[1]} "
                f"with {headers[0].channels} of {headers[0].kind}. All should be alike"
            )


def _light(
    path: Path, options: FolderOptions, seconds: list[float | None], header: Header
) -> Float:
    """Return a picture as light, (C, M), over its exposure time where these differ."""
    light = _reduced(_linear(read_picture(path), options.transfer), options.reduce)
    known = [second for second in seconds if second is not None]
    if header.exposure_s and len(known) == len(seconds) and max(known) > 1.01 * min(known):
        light = light / np.float32(header.exposure_s)
    return light


def _linear(picture: Picture, transfer: Transfer) -> Float:
    """Return a picture's values as linear light; integers go from 0 to 1."""
    if picture.header.kind == "light":
        return np.asarray(picture.pixels, np.float32)
    value = picture.pixels / np.float32(2**picture.bits - 1)
    if transfer == "srgb":
        value = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return value.astype(np.float32)


def _reduced(image: Float, by: int) -> Float:
    """Return means over squares of pixels, (C, M), of (H, W, C)."""
    rows, columns = image.shape[0] // by, image.shape[1] // by
    cut = image[: rows * by, : columns * by].reshape(rows, by, columns, by, -1)
    mean = cut.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
    return np.ascontiguousarray(mean.reshape(rows * columns, -1).T)


def _black_files(black: Path | None, step: int) -> list[list[Path]]:
    if black is None:
        return []
    files = picture_files(black, _OTHERS) if black.is_dir() else [black]
    if len(files) % step:
        raise InputError(f"{black}: holds {len(files)} pictures; a bracket has {step}")
    return [files[first : first + step] for first in range(0, len(files), step)]


def _merged(
    options: FolderOptions,
    brackets: list[list[Path]],
    headers: list[Header],
    dark: list[list[Path]],
) -> tuple[Float, Float]:
    """Return what brackets merge to and its variance, (K, C, M) each."""
    from rfpipe.photometry import MergeOptions

    camera = options.camera
    assert camera is not None
    mosaic = camera.bayer is not None
    channels = 3 if mosaic else headers[0].channels
    shape = camera.frame_shape(headers[0].size, channels)

    def frames(files: list[Path]) -> NDArray[Any]:
        found = [read_picture(path) for path in files]
        if found[0].header.kind != "counts":
            raise InputError(f"{files[0]}: holds light; the settings' camera counts")
        return np.stack([picture.pixels for picture in found]).reshape(shape)

    black: Any = np.full(shape, camera.black_level_counts, np.float32)
    if dark:
        black = np.mean([frames(files) for files in dark], axis=0, dtype=np.float64)
    merge = camera.merging(black.astype(np.float32), MergeOptions(black_count=max(1, len(dark))))
    radiance, variance = [], []
    for files in brackets:
        merged = merge(frames(files)[None])
        radiance.append(_reduced(merged.radiance[0], options.reduce))
        spread = _reduced(merged.variance[0], options.reduce)
        variance.append(spread / np.float32(options.reduce**2))
    return np.stack(radiance), np.stack(variance)


def _of_repeats(patterns: Float, radiance: Float) -> float:
    """Return the variance of pictures that are there more than once, 0 where none are."""
    _, which, count = np.unique(patterns, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    total, free = 0.0, 0
    for index in np.flatnonzero(count > 1):
        some = radiance[which == index].astype(np.float64)
        total += float(np.square(some - some.mean(axis=0)).sum())
        free += (len(some) - 1) * some[0].size
    return total / free if free else 0.0
