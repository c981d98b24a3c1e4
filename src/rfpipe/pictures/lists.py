"""Text files with numbers, and perhaps the name of a picture, on each line."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.pictures.names import is_picture_name, stem_key

Row = tuple[int, list[str]]
"""Number of a line in its file, from 1, and its words."""

_COMMENT = re.compile(r"(^|\s)(#|//).*")
_NUMBER = re.compile(r"[-+]?((\d+[.,]?\d*|[.,]\d+)(e[-+]?\d+)?|nan|inf)", re.IGNORECASE)
# Programs write directions with three digits or more.
_LENGTH_ERROR = 0.01


def read_text(path: Path) -> str:
    """Read a text in UTF-8, in UTF-16 with its byte order mark, or in Windows' code page 1252.

    Raises InputError if it can't be read as text.
    """
    try:
        content = path.read_bytes()
        if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return content.decode("utf-16")
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("cp1252")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: can't be read as text: {error}", remedy="save it in UTF-8"
        ) from None
    if "\0" in text:
        raise InputError(
            f"{path}: has zero bytes, which no text in UTF-8 has", remedy="save it in UTF-8"
        )
    return text


def read_numbers(path: Path) -> NDArray[np.float32]:
    """Read numbers, as many on each line, as an array (lines, numbers).

    Separators, comments and encodings as `read_directions`. Raises InputError for other text.
    """
    rows = _words(path, _lines(path), 1)
    for line, words in rows:
        if _trailing(words) != len(words) or len(words) != len(rows[0][1]):
            raise InputError(
                f"{path}: line {line} is {' '.join(words)!r}; expected numbers alone, as many as "
                f"on line {rows[0][0]}"
            )
    return np.array([[_value(word) for word in words] for _, words in rows], np.float32)


def read_directions(
    path: Path, pictures: Collection[str] = ()
) -> tuple[list[str], NDArray[np.float32]]:
    """Read lines ``x y z``, or ``name x y z``; further columns are not used.

    The first line may be the number of the others. Spaces, tabs, semicolons or commas separate;
    numbers may have decimal commas where commas do not separate; ``#`` and ``//`` begin comments.
    A name may contain spaces.

    Parameters
    ----------
    path : Path
    pictures : collection of str
        Names that may be on the lines: they settle which of more than three numbers are x, y and
        z, where names have no ending such as ``.jpg``. Else directions of length 1 do.

    Returns
    -------
    names : list of str
        Empty texts where the lines have none.
    directions : ndarray of float32, shape (lines, 3)

    Raises
    ------
    InputError
        For other text, another number of lines, and where it is ambiguous which numbers are
        x, y and z: names the line.
    """
    lines = _lines(path)
    first = lines[0][1].strip(" ,;")
    if first.isdigit():
        count = int(first)
        lines = lines[1:]
        if count != len(lines):
            raise InputError(
                f"{path}: its first line counts {count} lights, it has {len(lines)}",
                remedy="add the missing lines, or correct the number",
            )
    rows = _words(path, lines, 3)
    starts = [_after_picture_name(path, row) for row in rows]
    if 0 in starts:
        columns = _columns(
            path, [words for _, words in rows], {stem_key(name) for name in pictures}
        )
        starts = [
            start or len(words) - columns for start, (_, words) in zip(starts, rows, strict=True)
        ]
    names, directions = [], []
    for start, (_, words) in zip(starts, rows, strict=True):
        names.append(" ".join(words[:start]).strip("\"'"))
        directions.append([_value(word) for word in words[start : start + 3]])
    unnamed = [line for (line, _), name in zip(rows, names, strict=True) if not name]
    if unnamed and any(names):
        raise InputError(
            f"{path}: line {unnamed[0]} has no name of a picture, others have one",
            remedy="name all pictures, or none",
        )
    return names, np.array(directions, np.float32)


def _lines(path: Path) -> list[tuple[int, str]]:
    """Lines of a text with their numbers, without comments and empty lines."""
    text = [_COMMENT.sub("", line).strip() for line in read_text(path).splitlines()]
    lines = [(number, line) for number, line in enumerate(text, 1) if line]
    if not lines:
        raise InputError(f"{path}: has no lights, three numbers per line: it is empty")
    return lines


def _words(path: Path, lines: Sequence[tuple[int, str]], least: int) -> list[Row]:
    """Split lines into words, the last of which are at least as many numbers as `least`.

    Commas separate where they are not the decimal commas of single numbers.
    """
    rows: list[Row] = []
    for separators in (r"[;\s]+", r"[;,\s]+"):
        rows = [
            (line, [word.strip(",") for word in re.split(separators, text) if word.strip(",")])
            for line, text in lines
        ]
        if all(_trailing(words) >= least for _, words in rows):
            _check_decimals(path, rows, separators)
            return rows
    line, words = next(row for row in rows if _trailing(row[1]) < least)
    raise InputError(
        f"{path}: line {line} is {' '.join(words)!r}: no lights, three numbers per line; expected "
        "x y z, or the name of a picture before them"
    )


def _check_decimals(path: Path, rows: Sequence[Row], separators: str) -> None:
    """Reject numbers of which commas may be decimal, or may separate."""
    numbers = [words[len(words) - _trailing(words) :] for _, words in rows]
    has_point, has_comma = (
        any(mark in word for words in numbers for word in words) for mark in ".,"
    )
    even = all(len(words) >= 6 and len(words) % 2 == 0 for words in numbers)
    if (has_point and has_comma) or ("," in separators and even and not has_point):
        raise InputError(
            f"{path}: line {rows[0][0]} is {' '.join(rows[0][1])!r}: commas may be decimal or "
            "separate numbers",
            remedy="write decimal points",
        )


def _after_picture_name(path: Path, row: Row) -> int:
    """Index of the first word after a picture's name with its ending; 0 where there is none."""
    line, words = row
    ends = [index + 1 for index, word in enumerate(words) if is_picture_name(word.strip("\"'"))]
    if not ends:
        return 0
    if len(words) - ends[-1] != _trailing(words[ends[-1] :]) or len(words) - ends[-1] < 3:
        raise InputError(
            f"{path}: line {line} is {' '.join(words)!r}; expected three numbers or more after "
            f"the picture's name {words[ends[-1] - 1]}"
        )
    return ends[-1]


def _columns(path: Path, rows: Sequence[list[str]], pictures: set[str]) -> int:
    """Count of numbers after the names, which have no ending that marks their end."""
    count = min(map(_trailing, rows))
    if count == 3:
        return 3
    candidates = range(3, count + 1)
    named = {
        columns: sum(stem_key(" ".join(words[:-columns])) in pictures for words in rows)
        for columns in candidates
    }
    best = [columns for columns in candidates if named[columns] == max(named.values()) > 0]
    if len(best) != 1:
        best = [columns for columns in candidates if _are_unit(rows, columns)]
    if len(best) != 1:
        raise InputError(
            f"{path}: has {count} numbers per line, as in {' '.join(rows[0])!r}; which are x, y "
            "and z is ambiguous",
            remedy="Write three, or the picture's name with its ending before them",
        )
    return best[0]


def _are_unit(rows: Sequence[list[str]], columns: int) -> bool:
    """Test whether the first three of some columns are directions of length 1 on all lines."""
    starts = [len(words) - columns for words in rows]
    values = [
        [_value(word) for word in words[start : start + 3]]
        for words, start in zip(rows, starts, strict=True)
    ]
    return bool((np.abs(np.linalg.norm(values, axis=1) - 1) < _LENGTH_ERROR).all())


def _trailing(words: Sequence[str]) -> int:
    """Count the numbers at the end of a line."""
    backwards = enumerate(reversed(words))
    return next((index for index, word in backwards if not _NUMBER.fullmatch(word)), len(words))


def _value(word: str) -> float:
    return float(word.replace(",", "."))
