"""Writing files so that they are whole or absent, and saying why when it fails."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, StoreError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)
_LOCKLESS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


def digest_of(*parts: bytes | NDArray[Any]) -> str:
    """Digest of bytes, or of the bytes of C-ordered arrays: SHA-256 cut to 128 bits.

    Stored data are gigabytes, which SHA instructions digest three times as fast as the BLAKE2b of
    `rfpipe.provenance`.
    """
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.reshape(-1).data if isinstance(part, np.ndarray) else part)
    return digest.hexdigest()[:32]


def canonical_json(value: Any, where: str, *, indent: int | None = None) -> bytes:
    """JSON with sorted keys, the same bytes for the same value."""
    parting = None if indent else (",", ":")
    try:
        text = json.dumps(value, sort_keys=True, allow_nan=False, indent=indent, separators=parting)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {error}; pass plain data with finite numbers") from error
    return text.encode()


def plain(value: dict[str, Any], where: str) -> dict[str, Any]:
    """Give plain data as a file will give it back: sorted keys, tuples as lists."""
    return dict(json.loads(canonical_json(value, where)))


@contextmanager
def storage_errors(
    path: Any, action: str, needed_bytes: int = 0, *, resumes: bool = True
) -> Iterator[None]:
    """Turn an OSError into a StoreError that says what to do.

    Parameters
    ----------
    path, action
        What is being done there, such as ``"writing items 3 to 7"``.
    needed_bytes
        Size of the data before compression; 0 when it doesn't matter.
    resumes
        Whether a second run goes on where this one stopped.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if error.errno in _FULL:
            goes_on = ": it goes on where it stopped" if resumes else ""
            advice = (
                f"{needed_bytes:,} bytes needed, {free_bytes(path.parent):,} bytes free on its "
                f"file system; make room and run again{goes_on}"
            )
        elif error.errno in _FORBIDDEN:
            advice = (
                f"expected a place that this user may write to; change the permissions of "
                f"{path.parent} or choose another results folder"
            )
        elif error.errno in _LOCKLESS:
            advice = "mount its file system with locks (NFS 4, Lustre with -o flock)"
        else:
            advice = "check the folder and its file system, then run again"
        raise StoreError(f"{path}: {action} failed: {reason}; {advice}") from error


def write_atomically(path: Path, content: bytes) -> None:
    """Write a small file so that it is whole or unchanged, also after a power cut."""
    with storage_errors(path, "writing", len(content)), whole_file(path) as partial:
        partial.write_bytes(content)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a name to write a large file under, which becomes `path` when it is whole.

    The name ends as `path` does, since some writers tell the format by it. What an interrupted
    write leaves is removed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".partial-{path.name}")
    try:
        yield partial
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def hidden_sibling(path: Path, purpose: str) -> Path:
    """Name beside `path`, in the same file system, for what is being made or removed."""
    return path.with_name(f".{path.name}.{purpose}")


def remove_tree(path: Path) -> None:
    """Remove a file or folder, if there is one.

    A folder is renamed first, so that an interrupted removal never leaves half of it under its
    name.
    """
    with storage_errors(path, "removing"):
        doomed = hidden_sibling(path, "removed")
        shutil.rmtree(doomed, ignore_errors=True)
        if path.is_dir() and not path.is_symlink():
            path.rename(doomed)
            shutil.rmtree(doomed)
        else:
            path.unlink(missing_ok=True)


def to_disk(path: Path) -> None:
    """Bring all files in a folder to the disk, so that a power cut can't take them."""
    with storage_errors(path, "bringing it to the disk"):
        for place in [*path.rglob("*"), path]:
            descriptor = os.open(place, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def bytes_on_disk(path: Path) -> int:
    """Sum of the sizes of the files in a folder."""
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def free_bytes(folder: Path) -> int:
    """Return the bytes free on the file system of a folder, which needn't exist yet."""
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free
