"""Reading a collection from a CSV file, as spreadsheets and people write them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from rfpipe.config.collection.rows import Path_, Row, refused, target_of
from rfpipe.errors import ConfigError

__all__ = ["read_csv"]

_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}
_SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # .xlsx and .ods, .xls
_DELIMITERS = ",;\t"
_SAID = re.compile(r"sep=(.)\r?\n?", re.IGNORECASE)
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

_ABOUT = ("about",)

_Record = tuple[int, list[str]]
"""A record's first line, and its cells."""


def read_csv(path: Path) -> list[Row]:
    """Read the rows of a CSV file.

    Cells are parted by commas, semicolons (as Excel does where the comma is the decimal point) or
    tabs, whichever the header has; an Excel line ``sep=;`` may say which. Text is UTF-8, with or
    without a byte order mark, or UTF-16 with one. Empty rows, and those that begin with #, are no
    scenes; empty cells set nothing.

    Raises
    ------
    ConfigError
        When it isn't readable as such, or its header isn't: with line and column.
    """
    text = _decoded(path)
    said = _SAID.match(text)
    first = 2 if said else 1
    body = text[said.end() :] if said else text
    delimiter = said[1] if said else _delimiter(body)
    records = _records(path, body, delimiter, first)
    header = next(records, None)
    if header is None:
        raise ConfigError(
            f"{path}: is empty; expected a header, such as name,kind,shape, and a row for each "
            "scene"
        )
    columns = _columns(path, *header)
    rows, problems = [], []
    for line, cells in records:
        place = f"line {line}"
        surplus = [n for n in range(len(columns), len(cells)) if cells[n].strip()]
        filled = [n for n in range(len(columns)) if n < len(cells) and cells[n].strip()]
        unnamed = [n for n in filled if not columns[n]] or surplus
        if unnamed:
            what = (
                f"{cells[unnamed[0]].strip()[:40]!r} stands in a column without a name; name it in "
                f"the header, or put the cell in quotes if it has a {delimiter!r} in it"
            )
            problems.append((f"{place}, column {letters(unnamed[0])}", what))
            continue
        values = {columns[n]: cells[n].strip() for n in filled}
        places = {
            column: f"{place}, column {letters(n)} ({'.'.join(column)})"
            for n, column in enumerate(columns)
            if column
        }
        rows.append(Row(place, dict(values), places, is_text=True, comma=delimiter == ";"))
    if problems:
        raise refused(path, problems)
    return rows


def letters(index: int) -> str:
    """Name a column as spreadsheets do: A to Z, AA and so on."""
    name = ""
    index += 1
    while index:
        index, rest = divmod(index - 1, 26)
        name = chr(ord("A") + rest) + name
    return name


def _decoded(path: Path) -> str:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: can't be read as a collection: {error}") from error
    if content.startswith(_SPREADSHEETS):
        raise ConfigError(
            f"{path}: is a spreadsheet's own file; save the table as CSV in the encoding UTF-8 (in "
            "Excel: CSV UTF-8)"
        )
    encoding = next((name for mark, name in _MARKS.items() if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        before = content[: error.start]
        line = before.count(b"\n") + 1
        row = before.rpartition(b"\n")[2]
        column = 1 + max(row.count(mark.encode()) for mark in _DELIMITERS)
        raise ConfigError(
            f"{path}: line {line}, column {letters(column - 1)}: byte "
            f"0x{content[error.start]:02x} is no {encoding.upper().removesuffix('-SIG')}; save the "
            "file in the encoding UTF-8 (in Excel: CSV UTF-8)"
        ) from None
    if "\0" in text:
        line = text[: text.index("\0")].count("\n") + 1
        raise ConfigError(
            f"{path}: line {line}: holds a byte 0, as no text does; save the table as CSV in the "
            "encoding UTF-8"
        )
    return text


def _delimiter(text: str) -> str:
    """Find out what parts the cells of the header: the mark that it has most of."""
    header = next((line for line in text.splitlines() if _is_said(line)), "")
    return max(_DELIMITERS, key=header.count)


def _is_said(line: str) -> bool:
    """Whether a line says something, and is no comment."""
    return bool(line.strip(_DELIMITERS + ' "')) and not line.lstrip().startswith("#")


def _records(path: Path, text: str, delimiter: str, line: int) -> Iterator[_Record]:
    """Yield the records that say something."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    before = reader.line_num
    try:
        for cells in reader:
            starts, before = line + before, reader.line_num
            if any(cell.strip() for cell in cells) and not cells[0].lstrip().startswith("#"):
                yield starts, cells
    except csv.Error as error:
        raise ConfigError(
            f"{path}: line {line + before}: is no row of cells ({error}); is a quotation mark not "
            'closed? Inside of a quoted cell it is written twice: ""'
        ) from None


def _path_of(name: str) -> Path_:
    """Return the path that a column is called by: of about, what follows is any name."""
    group, dot, known = name.partition(".")
    if (group,) == _ABOUT and dot and known.strip():
        return (group, known.strip())
    return tuple(name.split(".")) if name else ()


def _columns(path: Path, line: int, cells: Sequence[str]) -> list[Path_]:
    """Return the paths that a header names; empty ones where a column has no name."""
    columns: list[Path_] = []
    targets: list[Path_] = []
    problems: list[tuple[str, str]] = []
    for n, cell in enumerate(cells):
        name = cell.strip()
        parts = _path_of(name)
        place = f"line {line}, column {letters(n)}"
        is_fit = all(parts) if parts[:1] == _ABOUT else all(map(_NAME.fullmatch, parts))
        if not is_fit:
            example = "expected one such as kind or camera.exposures"
            problems.append((place, f"{name[:40]!r} is no name of a setting; {example}"))
        elif parts and target_of(parts) in targets:
            first = targets.index(target_of(parts))
            other = "" if columns[first] == parts else f", as {'.'.join(columns[first])}"
            what = f"{name} stands in column {letters(first)} as well{other}; remove one"
            problems.append((place, what))
        columns.append(parts)
        targets.append(target_of(parts) if parts else ())
    if not problems and ("name",) not in columns:
        found = ", ".join(cell.strip()[:30] or "(empty)" for cell in cells[:20])
        what = "the header has no column 'name', by which scenes and their folders are called"
        if any(cell.strip().lower() == "name" for cell in cells):
            what += " (settings' names are written in lower case)"
        problems.append((f"line {line}", f"{what}; it has {found}"))
    if problems:
        raise refused(path, problems)
    return columns
