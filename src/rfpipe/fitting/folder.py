"""Picture files of a folder and the patterns that they show, before any pixel is read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.environment import as_directions
from rfpipe.errors import InputError
from rfpipe.light_files import lights_in
from rfpipe.pictures.files import Part, picture_files, read_parts
from rfpipe.weights import Curve, picture_weights

Float = NDArray[np.float32]

_OTHERS = (".bmp", ".hdr", ".jpeg", ".jpg", ".pfm")


@dataclass(frozen=True)
class Patterns:
    """Patterns of one size, read one at a time.

    Attributes
    ----------
    shape : (int, int)
        Height and width in projector pixels.
    readers : sequence of callable
        Each returns one pattern: weights, at least 0, shape (H, W) or (H, W, 3).
    """

    shape: tuple[int, int]
    readers: Sequence[Callable[[], NDArray[Any]]] = field(repr=False)

    def __len__(self) -> int:
        """Return the number of patterns."""
        return len(self.readers)

    @classmethod
    def of_array(cls, weights: NDArray[Any], name: str) -> Patterns:
        """Take patterns from an array (K, H, W) or (K, H, W, 3); InputError for another shape."""
        if weights.ndim not in (3, 4) or (weights.ndim == 4 and weights.shape[3] not in (1, 3)):
            raise InputError(
                f"{name}: an array {weights.shape}; expected (pictures, H, W) or "
                "(pictures, H, W, 3)"
            )
        return cls(
            weights.shape[1:3], [partial(weights.__getitem__, k) for k in range(len(weights))]
        )

    @classmethod
    def of_files(cls, files: Sequence[Path], curve: Curve) -> Patterns:
        """Take patterns from picture files of one size; InputError where sizes differ."""
        parts = [part for file in files for part in read_parts(file)]
        for part in parts:
            if part.header.size != parts[0].header.size:
                raise InputError(f"{part} has another size than {parts[0]}; patterns have one")
        return cls(parts[0].header.size, [partial(linear_light, part, curve) for part in parts])

    @classmethod
    def single_lights(cls, rows: int, columns: int) -> Patterns:
        """Take one light at a time, of lights in rows and columns."""

        def light(index: int) -> Float:
            lit = np.zeros(rows * columns, np.float32)
            lit[index] = 1
            return lit.reshape(rows, columns)

        return cls((rows, columns), [partial(light, index) for index in range(rows * columns)])


@dataclass(frozen=True)
class Listing:
    """Pictures in a folder, and their patterns.

    Attributes
    ----------
    brackets : sequence of sequences of Part
        The exposures of each pattern.
    patterns : Patterns
        One for each bracket.
    validation : ndarray of bool, shape (K,)
        Pictures that are kept from all fits.
    dark : sequence of sequences of Part
        Brackets without light, beside those of black patterns.
    directions : ndarray of float32, shape (K, 3), or None
        Directions of lights, one for each picture.
    """

    brackets: Sequence[Sequence[Part]]
    patterns: Patterns
    validation: NDArray[np.bool_]
    dark: Sequence[Sequence[Part]] = ()
    directions: Float | None = None


def list_pictures(
    folder: Path,
    *,
    lights: tuple[int, int] | None = None,
    exposures: int = 1,
    black: Path | None = None,
    curve: Curve | None = None,
) -> Listing:
    """List the pictures in a folder and pair them with their patterns.

    Parameters
    ----------
    folder : Path
        Pictures lie in its folder ``pictures``, or in itself; patterns as pictures in its folder
        ``patterns``, or in ``patterns.npy``, (pictures, H, W) of weights. Both are sorted by the
        numbers in their names, parts of an EXR file by their order. Or an EXR file of several
        parts. Or photographs in ``ref``, ``train`` and ``test`` (for validation) of ``cam/raw`` or
        ``cam/warp``, with patterns in folders of these names in it, in its ``prj`` or
        ``prj_share``, or likewise up to three folders above it.
    lights : (int, int), optional
        Rows and columns of lights, of which one is on in each picture. By default the parts of an
        EXR file, and the pictures beside a file of lights, are one light each.
    exposures : int
        Pictures of each pattern.
    black : Path, optional
        A picture without light, or a folder of some.
    curve : {"linear", "srgb"}, optional
        Transfer curve of pictures of patterns; by default sRGB with ``cam``, else linear.

    Raises
    ------
    InputError
        When a file is missing or can't be read, or numbers of pictures and patterns differ.
    """
    photographs = [at for at in (folder / "cam/raw", folder / "cam/warp") if at.is_dir()]
    curve = curve or default_curve(folder)
    directions = None
    if photographs and not lights:
        brackets, patterns, validation = _of_papers(folder, photographs[0], exposures, curve)
    else:
        subfolder = folder / "pictures"
        brackets = _brackets(subfolder if subfolder.is_dir() else folder, exposures)
        if folder.is_file() and len(brackets) < 2:
            raise InputError(
                f"{folder}: holds one picture; expected EXR with a part for each light"
            )
        directions = lights_in(folder, [bracket[0].name for bracket in brackets])
        row = len(brackets) if folder.is_file() or directions is not None else 0
        patterns = _patterns(folder, lights, row, curve)
        validation = np.zeros(len(brackets), np.bool_)
        if directions is not None:
            as_directions(directions, f"{folder}: its file of lights", prod(patterns.shape))
    if len(patterns) != len(brackets):
        raise InputError(
            f"{folder}: holds {len(brackets)} pictures of {len(patterns)} patterns; "
            "expected one of each"
        )
    dark = _brackets(black, exposures) if black else []
    return Listing(brackets, patterns, validation, dark, directions)


def default_curve(folder: Path) -> Curve:
    """Return the transfer curve of a folder's pictures: sRGB with ``cam``, else linear."""
    return "srgb" if any((folder / "cam" / name).is_dir() for name in ("raw", "warp")) else "linear"


def linear_light(part: Part, curve: Curve) -> Float:
    """Read a picture as linear light, (H, W) or (H, W, 3); integers go from 0 to 1."""
    picture = part.read()
    if picture.header.kind == "counts":
        light = picture_weights(picture.pixels.astype(f"uint{picture.bits}"), curve)
    else:
        light = np.asarray(picture.pixels, np.float32)
        if not np.isfinite(light).all():
            raise InputError(f"{part}: holds NaN or infinite light; every value should be finite")
    return light[..., 0] if light.shape[-1] == 1 else light


def _of_papers(
    folder: Path, photographs: Path, exposures: int, curve: Curve
) -> tuple[list[list[Part]], Patterns, NDArray[np.bool_]]:
    """List reference, training and validation pictures, their patterns, and which validate."""
    above = (folder, *folder.absolute().parents[:3])
    brackets, files, validation = list[list[Part]](), list[Path](), list[bool]()
    for name in ("ref", "train", "test"):
        places = (at / kind / name for at in above for kind in ("", "prj", "prj_share"))
        shown = next((place for place in places if place.is_dir()), folder / name)
        taken = photographs / name
        if name != "train" and not (taken.is_dir() and shown.is_dir()):
            continue
        some, patterns = _brackets(taken, exposures), picture_files(shown, _OTHERS)
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
    return brackets, Patterns.of_files(files, curve), np.array(validation)


def _brackets(place: Path, exposures: int) -> list[list[Part]]:
    """List the pictures of a folder, or of a file, in brackets."""
    files = [place] if place.is_file() else picture_files(place, _OTHERS)
    parts = [part for file in files for part in read_parts(file)]
    if len(parts) % exposures:
        raise InputError(
            f"{place}: holds {len(parts)} pictures, no multiple of the {exposures} exposures of "
            "the settings' camera"
        )
    return [parts[first : first + exposures] for first in range(0, len(parts), exposures)]


def _patterns(folder: Path, lights: tuple[int, int] | None, row: int, curve: Curve) -> Patterns:
    """Return a folder's patterns; without any, those of a row of lights."""
    subfolder, array = folder / "patterns", folder / "patterns.npy"
    if not lights:
        if array.is_file():
            return Patterns.of_array(np.load(array, allow_pickle=False), str(array))
        if subfolder.is_dir():
            return Patterns.of_files(picture_files(subfolder, _OTHERS), curve)
        lights = 1, row
    if not prod(lights):
        raise InputError(
            f"{folder}: has no patterns; expected a folder {subfolder.name} of pictures, or "
            f"{array.name}, or, for one light at a time, --lights or a file of their directions"
        )
    return Patterns.single_lights(*lights)
