"""Picture files of a folder and the patterns that they show, before any pixel is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.environment import as_directions
from rfpipe.errors import InputError
from rfpipe.fitting.codes import code_patterns
from rfpipe.fitting.names import SortedPictures, sort_pictures
from rfpipe.fitting.patterns import Patterns
from rfpipe.light_files import (
    intensities_in,
    light_file_in,
    light_names_in,
    lights_in,
    read_lights,
)
from rfpipe.pictures import Part, check_sequence, picture_files, read_parts
from rfpipe.weights import Curve

_OTHERS = (".hdr", ".jpeg", ".jpg")


@dataclass(frozen=True)
class Listing:
    """Pictures in a folder with their patterns.

    Attributes
    ----------
    brackets : sequence of sequences of Part
        Exposures of each pattern.
    patterns : Patterns
        Pattern of each bracket.
    validation : ndarray of bool, shape (K,)
        True for pictures that no fit uses.
    dark : sequence of sequences of Part
        Brackets without the projector's light, in addition to those of black patterns.
    directions : ndarray of float32, shape (K, 3), or None
        Direction of each picture's light.
    intensities : ndarray of float32, shape (K, 1) or (K, 3), or None
        Intensity of each picture's light, by which its linear light has to be divided.
    mask : Part or None
        Mask of the object.
    notes : sequence of str
        Roles of files that don't show a pattern, for the user.
    are_single_lights : bool
        True if each pattern is a single light.
    """

    brackets: Sequence[Sequence[Part]]
    patterns: Patterns
    validation: NDArray[np.bool_]
    dark: Sequence[Sequence[Part]] = ()
    directions: Float | None = None
    intensities: Float | None = None
    mask: Part | None = None
    notes: Sequence[str] = ()
    are_single_lights: bool = False


@dataclass(frozen=True)
class _Brackets:
    """Reader of pictures in brackets; raw files are developed or read as mosaics."""

    exposures: int
    develop_raw: bool

    def of_place(self, place: Path) -> list[list[Part]]:
        """List the pictures of a folder or file in brackets."""
        files = [place] if place.is_file() else picture_files(place, _OTHERS)
        return self.of_files(place, files)

    def of_files(self, place: Path, files: Sequence[Path]) -> list[list[Part]]:
        """List the pictures of files in brackets; InputError if a bracket is incomplete."""
        parts = [part for file in files for part in read_parts(file, develop_raw=self.develop_raw)]
        if len(parts) % self.exposures:
            raise InputError(
                f"{place}: contains {len(parts)} pictures; expected a multiple of the "
                f"{self.exposures} exposures of the settings' camera"
            )
        starts = range(0, len(parts), self.exposures)
        return [parts[first : first + self.exposures] for first in starts]


def list_pictures(
    folder: Path,
    *,
    lights: tuple[int, int] | None = None,
    patterns: str | None = None,
    exposures: int = 1,
    black: Path | None = None,
    ambient: Path | None = None,
    curve: Curve | None = None,
    develop_raw: bool = False,
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
    patterns : str, optional
        Name of a code, whose patterns the pictures show, as for
        `rfpipe.fitting.codes.code_patterns`.
    exposures : int
        Pictures of each pattern.
    black, ambient : Path, optional
        A picture without the projector's light, or a folder of some.
    curve : {"linear", "srgb"}, optional
        Transfer curve of pictures of patterns; by default sRGB with ``cam``, else linear.
    develop_raw : bool
        Read raw files as linear colours, for pictures without a model of their camera; else as
        mosaics.

    Raises
    ------
    InputError
        When a file is missing or can't be read, numbers of pictures and patterns differ, or names
        are those of several pictures, or do not sort in the order of taking.
    """
    photographs = [at for at in (folder / "cam/raw", folder / "cam/warp") if at.is_dir()]
    curve = curve or default_curve(folder)
    read = _Brackets(exposures, develop_raw)
    unlit = [path for path in (black, ambient) if path]
    if folder.is_file():
        listing = _list_parts(folder, lights, read)
    elif photographs and not lights and not patterns:
        listing = Listing(*_of_papers(folder, photographs[0], read, curve))
    else:
        listing = _list_folder(folder, lights or patterns, read, unlit, curve)
        if listing.patterns.largest > 1:
            note = f"{folder / 'patterns.npy'}: has weights up to {listing.patterns.largest:g}"
            listing = replace(listing, notes=[*listing.notes, f"{note}; 1 is fully on"])
    if len(listing.patterns) != len(listing.brackets):
        raise InputError(
            f"{folder}: holds {len(listing.brackets)} pictures of {len(listing.patterns)} "
            "patterns; expected one of each"
        )
    dark = [bracket for path in unlit for bracket in read.of_place(path)]
    return replace(listing, dark=[*dark, *listing.dark])


def _list_parts(file: Path, lights: tuple[int, int] | None, read: _Brackets) -> Listing:
    """List the parts of an EXR file, one light each."""
    brackets = read.of_place(file)
    if len(brackets) < 2:
        raise InputError(f"{file}: holds one picture; expected EXR with a part for each light")
    patterns = Patterns.single_lights(*(lights or (1, len(brackets))))
    validation, light_file = np.zeros(len(brackets), np.bool_), file.with_suffix(".lp")
    directions = None
    if light_file.is_file():
        directions = read_lights(light_file, [bracket[0].name for bracket in brackets])
        as_directions(directions, str(light_file), prod(patterns.shape))
    return Listing(brackets, patterns, validation, directions=directions, are_single_lights=True)


def _list_folder(
    folder: Path,
    light: tuple[int, int] | str | None,
    read: _Brackets,
    unlit: Sequence[Path],
    curve: Curve,
) -> Listing:
    """List the pictures in a folder, except `unlit` ones, and their patterns or lights.

    `light` is the rows and columns of single lights, or the name of a code.
    """
    subfolder = folder / "pictures"
    files = picture_files(subfolder if subfolder.is_dir() else folder, _OTHERS)
    excluded = {path.absolute() for path in unlit}
    files = [file for file in files if file.absolute() not in excluded]
    patterns = None if light else _patterns(folder, curve)
    is_by_light = patterns is None and not isinstance(light, str)
    # a file of lights for several objects lies in the folder that contains theirs
    above = is_by_light and light is None
    light_names = light_names_in(folder, [file.name for file in files], parent=above)
    files_by_role = sort_pictures(files, light_names)
    notes = check_sequence(files_by_role.pictures, ordered=not light_names)
    light_file = light_file_in(folder, parent=above)
    if light_file and light_file.parent == folder.absolute().parent:
        notes.append(f"takes the directions of lights from the folder above, {light_file}")
    brackets = read.of_files(folder, files_by_role.pictures)
    names = [bracket[0].name for bracket in brackets]
    directions = lights_in(folder, names, parent=above)
    if isinstance(light, str):
        means = [_mean_light(bracket) for bracket in brackets]
        patterns = code_patterns(light, len(brackets), means)
    elif light or directions is not None:
        patterns = patterns or Patterns.single_lights(*(light or (1, len(brackets))))
    if patterns is None:
        raise _missing_patterns(folder)
    if directions is not None:
        as_directions(directions, f"{folder}: its file of lights", prod(patterns.shape))
    return Listing(
        brackets,
        patterns,
        np.zeros(len(brackets), np.bool_),
        read.of_files(folder, files_by_role.ambient),
        directions,
        intensities_in(folder, names, parent=above) if is_by_light else None,
        None if files_by_role.mask is None else read_parts(files_by_role.mask)[0],
        [*_notes(files_by_role), *(f"{folder}: {note}" for note in notes)],
        is_by_light,
    )


def _missing_patterns(folder: Path) -> InputError:
    return InputError(
        f"{folder}: has no patterns; expected a folder 'patterns' of pictures, or patterns.npy, "
        "or --patterns with the name of a code, or, for one light at a time, --lights or a file "
        "with the lights' directions"
    )


def _mean_light(bracket: Sequence[Part]) -> float:
    """Return the mean of a bracket's brightest exposure, in counts or light."""
    return max(float(part.read().pixels.mean()) for part in bracket)


def _notes(files: SortedPictures) -> list[str]:
    """Return notes on the roles of files that show no pattern."""
    notes = [] if files.mask is None else [f"{files.mask}: taken as the mask, by its name"]
    notes += [f"{file}: subtracted as ambient light, by its name" for file in files.ambient]
    return notes + [f"{file}: left out, a result by its name" for file in files.ignored]


def default_curve(folder: Path) -> Curve:
    """Return the transfer curve of a folder's pictures: sRGB with ``cam``, else linear."""
    return "srgb" if any((folder / "cam" / name).is_dir() for name in ("raw", "warp")) else "linear"


def _of_papers(
    folder: Path, photographs: Path, read: _Brackets, curve: Curve
) -> tuple[list[list[Part]], Patterns, NDArray[np.bool_]]:
    """List reference, training and validation pictures, with patterns and a validation mask."""
    above = (folder, *folder.absolute().parents[:3])
    brackets, files, validation = list[list[Part]](), list[Path](), list[bool]()
    for name in ("ref", "train", "test"):
        candidates = (root / kind / name for root in above for kind in ("", "prj", "prj_share"))
        existing = (candidate for candidate in candidates if candidate.is_dir())
        pattern_folder = next(existing, folder / name)
        subfolder = photographs / name
        if name != "train" and not (subfolder.is_dir() and pattern_folder.is_dir()):
            continue
        pictures, patterns = read.of_place(subfolder), picture_files(pattern_folder, _OTHERS)
        if name == "ref" and len(pictures) != len(patterns):
            continue  # a setup may have reference pictures of other patterns
        if not pattern_folder.is_relative_to(folder):
            patterns = patterns[: len(pictures)]  # a setup may use only the first shared patterns
        unpaired = {bracket[0].file.stem for bracket in pictures} ^ {file.stem for file in patterns}
        if unpaired or len(pictures) != len(patterns):
            raise InputError(
                f"{subfolder}: contains {len(pictures)} pictures for the {len(patterns)} patterns "
                f"in {pattern_folder}; expected a picture for each pattern, with the same name. "
                f"Without a partner: {', '.join(sorted(unpaired)[:4])}"
            )
        brackets, files = brackets + pictures, files + patterns
        validation += [name == "test"] * len(pictures)
    return brackets, Patterns.of_files(files, curve), np.array(validation)


def _patterns(folder: Path, curve: Curve) -> Patterns | None:
    """Read the patterns in a folder; None without patterns."""
    subfolder, file = folder / "patterns", folder / "patterns.npy"
    if file.is_file():
        try:
            weights = np.load(file, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(f"{file}: can't be read as an array of patterns: {error}") from None
        return Patterns.of_array(weights, f"{file}")
    if subfolder.is_dir():
        files = picture_files(subfolder, _OTHERS)
        check_sequence(files)
        return Patterns.of_files(files, curve)
    return None
