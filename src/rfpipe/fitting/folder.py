"""Pictures with the patterns that they show, such as a folder of somebody else's program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import ray_shape
from rfpipe.environment import as_directions, lights_in
from rfpipe.errors import InputError
from rfpipe.pictures import Header, Picture, picture_files, read_header, read_picture
from rfpipe.weights import Curve, picture_weights

if TYPE_CHECKING:
    from rfpipe.photometry import CameraModel

Float = NDArray[np.float32]

_OTHERS = (".bmp", ".hdr", ".jpeg", ".jpg", ".pfm")


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
    names : sequence of K str
        Of the pictures; empty where they have none.
    lights : ndarray of float32, shape (N, 3), optional
        Directions of the projector's rays, where these are single lights.

    Raises
    ------
    InputError
        When shapes don't fit together or a value is out of range.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    patterns: Float = field(repr=False)
    radiance: Float = field(repr=False)
    variance: Float = field(repr=False)
    names: Sequence[str] = ()
    lights: Float | None = None

    def __post_init__(self) -> None:
        rays = prod(ray_shape(self.camera_shape, "camera_shape"))
        lights = prod(ray_shape(self.projector_shape, "projector_shape"))
        count = len(self.patterns)
        pictures = (count, self.channels, rays)
        for name, shape in (
            ("patterns", (count, lights)), ("radiance", pictures), ("variance", pictures)
        ):  # fmt: skip
            values = np.asarray(getattr(self, name))  # of other libraries, too
            object.__setattr__(self, name, values)
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
        return replace(self, **parts, names=())


def read_series(
    folder: Path,
    *,
    lights: tuple[int, int] | None = None,
    camera: CameraModel | None = None,
    black: Path | None = None,
    transfer: Curve = "linear",
) -> Series:
    """Read pictures and their patterns.

    Parameters
    ----------
    folder : Path
        Pictures lie in its folder ``pictures``, or in itself; patterns as pictures in its folder
        ``patterns``, or in ``patterns.npy``, (pictures, H, W) of weights. Both are taken in the
        order of the numbers in their names.
    lights : (int, int), optional
        Pictures of one light at a time, in so many rows and columns, which go before patterns. By
        default where there are none, but one of `LIGHT_FILES`, as a row.
    camera : CameraModel, optional
        Numbers of the camera, whose brackets are merged, with their variance. None takes pictures
        as light: one exposure of each pattern.
    black : Path, optional
        A picture without light, or a folder of some, to be subtracted as all-off pictures are.
    transfer : {"linear", "srgb"}
        What integers in pictures mean, and those in pictures of patterns.

    Raises
    ------
    InputError
        When a picture can't be read, or number, size or channels don't fit together.
    """
    subfolder, step = folder / "pictures", len(camera.exposures) if camera else 1
    brackets = _brackets(subfolder if subfolder.is_dir() else folder, step)
    directions = lights_in(folder, [files[0].name for files in brackets])
    weights = _weights(folder, lights, directions, transfer)
    if directions is not None:
        as_directions(directions, f"{folder}: its file of lights", prod(weights.shape[1:]))
    if weights.ndim != 3 or len(weights) != len(brackets):
        raise InputError(
            f"{folder}: holds {len(brackets)} pictures of {len(weights)} patterns, an array "
            f"{weights.shape}; expected one each, (pictures, H, W)"
        )
    paths = [path for files in brackets for path in files]
    headers = [read_header(path) for path in paths]
    for path, header in zip(paths, headers, strict=True):
        if replace(header, exposure_s=None) != replace(headers[0], exposure_s=None):
            raise InputError(
                f"{path}: is {header}; {paths[0].name} is {headers[0]}. All should be alike"
            )
    patterns = weights.reshape(len(weights), -1).astype(np.float32)
    lit = np.asarray(patterns.any(axis=1))
    dark = [files for files, is_lit in zip(brackets, lit, strict=True) if not is_lit]
    dark += _brackets(black, step) if black else []
    brackets = [files for files, is_lit in zip(brackets, lit, strict=True) if is_lit]
    if camera:
        radiance, variance = _merged(camera, brackets, headers[0], dark)
    else:
        seconds = [header.exposure_s or 0 for header in headers]
        differ = min(seconds) > 0 and max(seconds) > 1.01 * min(seconds)
        radiance = np.stack([_light(path, transfer, differ) for [path] in brackets])
        if dark:
            darkness = [_light(path, transfer, differ) for [path] in dark]
            radiance -= np.mean(darkness, axis=0, dtype=np.float64).astype(np.float32)
        variance = np.zeros_like(radiance)
    names, shapes = [files[0].name for files in brackets], (headers[0].size, weights.shape[1:])
    return Series(*shapes, patterns[lit], radiance, variance, names, directions)


def _brackets(place: Path, step: int) -> list[list[Path]]:
    """Return the pictures of a folder, or a single one, so many in a bracket."""
    files = [place] if place.is_file() else picture_files(place, _OTHERS)
    if len(files) % step:
        raise InputError(
            f"{place}: holds {len(files)} pictures, no multiple of the {step} exposures of the "
            "settings' camera"
        )
    return [files[first : first + step] for first in range(0, len(files), step)]


def _weights(
    folder: Path, lights: tuple[int, int] | None, directions: Float | None, transfer: Curve
) -> NDArray[Any]:
    """Return patterns as (K, H, W)."""
    subfolder, array = folder / "patterns", folder / "patterns.npy"
    if directions is not None and not (lights or array.is_file() or subfolder.is_dir()):
        lights = (1, len(directions))
    if lights:
        return np.eye(prod(lights), dtype=np.float32).reshape(-1, *lights)
    if array.is_file():
        return np.asarray(np.load(array, allow_pickle=False))
    if not subfolder.is_dir():
        raise InputError(
            f"{folder}: has no patterns; expected a folder {subfolder.name} of pictures, or "
            f"{array.name}, or, for one light at a time, --lights or a file of their directions"
        )
    pictures = [_linear(read_picture(path), transfer) for path in picture_files(subfolder, _OTHERS)]
    if len({picture.shape[:2] for picture in pictures}) > 1:
        raise InputError(f"{subfolder}: holds pictures of several sizes; patterns have one")
    if any(np.ptp(picture, axis=-1).any() for picture in pictures):
        raise InputError(f"{subfolder}: holds coloured pictures; patterns are of white light")
    return np.stack([picture[..., 0] for picture in pictures])


def _light(path: Path, transfer: Curve, over_time: bool) -> Float:
    """Return a picture as light, (C, M), over its exposure time where asked."""
    picture = read_picture(path)
    light = _planar(_linear(picture, transfer))
    return light / np.float32(picture.header.exposure_s) if over_time else light


def _linear(picture: Picture, transfer: Curve) -> Float:
    """Return a picture's values as linear light; integers go from 0 to 1."""
    if picture.header.kind == "light":
        return np.asarray(picture.pixels, np.float32)
    return picture_weights(picture.pixels.astype(f"uint{picture.bits}"), transfer)


def _planar(image: Float) -> Float:
    """Return (C, M) of (H, W, C)."""
    return np.ascontiguousarray(image.reshape(-1, image.shape[-1]).T)


def _merged(
    camera: CameraModel, brackets: list[list[Path]], header: Header, dark: list[list[Path]]
) -> tuple[Float, Float]:
    """Return merged brackets and their variance, (K, C, M) each."""
    if header.kind != "counts":
        raise InputError(f"{brackets[0][0]}: holds light; the settings' camera counts")
    shape = camera.frame_shape(header.size, header.channels if camera.bayer is None else 3)

    def frames(files: list[Path]) -> NDArray[Any]:
        return np.stack([read_picture(path).pixels for path in files]).reshape(shape)

    black: Any = np.full(shape, camera.black_level_counts, np.float32)
    if dark:
        black = np.mean([frames(files) for files in dark], axis=0, dtype=np.float64)
    merge = camera.merging(black.astype(np.float32), max(1, len(dark)))
    merged = [merge(frames(files)[None]) for files in brackets]
    radiance, variance = (
        np.stack([_planar(getattr(each, name)[0]) for each in merged])
        for name in ("radiance", "variance")
    )
    return radiance, variance
