"""Read-only folders and files that are not on this machine's disk, and helpers for both kinds."""

from __future__ import annotations

import io
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

from rfpipe.errors import StoreError, UnreachableError

Range = tuple[int, int | None]
"""First and last-plus-one byte of a part of a file; ``(-4, None)`` are the last four bytes."""

METADATA = "zarr.json"
"""File with the description of a Zarr array or group."""

CHECKSUMS = "manifest-sha256.txt"
"""File with the SHA-256 and the name of every file of a publication or packed folder, a line per
file.
"""

_ADDRESS = re.compile(r"^([A-Za-z][A-Za-z0-9+]+):/+(?=[^/])")


class Place(ABC):
    """A read-only folder or file in a container; the counterpart of `Path`.

    A container is a zip file, a packed folder, a web server or a bucket.

    Attributes
    ----------
    key : str
        Name in the container, parts joined by ``/``; empty for the container itself.
    """

    def __init__(self, key: str) -> None:
        self.key = key.strip("/")

    @abstractmethod
    def __str__(self) -> str: ...

    @abstractmethod
    def at(self, key: str) -> Place:
        """Return the place of another key in the same container."""

    @abstractmethod
    def read_bytes(self) -> bytes:
        """Read a file, or raise FileNotFoundError; StoreError when it can't be read."""

    @abstractmethod
    def files(self) -> list[str]:
        """List all files in this folder by names relative to it, or raise StoreError."""

    @abstractmethod
    def nbytes(self) -> int | None:
        """Total size in bytes of all files in this folder; None if unknown."""

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read ranges of a file without verifying its checksum; raises as `read_bytes`."""
        content = self.read_bytes()
        return [content[start:stop] for start, stop in ranges]

    def open(self) -> IO[bytes]:
        """Open a file for reading; raises as `read_bytes`."""
        return io.BytesIO(self.read_bytes())

    def __truediv__(self, name: str) -> Place:
        return self.at(f"{self.key}/{name}")


class ListedPlace(Place):
    """A place in a container that lists its files with their sizes."""

    @property
    @abstractmethod
    def _sizes(self) -> Mapping[str, int]:
        """Size in bytes of every file in the container, by key."""

    def files(self) -> list[str]:
        return sorted(key[len(self._prefix) :] for key in self._keys_inside)

    def nbytes(self) -> int:
        return sum(self._sizes[key] for key in self._keys_inside)

    @property
    def _prefix(self) -> str:
        return f"{self.key}/" if self.key else ""

    @property
    def _keys_inside(self) -> list[str]:
        return [key for key in self._sizes if key.startswith(self._prefix)]


def content_of(file: Path | Place) -> bytes | None:
    """Read a file; None if it doesn't exist."""
    try:
        return file.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None


def readable_content(file: Path | Place) -> bytes | None:
    """Read a file; None if it doesn't exist or its server refuses to read it.

    A bucket may answer a request for a missing object with "access denied".

    Raises
    ------
    UnreachableError
        When the server doesn't answer.
    """
    try:
        return content_of(file)
    except UnreachableError:
        raise
    except StoreError:
        return None


def read_ranges(file: Path | Place, ranges: Sequence[Range]) -> list[bytes]:
    """Read ranges of a file; raises OSError or the errors of `Place.read_ranges`."""
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
    """Return an address such as ``https://host/run``; None for a path on this machine.

    `Path` drops one of the two slashes of an address; such a path counts as an address, too.
    """
    match = _ADDRESS.match(str(path))
    return None if match is None else _ADDRESS.sub(r"\1://", str(path))
