"""Pictures with the patterns that they show, such as a folder of somebody else's program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import ray_shape
from rfpipe.errors import InputError
from rfpipe.pictures import Header, Picture, picture_files, read_header, read_picture

if TYPE_CHECKING:
    from rfpipe.photometry import CameraModel


Float = NDArray[np.float32]

_OTHERS = (".bmp", ".hdr", ".jpeg", ".jpg", ".pfm")
_ARRAYS = ("patterns.npy", "patterns.npz")


@dataclass(frozen=True, eq=False)
class Series:
    """Pictures of one scene under known light.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        Of M and of N rays; lights that stand in no grid are a row, (1, N).
    patterns : ndarray of float32, shape (K, N)
        Light of each ray in each picture, finite, at least 0.
    radiance : ndarray of float32, shape (K, C, M)
        Linear, without the light of anything else; finite.
    variance : ndarray of float32, shape (K, C, M)
        Of `radiance`, at least 0; 0 where nothing is known of it.

    Raises
    ------
    InputError
        When shapes don't fit together or a value is out of range.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    patterns: Float
    radiance: Float
    variance: Float

    def __post_init__(self) -> None:
        rays = prod(ray_shape(self.camera_shape, "camera_shape"))
        lights = prod(ray_shape(self.projector_shape, "projector_shape"))
        count = len(self.patterns)
        pictures = (count, self.channels, rays)
        for name, shape in (
            ("patterns", (count, lights)), ("radiance", pictures), ("variance", pictures)
        ):  # fmt: skip
            values = getattr(self, name)
            if values.shape != shape:
                raise InputError(f"{name} has the shape {values.shape}; expected {shape}")
            if not np.isfinite(values).all() or (name != "radiance" and (values < 0).any()):
                raise InputError(f"{name} should be finite and not negative, every value")
        if self.channels not in (1, 3):
            raise InputError(f"pictures have {self.channels} channels; expected 1 or 3")
        if not self.patterns.any():
            raise InputError("all patterns are dark, or there are none: they tell nothing of light")

    @property
    def channels(self) -> int:
        """Colour channels."""
        return int(self.radiance.shape[1])

    @property
    def is_binary(self) -> bool:
        """Whether patterns are full light and none."""
        return bool(((self.patterns == 0) | (self.patterns == 1)).all())

    @property
    def rank(self) -> int:
        """Number of independent patterns."""
        gram = self.patterns.astype(np.float64) @ self.patterns.T.astype(np.float64)
        values = np.linalg.eigvalsh(gram)
        return int(np.count_nonzero(values > 1e-10 * values[-1]))

    @property
    def is_complete(self) -> bool:
        """Whether the patterns tell of each ray by itself."""
        lights = self.patterns.shape[1]
        return bool(len(self.patterns) >= lights and self.rank == lights)

    def some(self, chosen: NDArray[np.int64]) -> Series:
        """Return some of the pictures."""
        parts = {name: getattr(self, name)[chosen] for name in ("patterns", "radiance", "variance")}
        return replace(self, **parts)


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
    transfer: Literal["linear", "srgb"] = "linear"
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
    own = folder / "pictures"
    brackets = _brackets(own if own.is_dir() else folder, options)
    patterns, shape = _patterns(folder, options, len(brackets))
    headers = [read_header(path) for files in brackets for path in files]
    for header, path in zip(headers, (path for files in brackets for path in files), strict=True):
        kinds = [(each.size, each.channels, each.kind) for each in (header, headers[0])]
        if kinds[0] != kinds[1]:
            raise InputError(
                f"{path}: is {kinds[0]} (size, channels, kind); {brackets[0][0].name} is "
                f"{kinds[1]}. All should be alike"
            )
    size = tuple(extent // options.reduce for extent in headers[0].size)
    if not all(size):
        raise InputError(
            f"{brackets[0][0]}: is {headers[0].size} pixels; a mean over {options.reduce} leaves "
            "none"
        )
    lit = np.asarray(patterns.any(axis=1))
    dark = [files for files, is_lit in zip(brackets, lit, strict=True) if not is_lit]
    dark += _brackets(options.black, options) if options.black else []
    brackets = [files for files, is_lit in zip(brackets, lit, strict=True) if is_lit]
    if options.camera:
        radiance, variance = _merged(options.camera, options.reduce, brackets, headers, dark)
    else:
        seconds = [header.exposure_s for header in headers]
        radiance = np.stack([_light(path, options, seconds) for [path] in brackets])
        if dark:
            black = [_light(path, options, seconds) for [path] in dark]
            radiance -= np.mean(black, axis=0, dtype=np.float64).astype(np.float32)
        variance = np.full_like(radiance, _of_repeats(patterns[lit], radiance))
    return Series((size[0], size[1]), shape, patterns[lit], radiance, variance)


def _brackets(place: Path, options: FolderOptions) -> list[list[Path]]:
    """Return the pictures of a folder, or a single one, bracket by bracket."""
    files = [place] if place.is_file() else picture_files(place, _OTHERS)
    step = len(options.camera.exposures) if options.camera else 1
    if len(files) % step:
        raise InputError(
            f"{place}: holds {len(files)} pictures, no multiple of the {step} exposures of the "
            "settings' camera"
        )
    return [files[first : first + step] for first in range(0, len(files), step)]


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
    if weights.ndim != 3 or len(weights) != count:
        raise InputError(
            f"{folder}: holds {count} pictures of {len(weights)} patterns, an array "
            f"{weights.shape}; expected one each, (pictures, H, W)"
        )
    if not ((weights >= 0) & (weights < np.inf)).all():
        raise InputError(
            f"{folder}: patterns should be finite and not negative; light of both signs, such as "
            "Hadamard's, is shown as two patterns, or on half a light"
        )
    shape = weights.shape[1:]
    return weights.reshape(count, -1).astype(np.float32), (shape[0], shape[1])


def _weights(folder: Path, options: FolderOptions) -> NDArray[Any]:
    """Read patterns as (K, H, W)."""
    for path in (folder / name for name in _ARRAYS if (folder / name).is_file()):
        held = np.load(path, allow_pickle=False)
        if not isinstance(held, np.ndarray):
            if len(held.files) != 1:
                raise InputError(f"{path}: holds {', '.join(held.files)}; expected one array")
            held = held[held.files[0]]
        return np.asarray(held[:, None] if held.ndim == 2 else held)
    own = folder / "patterns"
    if not own.is_dir():
        raise InputError(
            f"{folder}: has no patterns; expected a folder {own.name} of pictures, or "
            f"{' or '.join(_ARRAYS)}, or --lights for one light at a time"
        )
    pictures = []
    for path in picture_files(own, _OTHERS):
        picture = read_picture(path)
        if picture.header.channels == 3 and np.ptp(picture.pixels, axis=-1).any():
            raise InputError(f"{path}: is coloured; patterns are of white light")
        pictures.append(_linear(picture, options)[..., 0])
    if len({picture.shape for picture in pictures}) > 1:
        raise InputError(f"{own}: holds pictures of several sizes; patterns have one")
    return np.stack(pictures)


def _light(path: Path, options: FolderOptions, seconds: list[float | None]) -> Float:
    """Return a picture as light, (C, M), over its exposure time where these differ."""
    picture = read_picture(path)
    light = _reduced(_linear(picture, options), options.reduce)
    known, own = [second for second in seconds if second is not None], picture.header.exposure_s
    if own and len(known) == len(seconds) and max(known) > 1.01 * min(known):
        light = light / np.float32(own)
    return light


def _linear(picture: Picture, options: FolderOptions) -> Float:
    """Return a picture's values as linear light; integers go from 0 to 1."""
    if picture.header.kind == "light":
        return np.asarray(picture.pixels, np.float32)
    value = picture.pixels / np.float32(2**picture.bits - 1)
    if options.transfer == "srgb":
        value = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return value.astype(np.float32)


def _reduced(image: Float, by: int) -> Float:
    """Return means over squares of pixels, (C, M), of (H, W, C)."""
    rows, columns = image.shape[0] // by, image.shape[1] // by
    cut = image[: rows * by, : columns * by].reshape(rows, by, columns, by, -1)
    mean = cut.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
    return np.ascontiguousarray(mean.reshape(rows * columns, -1).T)


def _merged(
    camera: CameraModel,
    reduce: int,
    brackets: list[list[Path]],
    headers: list[Header],
    dark: list[list[Path]],
) -> tuple[Float, Float]:
    """Return merged brackets and their variance, (K, C, M) each."""
    from rfpipe.photometry import MergeOptions

    channels = headers[0].channels if camera.bayer is None else 3
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
        radiance.append(_reduced(merged.radiance[0], reduce))
        variance.append(_reduced(merged.variance[0], reduce) / np.float32(reduce**2))
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
