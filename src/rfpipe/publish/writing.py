"""Writing a publication, as a zip file or as a folder: streamed, digested, whole or not at all."""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from rfpipe.errors import InputError
from rfpipe.store import StoreLock
from rfpipe.store.files import hidden_sibling, remove_tree, storage_errors
from rfpipe.transport.places import MANIFEST

__all__ = ["Writer", "writing"]

_BLOCK_BYTES = 2**20
_LARGE = 2**31  # above, a zip entry needs 64-bit sizes, which must be said before it is written
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of zip files: the time of writing would change the bytes


class Writer(ABC):
    """Takes a publication's files, one after the other.

    Attributes
    ----------
    digests : dict of str to str
        SHA-256 of every file written, by its name.
    sizes : dict of str to int
        Bytes of every file written.
    """

    def __init__(self) -> None:
        self.digests: dict[str, str] = {}
        self.sizes: dict[str, int] = {}
        self._stores: set[str] = set()

    def add(self, name: str, source: Path | bytes) -> None:
        """Write a file, a copy of another or some bytes.

        Raises
        ------
        StoreError
            When it can't be read or written.
        """
        if name in self.digests:
            raise InputError(f"{name}: stands twice in a publication")
        digest = hashlib.sha256()
        if isinstance(source, bytes):
            opened: IO[bytes] = io.BytesIO(source)
            size = len(source)
        else:
            with storage_errors(source, "reading"):
                opened = source.open("rb")
                size = os.fstat(opened.fileno()).st_size
        store, found, _ = name.partition(".zarr/")
        if found and store not in self._stores:
            self._stores.add(store)
            self._begin_folder(f"{store}.zarr/")
        written = 0
        with opened, self._opened(name, size) as target:
            while block := opened.read(_BLOCK_BYTES):
                digest.update(block)
                target.write(block)
                written += len(block)
        self.digests[name], self.sizes[name] = digest.hexdigest(), written

    @abstractmethod
    def _opened(self, name: str, size: int) -> IO[bytes]:
        """Open a file of about `size` bytes for writing."""

    def _begin_folder(self, name: str) -> None:  # noqa: ARG002
        """Note the folder of a store, which is spoken of as a whole."""
        return


class _ZipWriter(Writer):
    """Files in a zip, as they are: what is in them is compressed, and is read by ranges."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        super().__init__()
        self._archive = archive

    def _opened(self, name: str, size: int) -> IO[bytes]:
        return self._archive.open(_entry(name, 0o100644 << 16), "w", force_zip64=size >= _LARGE)

    def _begin_folder(self, name: str) -> None:
        self._archive.writestr(_entry(name, (0o40755 << 16) | 0x10), b"")


class _FolderWriter(Writer):
    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder

    def _opened(self, name: str, size: int) -> IO[bytes]:  # noqa: ARG002
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("wb")


def _entry(name: str, attributes: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, _EPOCH)
    info.compress_type = zipfile.ZIP_STORED
    info.create_system = 3  # Unix, on every machine
    info.external_attr = attributes
    return info


@contextmanager
def writing(output: Path, *, overwrite: bool, needed_bytes: int) -> Iterator[Writer]:
    """Write a zip file, where the name ends so, or else a folder: complete or not at all.

    It is written beside its place and renamed at the end, so that an interrupted publication
    leaves nothing there, or the one before; the next one begins anew.

    Raises
    ------
    InputError
        When something stands there, unless it is to be overwritten.
    LockedError
        When another process writes it.
    StoreError
        When the disk is full or the folder isn't writable.
    """
    _refuse_to_replace(output, overwrite)
    new = hidden_sibling(output, "new")
    with StoreLock(output), storage_errors(output, "publishing", needed_bytes):
        remove_tree(new)
        try:
            if output.suffix.lower() == ".zip":
                with (
                    new.open("wb") as file,
                    zipfile.ZipFile(file, "w", strict_timestamps=False) as archive,
                ):
                    yield _ZipWriter(archive)
                    archive.close()
                    file.flush()
                    os.fsync(file.fileno())
            else:
                new.mkdir(parents=True)
                yield _FolderWriter(new)
            if output.is_dir() or not new.is_file():
                remove_tree(output)
            new.replace(output)
        except BaseException:
            remove_tree(new)
            raise


def _refuse_to_replace(output: Path, overwrite: bool) -> None:
    """Never replace what wasn't published, nor anything unasked."""
    if output.exists() and not overwrite:
        raise InputError(
            f"{output}: stands here already; give --overwrite to replace it, or another --output"
        )
    if output.is_dir() and any(output.iterdir()) and not (output / MANIFEST).is_file():
        raise InputError(
            f"{output}: is a folder that 'rfpipe publish' didn't make (it has no {MANIFEST}); give "
            "another --output"
        )
