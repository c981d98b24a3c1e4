"""Writing a zip file or a folder: streamed, digested, whole or not at all."""

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
"""A file, or its content."""

_BLOCK_BYTES = 2**20
_LARGE = 2**31  # above, a zip entry needs 64-bit sizes, which must be said before it is written
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of zip files: the time of writing would change the bytes


class Writer:
    """Takes files into a zip file, where they lie as they are and are read by ranges, or a folder.

    Attributes
    ----------
    written : dict of str to (str, int)
        SHA-256 and bytes of every file, by its name.
    """

    def __init__(self, target: zipfile.ZipFile | Path) -> None:
        self._target = target
        self.written: dict[str, tuple[str, int]] = {}
        self._stores: set[str] = set()

    def add(self, name: str, source: Source) -> None:
        """Write a file, a copy of another or some bytes; StoreError when it can't be."""
        if name in self.written:
            raise InputError(f"{name}: stands twice in a publication")
        with self._opened(name, size_of(source)) as target:
            self.written[name] = measured(source, target)

    def _opened(self, name: str, size: int) -> IO[bytes]:
        if isinstance(self._target, Path):
            path = self._target / name
            path.parent.mkdir(parents=True, exist_ok=True)
            return path.open("wb")
        store, separator, _ = name.partition(".zarr/")
        if separator and store not in self._stores:  # a folder that is spoken of as a whole
            self._stores.add(store)
            self._target.writestr(_entry(f"{store}.zarr/", (0o40755 << 16) | 0x10), b"")
        return self._target.open(_entry(name, 0o100644 << 16), "w", force_zip64=size >= _LARGE)


def size_of(source: Source) -> int:
    """Return the bytes of a file."""
    return len(source) if isinstance(source, bytes) else source.stat().st_size


def measured(source: Source, target: IO[bytes] | None = None) -> tuple[str, int]:
    """Return SHA-256 and size of a file, and copy it."""
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
    """Write a zip file, where the name ends so, or else a folder, whole or not at all.

    It is written beside its place and, at the end, takes the place of what stands there.
    """
    new = hidden_sibling(output, "new")
    with StoreLock(output), storage_errors(output, "publishing", needed_bytes, resumes=False):
        remove_tree(new)
        try:
            if output.suffix.lower() == ".zip":
                with new.open("wb") as file:
                    with zipfile.ZipFile(file, "w") as archive:
                        yield Writer(archive)
                    file.flush()
                    os.fsync(file.fileno())
            else:
                new.mkdir(parents=True)
                yield Writer(new)
            if output.is_dir() or new.is_dir():
                remove_tree(output)
            new.replace(output)
        except BaseException:
            remove_tree(new)
            raise


def write_zip(output: Path, files: Iterable[tuple[str, Source]]) -> None:
    """Write files by their names; the same files give the same bytes."""
    files = list(files)
    with writing(output, sum(size_of(source) for _, source in files)) as writer:
        for name, source in files:
            writer.add(name, source)
