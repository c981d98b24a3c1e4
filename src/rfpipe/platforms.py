"""Locks, flushes and forks of the operating system; docs/platforms.md lists the differences."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

IS_WINDOWS = os.name == "nt"

BINARY: int = getattr(os, "O_BINARY", 0)
"""Flag of `os.open` without which Windows writes two characters for each end of a line."""

_HAS_FLOCK = find_spec("fcntl") is not None

_LOCKED_BYTE = 2**30
"""Position of the byte that is locked on Windows, beyond the content, which can't be read."""


def can_fork() -> bool:
    """Return True where a process with libraries loaded can be forked."""
    return sys.platform == "linux"  # libraries of macOS may abort in a fork; Windows has none


def lock_file(descriptor: int, *, shared: bool = False) -> None:
    """Lock an open file until it is closed; Windows has exclusive locks only.

    Raises
    ------
    BlockingIOError
        If another process, or another descriptor of this process, holds a lock of the file.
    OSError
        If the file system has no locks.
    """
    if _HAS_FLOCK:
        fcntl: Any = import_module("fcntl")
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        return
    msvcrt: Any = import_module("msvcrt")
    os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except PermissionError as error:
        raise BlockingIOError(*error.args) from error
    finally:
        os.lseek(descriptor, 0, os.SEEK_SET)


def close_and_remove(descriptor: int, path: Path) -> None:
    """Remove a locked file, and close its descriptor, which unlocks it."""
    if not IS_WINDOWS:
        path.unlink(missing_ok=True)
        os.close(descriptor)
        return
    os.close(descriptor)  # Windows doesn't remove open files
    try:
        path.unlink(missing_ok=True)
    except PermissionError:  # another process has opened it, to lock it
        return


def sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    if IS_WINDOWS and path.is_dir():  # Windows can't open folders; NTFS journals their names
        return
    # Windows flushes only files that are open for writing
    descriptor = os.open(path, os.O_RDWR if IS_WINDOWS else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
