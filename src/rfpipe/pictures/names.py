"""Names of pictures, matched to the names in a list."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PureWindowsPath
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.pictures.files import RAW

_ENDING = re.compile(
    r"\.(bmp|exr|gif|hdr|heic|jp2|jpe?g|p[bfgnp]m|png|psd|tga|tiff?|webp|"
    + "|".join(suffix[1:] for suffix in RAW)
    + r")$",
    re.IGNORECASE,
)


def is_picture_name(name: str) -> bool:
    """Test whether a name ends as a picture's, of a format that rfpipe reads or another one."""
    return _ENDING.search(name) is not None


def stem_key(name: str) -> str:
    """Name of a picture without folder and ending, in one case and Unicode form."""
    name = PureWindowsPath(name.strip().strip("\"'")).name
    return normalize("NFC", _ENDING.sub("", name)).casefold()


def match_names(
    lines: Sequence[str], pictures: Sequence[str], source: str = "the list"
) -> NDArray[np.int64]:
    """Match pictures to the lines of a list that names them.

    A picture's line has the same name, without folder and ending, whatever its case and Unicode
    form. Where some pictures have no such line, numbers in the names decide, if lines and pictures
    have the same ones: ``Light_07.JPG`` is ``IMG_7.tif``.

    Parameters
    ----------
    lines, pictures : sequence of str
        Names, with or without folders and endings. Lines may name further pictures.
    source : str
        Name of the list in errors.

    Returns
    -------
    ndarray of int64, shape (pictures,)
        Index of each picture's line.

    Raises
    ------
    InputError
        If two lines or two pictures have one name, or they do not match: names both.
    """
    _check_names_differ(lines, f"{source}: its lines")
    _check_names_differ(pictures, f"{source}: the pictures")
    of_stem = {stem_key(name): index for index, name in enumerate(lines)}
    matches = [of_stem.get(stem_key(name)) for name in pictures]
    if None in matches:
        matches = _by_number(lines, pictures, matches) or matches
    if None in matches:
        picture = pictures[matches.index(None)]
        free = [line for index, line in enumerate(lines) if index not in matches]
        line = f", and its line {free[0]} names none of the pictures" if free else ""
        raise InputError(
            f"{source}: has no line for the picture {picture}{line}. Its {len(lines)} lines and "
            f"the {len(pictures)} pictures should have the same names, or the same numbers in them"
        )
    return np.array(matches, np.int64)


def _check_names_differ(names: Sequence[str], source: str) -> None:
    first: dict[str, int] = {}
    for index, name in enumerate(names):
        previous = first.setdefault(stem_key(name), index)
        if previous != index:
            raise InputError(
                f"{source} {names[previous]} and {name} have one name but for folder, ending and "
                "case",
                remedy="remove or rename one of them",
            )


def _by_number(
    lines: Sequence[str], pictures: Sequence[str], by_stem: Sequence[int | None]
) -> list[int | None] | None:
    """Match pictures to lines by numbers in their names; None where these do not correspond.

    Lines and pictures need the same numbers, so that a list that counts from 1 is not matched to
    pictures that count from 0; matches by stem have to agree.
    """
    of_lines, of_pictures = _numbers(lines), _numbers(pictures)
    if of_lines is None or of_pictures is None or {*of_lines} != {*of_pictures}:
        return None
    matches: list[int | None] = [of_lines.index(number) for number in of_pictures]
    agrees = all(stem in (None, match) for stem, match in zip(by_stem, matches, strict=True))
    return matches if agrees else None


def _numbers(names: Sequence[str]) -> list[int] | None:
    """Number in each name that distinguishes it, or None if there is none.

    Numbers that all names share, such as a date, are left out.
    """
    groups = [[int(digits) for digits in re.findall(r"\d+", stem_key(name))] for name in names]
    if len({len(numbers) for numbers in groups}) != 1:
        return None
    columns = [column for column in zip(*groups, strict=True) if len({*column}) > 1]
    if len(columns) != 1 or len({*columns[0]}) != len(names):
        return None
    return list(columns[0])
