"""Folders that are read where they lie, in a zip file or behind an address."""

from __future__ import annotations

import io
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

from rfpipe import plugins

if TYPE_CHECKING:
    from collections.abc import Callable

Range = tuple[int, int | None]
"""Bytes of a file, as a slice has them: ``(-4, None)`` are the last four."""

METADATA = "zarr.json"

_ADDRESS = re.compile(r"^([A-Za-z][A-Za-z0-9+]+):/+(?=[^/])")


class Place(ABC):
    """A folder or file that is read, but not written; what `Path` is on a disk.

    Attributes
    ----------
    key : str
        Its name in the whole, parts joined by ``/``; empty for the whole.
    """

    def __init__(self, key: str) -> None:
        self.key = key.strip("/")

    @abstractmethod
    def __str__(self) -> str: ...

    @abstractmethod
    def at(self, key: str) -> Place:
        """Return another place in the same whole."""

    @abstractmethod
    def read_bytes(self) -> bytes:
        """Read a file, or raise FileNotFoundError; StoreError when it can't be read."""

    @abstractmethod
    def files(self) -> list[str]:
        """Return the names, relative to this folder, of all files in it, or raise StoreError."""

    @abstractmethod
    def nbytes(self) -> int | None:
        """Return the bytes of all files in this folder; None where that isn't known."""

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read parts of a file, without a check of the whole; errors as `read_bytes`."""
        content = self.read_bytes()
        return [content[start:stop] for start, stop in ranges]

    def open(self) -> IO[bytes]:
        """Open a file for reading; errors as `read_bytes`."""
        return io.BytesIO(self.read_bytes())

    def __truediv__(self, name: str) -> Place:
        return self.at(f"{self.key}/{name}")


def content_of(file: Path | Place) -> bytes | None:
    """Return the content of a file, None where there is none."""
    try:
        return file.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None


def read_ranges(file: Path | Place, ranges: Sequence[Range]) -> list[bytes]:
    """Read parts of a file; OSError, or the errors of `Place.read_ranges`."""
    if isinstance(file, Place):
        return file.read_ranges(ranges)
    parts = []
    with file.open("rb") as opened:
        size = opened.seek(0, io.SEEK_END)
        for begin, end in ranges:
            start, stop, _ = slice(begin, end).indices(size)
            opened.seek(start)
            parts.append(opened.read(stop - start))
    return parts


def as_address(path: str | Path) -> str | None:
    """Return an address such as ``https://host/run`` as text, None for a path on this machine.

    A `Path` made of an address has lost one of its slashes; it counts as well.
    """
    match = _ADDRESS.match(str(path))
    return None if match is None else _ADDRESS.sub(r"\1://", str(path))


def locate(path: str | Path | Place) -> Path | Place:
    """Find out where something lies: a path here, inside of a zip file, or behind an address.

    Parameters
    ----------
    path
        A path; ``crate.zip`` or ``crate.zip/folder/inside``; a folder that ``rfpipe collection
        pack`` made; an address of any of these, ``http(s)://host/...`` or ``s3://bucket/...``; or
        the place of a zip file.

    Raises
    ------
    StoreError
        When a zip file or a packed folder is damaged, or a server doesn't answer.
    InputError
        When an address is of another kind.
    """
    if not isinstance(path, Place) and (Path(path) / METADATA).is_file():
        return Path(path)
    (opener,) = plugins.names(plugins.PLACES)
    find: Callable[[str | Path | Place], Path | Place] = plugins.find(plugins.PLACES, opener)
    return find(path)
