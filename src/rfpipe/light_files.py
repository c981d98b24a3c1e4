"""Files of lights beside pictures of one light at a time: directions, names and intensities."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.environment import as_directions
from rfpipe.errors import InputError
from rfpipe.output import write_atomically
from rfpipe.pictures.lists import read_directions, read_numbers, read_text
from rfpipe.pictures.names import match_names

LIGHT_FILES = ("[!.]*.lp", "light_directions.txt", "lights.txt", "light_pos.npy", "lights.npy")
"""Names of files with the directions or positions of lights; case does not matter."""

INTENSITY_FILE = "light_intensities.txt"
"""Name of the file with the intensities of lights, beside the file of their directions."""

PICTURE_LIST = "filenames.txt"
"""Name of the file that lists the pictures in the order of the lights (DiLiGenT data sets)."""


@dataclass(frozen=True)
class _Lights:
    """Contents of a file of lights.

    Attributes
    ----------
    path : Path
        File with the names, or with the directions if there are no names.
    names : tuple of str
        Names of the pictures; may be empty.
    directions : ndarray of float32, shape (lights, 3)
    """

    path: Path
    names: tuple[str, ...]
    directions: Float


def light_file_in(folder: Path, *, parent: bool = False) -> Path | None:
    """Path of the file of lights that `lights_in` reads, or None. Parameters as `lights_in`.

    InputError if there are several.
    """
    return _file_in(folder, LIGHT_FILES, parent)


def lights_in(folder: Path, pictures: Sequence[str], *, parent: bool = False) -> Float | None:
    """Read the directions of lights from the file of `LIGHT_FILES` that lies beside pictures.

    Parameters
    ----------
    folder : Path
        The file lies in it or in its folder ``pictures``.
    pictures : sequence of str
        Names of the pictures, one for each light.
    parent : bool
        Where the folder has no such file, take the one in the folder that contains it.

    Returns
    -------
    ndarray of float32, shape (pictures, 3), or None
        In the pictures' order; None without a file.

    Raises
    ------
    InputError
        If there are several files, and as `read_lights`.
    """
    path = light_file_in(folder, parent=parent)
    return None if path is None else read_lights(path, pictures)


def light_names_in(
    folder: Path, pictures: Sequence[str] = (), *, parent: bool = False
) -> tuple[str, ...]:
    """Names of pictures in the file of lights that `lights_in` reads, in the file's order.

    Empty if there is no such file, or it has no names. Parameters and errors as `lights_in`.
    """
    path = light_file_in(folder, parent=parent)
    return () if path is None else _read(path, pictures).names


def read_lights(path: str | Path, pictures: Sequence[str] = ()) -> Float:
    """Read the directions of lights from a file, or their positions around the scene.

    Parameters
    ----------
    path : path
        A ``.npy`` array (lights, 3); or text with a line ``x y z`` or ``name x y z`` for each
        light, as in the ``.lp`` files of RTI. The first line may be the number of lights. Spaces,
        tabs, commas or semicolons separate; further columns, such as colours, are not used; ``#``
        and ``//`` begin comments; UTF-8, or UTF-16 with its byte order mark.
    pictures : sequence of str
        Names of pictures of one light each. Lines that name pictures are matched by the names
        without folder and ending, whatever their case and Unicode form, else by the numbers in
        them. Lines without names are in the order of the pictures, or of a file
        ``filenames.txt`` in the same folder.

    Returns
    -------
    ndarray of float32, shape (lights, 3)
        In the pictures' order; without `pictures`, in the file's.

    Raises
    ------
    InputError
        If the file can't be read, contains something else or another number of lights than its
        first line says; if a light has no direction; if lights and pictures do not match one to
        one.
    """
    lights = _read(Path(path), pictures)
    return lights.directions[_order(lights, pictures)] if pictures else lights.directions


def write_directions(
    path: Path, pictures: Sequence[str], directions: Iterable[NDArray[np.floating]]
) -> None:
    """Write an ``.lp`` file of RTI: a line ``name x y z`` for the light of each picture."""
    pairs = zip(pictures, directions, strict=True)
    lines = [" ".join([name, *(f"{value:.7g}" for value in light)]) for name, light in pairs]
    content = "\n".join([str(len(lines)), *lines, ""])
    write_atomically(path, content.encode(), resumes=False)


def intensities_in(folder: Path, pictures: Sequence[str], *, parent: bool = False) -> Float | None:
    """Read the intensities of lights from ``light_intensities.txt`` beside pictures.

    The file has a line for each light, of 1 number, or of 3 for R, G and B, as in the DiLiGenT data
    sets. Lines are in the order of the file of lights.

    Parameters
    ----------
    folder, pictures, parent
        As `lights_in`.

    Returns
    -------
    ndarray of float32, shape (pictures, 1) or (pictures, 3), or None
        Relative intensities, above 0, in the pictures' order; None without a file.

    Raises
    ------
    InputError
        If the file contains something else, or another number of lines than there are lights.
    """
    path = _file_in(folder, (INTENSITY_FILE,), parent)
    if path is None:
        return None
    values = read_numbers(path)
    if values.shape[1] not in (1, 3) or not (np.isfinite(values) & (values > 0)).all():
        raise InputError(
            f"{path}: an array {values.shape} of values from {values.min():g} to "
            f"{values.max():g}; expected intensities above 0, 1 or 3 per line"
        )
    file = light_file_in(folder, parent=parent)
    lights = _Lights(path, (), values) if file is None else _read(file, pictures)
    if len(lights.directions) != len(values):
        raise InputError(
            f"{path}: has {len(values)} lines; {lights.path} has {len(lights.directions)} lights. "
            "Give one line for each light"
        )
    return values[_order(lights, pictures)]


def _order(lights: _Lights, pictures: Sequence[str]) -> NDArray[np.int64]:
    """Index of each picture's light."""
    if lights.names:
        return match_names(lights.names, pictures, f"{lights.path}")
    if len(lights.directions) != len(pictures):
        raise InputError(
            f"{lights.path}: {len(lights.directions)} directions of lights for {len(pictures)} "
            "pictures, and no names of pictures; expected one for each"
        )
    return np.arange(len(pictures))


def _file_in(folder: Path, names: Sequence[str], parent: bool) -> Path | None:
    """Path of the one file of some names in a folder or its pictures; else in its parent."""
    files = _files_in(folder, names) + _files_in(folder / "pictures", names)
    if not files and parent:
        files = _files_in(folder.absolute().parent, names)
    if len(files) > 1:
        raise InputError(
            f"{folder}: has several files of lights, {', '.join(map(str, files))}; keep one of them"
        )
    return files[0] if files else None


def _files_in(folder: Path, names: Sequence[str]) -> list[Path]:
    if not folder.is_dir():
        return []
    return [
        file
        for file in sorted(folder.iterdir())
        if file.is_file() and any(fnmatch(file.name.lower(), name) for name in names)
    ]


def _read(path: Path, pictures: Sequence[str]) -> _Lights:
    """Read a file of lights; names of pictures determine which numbers are x, y and z."""
    if path.suffix.lower() == ".npy":
        names, array = list[str](), _load_array(path)
    else:
        names, array = read_directions(path, pictures)
    directions = as_directions(array, f"{path}: lights")
    picture_list = path.with_name(PICTURE_LIST)
    if any(names) or not picture_list.is_file():
        return _Lights(path, tuple(filter(None, names)), directions)
    return _Lights(picture_list, _listed(picture_list, len(directions)), directions)


def _load_array(path: Path) -> Float:
    try:
        array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: not an array of lights: {error}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        kind = getattr(array, "dtype", "several arrays")
        raise InputError(f"{path}: expected an array (lights, 3) of real numbers, got {kind}")
    return array.astype(np.float32)


def _listed(file: Path, count: int) -> tuple[str, ...]:
    """Names of pictures in a list."""
    names = tuple(line.strip() for line in read_text(file).splitlines() if line.strip())
    if len(names) != count:
        raise InputError(
            f"{file}: lists {len(names)} pictures for {count} lights; expected one name for each"
        )
    return names
