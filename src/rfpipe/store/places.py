"""Folders that are read where they lie, without a disk: what `Path` is on one."""

from __future__ import annotations

import math
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Iterable
from itertools import product
from typing import IO, Any

from rfpipe.errors import IntegrityError

__all__ = ["Place", "ZipPlace", "array_keys"]


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
    def _at(self, key: str) -> Place:
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

    def __truediv__(self, name: str) -> Place:
        return self._at(f"{self.key}/{name}")

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

    def _at(self, key: str) -> ZipPlace:
        return ZipPlace(self._archive, self._name, key)

    def read_bytes(self) -> bytes:
        """Read a file; its checksum is checked."""
        try:
            info = self._archive.getinfo(self.key)
        except KeyError:
            raise FileNotFoundError(str(self)) from None
        try:
            return self._archive.read(info)
        except zipfile.BadZipFile as error:
            raise IntegrityError(f"{self}: damaged ({error}); fetch {self._name} anew") from error

    def open(self) -> IO[bytes]:
        """Open a file for reading; its checksum is checked at its end."""
        try:
            return self._archive.open(self.key)
        except KeyError:
            raise FileNotFoundError(str(self)) from None

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


def array_keys(metadata: dict[str, Any]) -> list[str]:
    """Return the names of the files of a zarr array, by the content of its ``zarr.json``."""
    chunks = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    separator = metadata["chunk_key_encoding"]["configuration"]["separator"]
    counts = [math.ceil(n / step) for n, step in zip(metadata["shape"], chunks, strict=True)]
    indices = product(*map(range, counts))
    return [separator.join(["c", *map(str, index)]) for index in indices]
