"""Atomic writing of a zip file or a folder, with the digests of its files."""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from rfpipe.errors import InputError
from rfpipe.store import StoreLock
from rfpipe.store.files import hidden_sibling, remove_tree, storage_errors

Source = Path | bytes
"""A file on disk, or the content of a file."""

_BLOCK_BYTES = 2**20
_LARGE = 2**31  # larger zip entries need 64-bit sizes, which must be declared before writing
_EPOCH = (1980, 1, 1, 0, 0, 0)  # time of all zip entries, for reproducible bytes


class Writer:
    """Writer of files to a folder or a zip file, uncompressed so that ranges can be read.

    Attributes
    ----------
    written : dict of str to (str, int)
        SHA-256 and size in bytes of every file, by name.
    """

    def __init__(self, target: zipfile.ZipFile | Path) -> None:
        self._target = target
        self.written: dict[str, tuple[str, int]] = {}
        self._stores: set[str] = set()

    def add(self, name: str, source: Source) -> None:
        """Write a file, copied or from its content; StoreError if that fails."""
        if name in self.written:
            raise InputError(f"{name}: occurs twice in a publication; rename one of the files")
        with self._opened(name, size_of(source)) as target:
            self.written[name] = digest_and_size(source, target)

    def _opened(self, name: str, size: int) -> IO[bytes]:
        if isinstance(self._target, Path):
            path = self._target / name
            path.parent.mkdir(parents=True, exist_ok=True)
            return path.open("wb")
        store, separator, _ = name.partition(".zarr/")
        if separator and store not in self._stores:  # the crate describes this folder
            self._stores.add(store)
            self._target.writestr(_entry(f"{store}.zarr/", (0o40755 << 16) | 0x10), b"")
        return self._target.open(_entry(name, 0o100644 << 16), "w", force_zip64=size >= _LARGE)


def size_of(source: Source) -> int:
    """Size of a file in bytes."""
    return len(source) if isinstance(source, bytes) else source.stat().st_size


def digest_and_size(source: Source, target: IO[bytes] | None = None) -> tuple[str, int]:
    """Return SHA-256 and size in bytes of a file, and copy it to `target`, if given."""
    digest = hashlib.sha256()
    with storage_errors(source if isinstance(source, Path) else "", "reading"):
        opened: IO[bytes] = io.BytesIO(source) if isinstance(source, bytes) else source.open("rb")
    with opened:
        while block := opened.read(_BLOCK_BYTES):
            digest.update(block)
            if target is not None:
                target.write(block)
        return digest.hexdigest(), opened.tell()


def _entry(name: str, attributes: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, _EPOCH)
    info.create_system = 3  # Unix, on every machine
    info.external_attr = attributes
    return info


@contextmanager
def writing(output: Path, needed_bytes: int) -> Iterator[Writer]:
    """Write a zip file, if the name ends in ``.zip``, or a folder, atomically.

    It is written under a temporary name, and at the end replaces an existing file or folder.
    """
    new = hidden_sibling(output, "new")
    with StoreLock(output), storage_errors(output, "publishing", needed_bytes, resumes=False):
        remove_tree(new)
        try:
            if output.suffix.lower() == ".zip":
                with _zip_on_disk(new) as archive:
                    yield Writer(archive)
            else:
                new.mkdir(parents=True)
                yield Writer(new)
            if output.is_dir() or new.is_dir():
                remove_tree(output)
            new.replace(output)
        except BaseException:
            remove_tree(new)
            raise


@contextmanager
def _zip_on_disk(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open a new zip file, which is flushed to the disk at the end."""
    with path.open("wb") as file:
        with zipfile.ZipFile(file, "w") as archive:
            yield archive
        file.flush()
        os.fsync(file.fileno())


def write_zip(output: Path, files: Iterable[tuple[str, Source]]) -> None:
    """Write files to a zip file by name; equal files give equal bytes."""
    files = list(files)
    with writing(output, sum(size_of(source) for _, source in files)) as writer:
        for name, source in files:
            writer.add(name, source)
