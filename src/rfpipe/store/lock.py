"""One writer a store: an exclusive lock that ends with its process."""

from __future__ import annotations

import fcntl
import os
import socket
import time
from pathlib import Path

from rfpipe.errors import LockedError
from rfpipe.store.files import hidden_sibling, storage_errors

# A file server frees the locks of a machine that died when its lease has run out: 90 s by NFS.
_LEASE_SECONDS = 120.0
# Reading the lock's holder takes the lock for a moment.
_GLANCE_SECONDS = 0.2
_POLL_SECONDS = 0.1


class StoreLock:
    """Exclusive lock on a store, held by an open file beside it.

    The system releases it when the process ends, however it ends: an orphan of a killed workflow
    still keeps a second writer out. On a file system that machines share, the lock holds for all
    of them, and that of a machine that died ends when the file server gives it up: two minutes are
    waited for that where the holder is on another machine.

    Parameters
    ----------
    path
        The store, which needn't exist yet. The lock file is its hidden sibling ``.name.lock``,
        there only while the lock is held (or after a kill).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock_file = hidden_sibling(path, "lock")
        self._descriptor: int | None = None

    @staticmethod
    def holder(path: Path) -> str | None:
        """Return the process, and its machine where it is another one, that hold a store's lock."""
        try:
            descriptor = os.open(hidden_sibling(path, "lock"), os.O_RDONLY)
        except OSError:
            return None
        try:
            # shared: a file server refuses exclusive locks of files that are open for reading
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return _holder(descriptor)[0]
        finally:
            os.close(descriptor)
        return None

    def acquire(self) -> None:
        """Take the lock.

        Raises
        ------
        LockedError
            When another process, or another lock in this one, holds it.
        StoreError
            When the folder isn't writable, or its file system has no locks.
        """
        begun = time.monotonic()
        with storage_errors(self._lock_file, "locking", resumes=False):
            self._lock_file.parent.mkdir(parents=True, exist_ok=True)
            while self._descriptor is None:
                descriptor = os.open(self._lock_file, os.O_RDWR | os.O_CREAT, 0o644)
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    holder, is_elsewhere = _holder(descriptor)
                    os.close(descriptor)
                    patience = _LEASE_SECONDS if is_elsewhere else _GLANCE_SECONDS
                    if time.monotonic() > begun + patience:
                        raise LockedError(
                            f"process {holder} is writing this store",
                            place=self._path,
                            remedy="wait until it ends, or end it, then run again",
                        ) from None
                    time.sleep(_POLL_SECONDS)
                    continue
                except OSError:
                    os.close(descriptor)
                    raise
                # Its last holder may have removed the file between our open and our lock.
                if self._is_in_place(descriptor):
                    os.ftruncate(descriptor, 0)
                    os.write(descriptor, f"{os.getpid()} {socket.gethostname()}\n".encode())
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
            return os.path.samestat(self._lock_file.stat(), os.fstat(descriptor))
        except FileNotFoundError:
            return False


def _holder(descriptor: int) -> tuple[str, bool]:
    """Return who says in a lock file to hold it, and whether that is another machine's process."""
    process, _, machine = os.read(descriptor, 256).decode(errors="replace").strip().partition(" ")
    is_elsewhere = machine not in ("", socket.gethostname())
    return f"{process or 'unknown'}{f' on {machine}' if is_elsewhere else ''}", is_elsewhere
