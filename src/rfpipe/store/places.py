"""Folders that are read where they lie, without a disk: what `Path` is on one."""

from __future__ import annotations

import lzma
import math
import os
import struct
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import IO, Any

from rfpipe.errors import IntegrityError, StoreError

__all__ = [
    "ZIP_DAMAGE",
    "Place",
    "Range",
    "ZipPlace",
    "array_keys",
    "end_of_file",
    "ranges_of_file",
    "zip_damage",
]

Range = tuple[int, int | None]
"""Of a file's bytes: the first, and the one behind the last; None for the file's end."""

ZIP_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
    *(EOFError, OSError, RuntimeError, ValueError),
)
"""What `zipfile` raises on damaged bytes, and on a compression or encryption that it lacks."""

_LOCAL_BYTES = 30  # of a zip file's header before each file, without its name


class Place(ABC):
    """A folder or file of something that is read, but not written; what `Path` is on a disk.

    Attributes
    ----------
    key : str
        Where it lies in the whole, its parts joined by ``/``; empty for the whole.
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
        """Read a file.

        Raises
        ------
        FileNotFoundError
            When there is none.
        StoreError
            When it can't be read.
        """

    @abstractmethod
    def open(self) -> IO[bytes]:
        """Open a file for reading; errors as `read_bytes`."""

    @abstractmethod
    def files(self) -> list[str]:
        """Keys, relative to this one, of all files in this folder.

        Raises
        ------
        StoreError
            When what it lies in can't be listed.
        """

    @abstractmethod
    def nbytes(self) -> int | None:
        """Bytes of all files in this folder; None when that can't be told."""

    def announce(self) -> None:
        """Say that this folder is about to be read, and nothing that lies behind it."""
        return

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read parts of a file, and as little else of it as can be; errors as `read_bytes`.

        What checks the file as a whole isn't asked: the caller has to tell damage.
        """
        content = self.read_bytes()
        return [content[start:stop] for start, stop in ranges]

    def read_exactly(self, names: Iterable[str]) -> dict[str, bytes]:
        """`read_many`, as `read_ranges` reads."""
        found = {}
        for name in names:
            try:
                found[name] = (self / name).read_ranges([(0, None)])[0]
            except FileNotFoundError:
                continue
        return found

    def read_end(self, nbytes: int) -> tuple[bytes, int]:
        """Read the last bytes of a file; these and the file's size. As `read_ranges`."""
        content = self.read_bytes()
        return content[-nbytes:], len(content)

    def __truediv__(self, name: str) -> Place:
        return self.at(f"{self.key}/{name}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self)!r})"

    def read_many(self, names: Iterable[str]) -> dict[str, bytes]:
        """Read those of the files of these names that there are."""
        found = {}
        for name in names:
            try:
                found[name] = (self / name).read_bytes()
            except FileNotFoundError:
                continue
        return found


class ZipPlace(Place):
    """A folder or file in a zip file.

    Parameters
    ----------
    archive : zipfile.ZipFile
    name : str
        Of the zip file, for messages.
    key : str
    """

    def __init__(self, archive: zipfile.ZipFile, name: str, key: str = "") -> None:
        super().__init__(key)
        self._archive, self._name = archive, name

    def __str__(self) -> str:
        return f"{self._name}/{self.key}" if self.key else self._name

    def at(self, key: str) -> ZipPlace:
        """Return another place in the same whole."""
        return ZipPlace(self._archive, self._name, key)

    def read_bytes(self) -> bytes:
        """Read a file; its checksum is checked."""
        try:
            info = self._archive.getinfo(self.key)
        except KeyError:
            raise FileNotFoundError(str(self)) from None
        try:
            return self._archive.read(info)
        except ZIP_DAMAGE as error:
            raise zip_damage(str(self), self._name, error) from error

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read parts of a file that lies in the zip file as it is."""
        try:
            info = self._archive.getinfo(self.key)
        except KeyError:
            raise FileNotFoundError(str(self)) from None
        read: Any = getattr(self._archive.fp, "ranges", None)  # of one behind an address
        if read is None or info.compress_type != zipfile.ZIP_STORED:
            return super().read_ranges(ranges)
        header = info.header_offset
        before = _LOCAL_BYTES + len(info.filename.encode()) + len(info.extra)
        while True:
            # where it begins is written before it, and can be told beforehand as a rule
            first = header + before
            whole = [(first + start, first + (info.file_size if stop is None else stop))
                     for start, stop in ranges]  # fmt: skip
            found: list[bytes]
            local, *found = read([(header, header + _LOCAL_BYTES), *whole])
            told = _LOCAL_BYTES + sum(int.from_bytes(local[n : n + 2], "little") for n in (26, 28))
            if told == before:
                return found
            before = told

    def read_end(self, nbytes: int) -> tuple[bytes, int]:
        """Read the last bytes of a file; these and the file's size."""
        try:
            size = self._archive.getinfo(self.key).file_size
        except KeyError:
            raise FileNotFoundError(str(self)) from None
        return self.read_ranges([(max(0, size - nbytes), size)])[0], size

    def open(self) -> IO[bytes]:
        """Open a file for reading; its checksum is checked at its end."""
        try:
            return self._archive.open(self.key)
        except KeyError:
            raise FileNotFoundError(str(self)) from None
        except ZIP_DAMAGE as error:
            raise zip_damage(str(self), self._name, error) from error

    def files(self) -> list[str]:
        """Keys, relative to this one, of all files in this folder."""
        prefix = self._prefix
        names = self._archive.namelist()
        return sorted(
            n.removeprefix(prefix) for n in names if n.startswith(prefix) and n[-1] != "/"
        )

    def nbytes(self) -> int:
        """Bytes of all files in this folder, as they lie in the zip file."""
        prefix, infos = self._prefix, self._archive.infolist()
        return sum(info.compress_size for info in infos if info.filename.startswith(prefix))

    def announce(self) -> None:
        """Have a zip file behind an address be read ahead no further than this folder goes."""
        offsets = sorted((info.header_offset, info.filename) for info in self._archive.infolist())
        inside = [n for n, (_, name) in enumerate(offsets) if name.startswith(self._prefix)]
        file: Any = self._archive.fp
        if inside and hasattr(file, "until"):
            behind = offsets[inside[-1] + 1 :]
            file.until = behind[0][0] if behind else self._archive.start_dir

    @property
    def _prefix(self) -> str:
        return f"{self.key}/" if self.key else ""


def zip_damage(file: str, archive: str, error: Exception) -> StoreError:
    """Error that says why a file of a zip file can't be read, and what to do.

    Parameters
    ----------
    file, archive : str
        Names of both.
    error : Exception
        One of `ZIP_DAMAGE`.
    """
    if isinstance(error, RuntimeError):  # of a method that is missing, too
        return StoreError(
            f"{file}: can't be unpacked ({error}); unpack {archive} by what made it, or make it "
            "again without a password, its files stored as they are or deflated"
        )
    return IntegrityError(f"{file}: damaged ({error}); fetch {archive} anew")


def array_keys(metadata: dict[str, Any]) -> list[str]:
    """Return the names of the files of a zarr array, by the content of its ``zarr.json``."""
    chunks = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    separator = metadata["chunk_key_encoding"]["configuration"]["separator"]
    counts = [math.ceil(n / step) for n, step in zip(metadata["shape"], chunks, strict=True)]
    indices = product(*map(range, counts))
    return [separator.join(["c", *map(str, index)]) for index in indices]


def ranges_of_file(file: Path | Place, ranges: Sequence[Range]) -> list[bytes]:
    """Read parts of a file, as `Place.read_ranges`.

    Raises
    ------
    OSError
        When a file on the disk can't be read.
    """
    if isinstance(file, Place):
        return file.read_ranges(ranges)
    with file.open("rb") as opened:
        size = os.fstat(opened.fileno()).st_size
        return [
            os.pread(opened.fileno(), (size if stop is None else stop) - start, start)
            for start, stop in ranges
        ]


def end_of_file(file: Path | Place, nbytes: int) -> tuple[bytes, int]:
    """Read the last bytes of a file; these and the file's size. Errors as `ranges_of_file`."""
    if isinstance(file, Place):
        return file.read_end(nbytes)
    size = file.stat().st_size
    return ranges_of_file(file, [(max(0, size - nbytes), size)])[0], size
