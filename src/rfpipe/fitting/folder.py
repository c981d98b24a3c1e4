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
from rfpipe.pictures.files import Header, Part, picture_files, read_parts
from rfpipe.weights import Curve, picture_weights

if TYPE_CHECKING:
    from rfpipe.photometry import CameraModel

Float = NDArray[np.float32]

_ARRAYS = ("patterns", "radiance", "variance")
_OTHERS = (".bmp", ".hdr", ".jpeg", ".jpg", ".pfm")


@dataclass(frozen=True, eq=False)
class Series:
    """Pictures of one scene under known light.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        Of M and of N rays; lights that stand in no grid are a row, (1, N).
    patterns : ndarray of float32, shape (K, 1, N) or (K, C, N); (K, N) is taken, too
        Light of each ray in each picture, finite, at least 0: white, or one for each channel.
    radiance : ndarray of float32, shape (K, C, M)
        Linear, without the light of anything else; finite.
    variance : ndarray of float32, shape (K, C, M)
        Of `radiance`, at least 0; 0 where nothing is known of it.
    names : sequence of K str
        Of the pictures; empty where they have none.
    lights : ndarray of float32, shape (N, 3), optional
        Directions of the projector's rays, where these are single lights.
    validation : ndarray of bool, shape (K,), or empty
        Pictures that no fit sees and that tell its error.

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
    validation: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))

    def __post_init__(self) -> None:
        rays = prod(ray_shape(self.camera_shape, "camera_shape"))
        lights = prod(ray_shape(self.projector_shape, "projector_shape"))
        count = len(self.patterns)
        pictures = (count, self.channels, rays)
        patterns = np.asarray(self.patterns)
        if patterns.ndim == 2:
            object.__setattr__(self, "patterns", patterns[:, None])
        shown = (count, 1 if patterns.shape[1:-1] in ((), (1,)) else self.channels, lights)
        for name, shape in (
            ("patterns", shown), ("radiance", pictures), ("variance", pictures)
        ):  # fmt: skip
            values = np.asarray(getattr(self, name))  # of other libraries, too
            object.__setattr__(self, name, values)
            if values.shape != shape:
                raise InputError(f"{name} has the shape {values.shape}; expected {shape}")
            if not np.isfinite(values).all() or (name != "radiance" and (values < 0).any()):
                raise InputError(f"{name} should be finite and not negative, every value")
        if self.channels not in (1, 3):
            raise InputError(f"pictures have {self.channels} channels; expected 1 or 3")
        if not self.patterns.any(axis=(0, 2)).all():
            raise InputError("all patterns are dark, or there are none: they tell nothing of light")

    @property
    def channels(self) -> int:
        """Colour channels."""
        return int(self.radiance.shape[1])

    def by_light(self) -> list[Series]:
        """Return what is lit alike: all channels, or of coloured patterns each by itself."""
        if self.patterns.shape[1] == 1:
            return [self]
        return [
            replace(self, **{name: getattr(self, name)[:, [channel]] for name in _ARRAYS})
            for channel in range(self.channels)
        ]

    @property
    def rank(self) -> int:
        """Number of independent patterns, of coloured ones in the channel that has the fewest."""
        patterns = np.moveaxis(self.patterns, 1, 0).astype(np.float64)
        values = np.linalg.eigvalsh(patterns @ patterns.swapaxes(1, 2))
        return int(np.count_nonzero(values > 1e-10 * values[:, -1:], axis=1).min())

    @property
    def is_complete(self) -> bool:
        """Whether the patterns tell of each ray by itself."""
        lights = self.patterns.shape[-1]
        return bool(len(self.patterns) >= lights and self.rank == lights)

    def some(self, chosen: NDArray[np.int64]) -> Series:
        """Return some of the pictures, none of them for validation."""
        parts = {name: getattr(self, name)[chosen] for name in _ARRAYS}
        names = [self.names[index] for index in chosen] if self.names else ()
        return replace(self, **parts, names=names, validation=np.zeros(0, np.bool_))

    @property
    def training(self) -> Series:
        """The pictures that aren't for validation."""
        every = np.arange(len(self.patterns))
        return self.some(np.setdiff1d(every, np.flatnonzero(self.validation)))


def read_series(
    folder: Path,
    *,
    lights: tuple[int, int] | None = None,
    camera: CameraModel | None = None,
    black: Path | None = None,
    transfer: Curve | None = None,
) -> Series:
    """Read pictures and their patterns.

    Parameters
    ----------
    folder : Path
        Pictures lie in its folder ``pictures``, or in itself; patterns as pictures in its folder
        ``patterns``, or in ``patterns.npy``, (pictures, H, W) of weights. Both are taken in the
        order of the numbers in their names, and that of the parts of an EXR file. Or an EXR file of
        many parts. Or photographs lie in ``ref``, ``train`` and ``test`` (for validation) in
        ``cam/raw`` or ``cam/warp``, and their patterns in folders named so in it, in its ``prj`` or
        ``prj_share``, or likewise up to three folders above it.
    lights : (int, int), optional
        Pictures of one light at a time, in so many rows and columns, which go before patterns. By
        default a row of an EXR file's, and where one of `LIGHT_FILES` lies in place of patterns.
    camera : CameraModel, optional
        Numbers of the camera, whose brackets are merged, with their variance. None takes pictures
        as light: one exposure of each pattern.
    black : Path, optional
        A picture without light, or a folder of some, to be subtracted as all-off pictures are.
    transfer : {"linear", "srgb"}
        What integers in pictures mean, and those in pictures of patterns; with ``cam`` sRGB by
        default.

    Raises
    ------
    InputError
        When a picture can't be read or holds NaN, or number, size or channels don't fit together.
    """
    step, directions = len(camera.exposures) if camera else 1, None
    photographs = [at for at in (folder / "cam/raw", folder / "cam/warp") if at.is_dir()]
    curve: Curve = transfer or ("srgb" if photographs else "linear")
    if photographs and not lights:
        brackets, weights, validation = _of_papers(folder, photographs[0], step, curve)
    else:
        subfolder = folder / "pictures"
        brackets = _brackets(subfolder if subfolder.is_dir() else folder, step)
        if folder.is_file() and len(brackets) < 2:
            raise InputError(
                f"{folder}: holds one picture; expected EXR with a part for each light"
            )
        directions = lights_in(folder, [bracket[0].name for bracket in brackets])
        row = len(brackets) if folder.is_file() or directions is not None else 0
        weights = _weights(folder, lights, row, curve)
        validation = np.zeros(len(brackets), np.bool_)
        if directions is not None:
            count = prod(weights.shape[1:3])
            as_directions(directions, f"{folder}: its file of lights", count)
    if weights.ndim not in (3, 4) or len(weights) != len(brackets):
        raise InputError(
            f"{folder}: holds {len(brackets)} pictures of {len(weights)} patterns, an array "
            f"{weights.shape}; expected one each, (pictures, H, W) or (pictures, H, W, 3)"
        )
    parts = [part for bracket in brackets for part in bracket]
    headers = [part.header for part in parts]
    for part, header in zip(parts, headers, strict=True):
        if replace(header, exposure_s=None) != replace(headers[0], exposure_s=None):
            raise InputError(
                f"{part}: is {header}; {parts[0]} is {headers[0]}. All should be alike"
            )
    patterns = weights.reshape(len(weights), prod(weights.shape[1:3]), -1)
    patterns = np.moveaxis(patterns.astype(np.float32, copy=False), -1, 1)
    lit = np.asarray(patterns.any(axis=(1, 2)))
    dark = [files for files, is_lit in zip(brackets, lit, strict=True) if not is_lit]
    dark += _brackets(black, step) if black else []
    brackets = [files for files, is_lit in zip(brackets, lit, strict=True) if is_lit]
    if camera:
        radiance, variance = _merged(camera, brackets, headers[0], dark)
    else:
        seconds = [header.exposure_s or 0 for header in headers]
        differ = min(seconds) > 0 and max(seconds) > 1.01 * min(seconds)
        radiance = np.stack([_light(part, curve, differ) for [part] in brackets])
        if dark:
            darkness = [_light(part, curve, differ) for [part] in dark]
            radiance -= np.mean(darkness, axis=0, dtype=np.float64).astype(np.float32)
        variance = np.zeros_like(radiance)
    names, shapes = [files[0].name for files in brackets], (headers[0].size, weights.shape[1:3])
    return Series(*shapes, patterns[lit], radiance, variance, names, directions, validation[lit])


def _of_papers(
    folder: Path, photographs: Path, step: int, curve: Curve
) -> tuple[list[list[Part]], NDArray[Any], NDArray[np.bool_]]:
    """Return reference, training and validation pictures, patterns, and which are the last."""
    above = (folder, *folder.absolute().parents[:3])
    brackets, files, validation = list[list[Part]](), list[Path](), list[bool]()
    for name in ("ref", "train", "test"):
        places = (at / kind / name for at in above for kind in ("", "prj", "prj_share"))
        shown = next((place for place in places if place.is_dir()), folder / name)
        taken = photographs / name
        if name != "train" and not (taken.is_dir() and shown.is_dir()):
            continue
        some, patterns = _brackets(taken, step), picture_files(shown, _OTHERS)
        if name == "ref" and len(some) != len(patterns):
            continue  # those of a setup may be others
        if not shown.is_relative_to(folder):
            patterns = patterns[: len(some)]  # setups that share them may take the first alone
        alone = {bracket[0].file.stem for bracket in some} ^ {file.stem for file in patterns}
        if alone or len(some) != len(patterns):
            raise InputError(
                f"{taken}: holds {len(some)} pictures of the {len(patterns)} patterns in "
                f"{shown}; expected one of each name, alone are {', '.join(sorted(alone)[:4])}"
            )
        brackets, files = brackets + some, files + patterns
        validation += [name == "test"] * len(some)
    return brackets, _patterns(files, curve), np.array(validation)


def _brackets(place: Path, step: int) -> list[list[Part]]:
    """Return the pictures of a folder, or of a file, so many in a bracket."""
    files = [place] if place.is_file() else picture_files(place, _OTHERS)
    parts = [part for file in files for part in read_parts(file)]
    if len(parts) % step:
        raise InputError(
            f"{place}: holds {len(parts)} pictures, no multiple of the {step} exposures of the "
            "settings' camera"
        )
    return [parts[first : first + step] for first in range(0, len(parts), step)]


def _weights(folder: Path, lights: tuple[int, int] | None, row: int, curve: Curve) -> NDArray[Any]:
    """Return patterns as (K, H, W), or (K, H, W, 3); without any, those of a row of lights."""
    subfolder, array = folder / "patterns", folder / "patterns.npy"
    if not lights:
        if array.is_file():
            return np.asarray(np.load(array, allow_pickle=False))
        if subfolder.is_dir():
            return _patterns(picture_files(subfolder, _OTHERS), curve)
        lights = 1, row
    if not prod(lights):
        raise InputError(
            f"{folder}: has no patterns; expected a folder {subfolder.name} of pictures, or "
            f"{array.name}, or, for one light at a time, --lights or a file of their directions"
        )
    return np.eye(prod(lights), dtype=np.float32).reshape(-1, *lights)


def _patterns(files: list[Path], curve: Curve) -> NDArray[Any]:
    """Return patterns of one size in pictures, (K, H, W), or (K, H, W, 3) if any is coloured."""
    parts = [part for file in files for part in read_parts(file)]
    for part in parts:
        if part.header.size != parts[0].header.size:
            raise InputError(f"{part} has another size than {parts[0]}; patterns have one")
    pictures = np.stack([np.broadcast_to(_linear(p, curve), (*p.header.size, 3)) for p in parts])
    return pictures if np.ptp(pictures, axis=-1).any() else pictures[..., 0]


def _light(part: Part, curve: Curve, over_time: bool) -> Float:
    """Return a picture as light, (C, M), over its exposure time where asked."""
    light = _planar(_linear(part, curve))
    return light / np.float32(part.header.exposure_s) if over_time else light


def _linear(part: Part, curve: Curve) -> Float:
    """Return a picture's values as linear light; integers go from 0 to 1."""
    picture = part.read()
    if picture.header.kind == "counts":
        return picture_weights(picture.pixels.astype(f"uint{picture.bits}"), curve)
    if not np.isfinite(picture.pixels).all():
        raise InputError(f"{part}: holds NaN or infinite light; every value should be finite")
    return np.asarray(picture.pixels, np.float32)


def _planar(image: Float) -> Float:
    """Return (C, M) of (H, W, C)."""
    return np.ascontiguousarray(image.reshape(-1, image.shape[-1]).T)


def _merged(
    camera: CameraModel, brackets: list[list[Part]], header: Header, dark: list[list[Part]]
) -> tuple[Float, Float]:
    """Return merged brackets and their variance, (K, C, M) each."""
    if header.kind != "counts":
        raise InputError(f"{brackets[0][0]}: holds light; the settings' camera counts")
    shape = camera.frame_shape(header.size, header.channels if camera.bayer is None else 3)

    def frames(parts: list[Part]) -> NDArray[Any]:
        return np.stack([part.read().pixels for part in parts]).reshape(shape)

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
