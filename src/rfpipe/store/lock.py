"""One writer a store: an exclusive lock that ends with its process."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from rfpipe.errors import LockedError
from rfpipe.store.files import hidden_sibling, storage_errors

__all__ = ["StoreLock"]


class StoreLock:
    """Exclusive lock on a store, held by an open file beside it.

    The system releases it when the process ends, however it ends. A workflow killed alone leaves
    its stage running; that orphan still holds its locks and so keeps a second writer out.

    Parameters
    ----------
    path
        The store, which needn't exist yet. The lock file is its hidden sibling ``.name.lock``,
        there only while the lock is held (or after a kill).

    Raises
    ------
    LockedError
        From `acquire`, when another process, or another lock in this one, holds it.
    StoreError
        From `acquire`, when the folder isn't writable.

    Examples
    --------
    >>> with StoreLock(Path("results/scene/capture.zarr")):
    ...     pass
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock_file = hidden_sibling(path, "lock")
        self._descriptor: int | None = None

    @staticmethod
    def holder(path: Path) -> str | None:
        """Name the process that holds the lock of a store, None where none does."""
        try:
            descriptor = os.open(hidden_sibling(path, "lock"), os.O_RDONLY)
        except OSError:
            return None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return os.read(descriptor, 32).decode(errors="replace").strip() or "unknown"
        finally:
            os.close(descriptor)
        return None

    def acquire(self) -> None:
        """Take the lock, or raise at once."""
        with storage_errors(self._lock_file, "locking"):
            self._lock_file.parent.mkdir(parents=True, exist_ok=True)
            while self._descriptor is None:
                descriptor = os.open(self._lock_file, os.O_RDWR | os.O_CREAT, 0o644)
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    holder = os.read(descriptor, 32).decode(errors="replace").strip()
                    os.close(descriptor)
                    raise LockedError(
                        f"{self._path}: process {holder or 'unknown'} is writing this store; wait "
                        "until it ends, or end it, then run again"
                    ) from None
                except OSError:
                    os.close(descriptor)
                    raise
                # Its last holder may have removed the file between our open and our lock.
                if self._is_in_place(descriptor):
                    os.ftruncate(descriptor, 0)
                    os.write(descriptor, f"{os.getpid()}\n".encode())
                    self._descriptor = descriptor
                else:
                    os.close(descriptor)

    def release(self) -> None:
        """Give the lock back; does nothing when it isn't held."""
        if self._descriptor is not None:
            self._lock_file.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> StoreLock:
        self.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _is_in_place(self, descriptor: int) -> bool:
        try:
            found = self._lock_file.stat()
        except FileNotFoundError:
            return False
        ours = os.fstat(descriptor)
        return (found.st_dev, found.st_ino) == (ours.st_dev, ours.st_ino)
