"""Exclusive lock on a store, which ends with the process that holds it."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

from rfpipe.errors import LockedError
from rfpipe.platforms import BINARY, close_and_remove, lock_file
from rfpipe.store.files import hidden_sibling, storage_errors

# A file server releases the locks of a crashed machine when its lease expires, after 90 s in NFS.
_LEASE_SECONDS = 120.0
# Another process that only reads the holder's name takes the lock for a moment.
_GLANCE_SECONDS = 0.2
_POLL_SECONDS = 0.1


class StoreLock:
    """Exclusive lock on a store, by a lock on an open file next to it.

    The system releases the lock when the process ends, also if it is killed; an orphan process of
    a killed workflow still excludes a second writer. On a shared file system, the lock is valid
    for all machines. If a machine crashes, the file server releases its lock later; so `acquire`
    waits two minutes for a lock of another machine.

    Parameters
    ----------
    path : Path
        The store, which may not exist yet. The lock file ``.name.lock`` exists while the lock is
        held, and after a kill.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock_file = hidden_sibling(path, "lock")
        self._descriptor: int | None = None

    @staticmethod
    def holder(path: Path) -> str | None:
        """Return the process that holds a store's lock, with its machine if it is another one."""
        try:
            descriptor = os.open(hidden_sibling(path, "lock"), os.O_RDONLY)
        except OSError:
            return None
        try:
            # shared: a file server refuses exclusive locks of files that are open for reading
            lock_file(descriptor, shared=True)
        except BlockingIOError:
            return _holder(descriptor)[0]
        finally:
            os.close(descriptor)
        return None

    def acquire(self) -> None:
        """Acquire the lock.

        Raises
        ------
        LockedError
            When another process, or another `StoreLock` in this process, holds it.
        StoreError
            When the folder isn't writable, or its file system has no locks.
        """
        begun = time.monotonic()
        with storage_errors(self._lock_file, "locking", resumes=False):
            self._lock_file.parent.mkdir(parents=True, exist_ok=True)
            while not self._try_to_lock(time.monotonic() - begun):
                time.sleep(_POLL_SECONDS)

    def _try_to_lock(self, waited_seconds: float) -> bool:
        """Try once to acquire the lock; LockedError if its holder has been waited for enough."""
        descriptor = os.open(self._lock_file, os.O_RDWR | os.O_CREAT | BINARY, 0o644)
        try:
            lock_file(descriptor)
        except BlockingIOError:
            holder, is_remote = _holder(descriptor)
            os.close(descriptor)
            if waited_seconds > (_LEASE_SECONDS if is_remote else _GLANCE_SECONDS):
                raise LockedError(
                    f"process {holder} is writing this store",
                    place=self._path,
                    remedy="wait until it ends, or end it, then run again",
                ) from None
            return False
        except OSError:
            os.close(descriptor)
            raise
        if not self._is_in_place(descriptor):  # its holder removed it after our open
            os.close(descriptor)
            return False
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()} {socket.gethostname()}\n".encode())
        self._descriptor = descriptor
        return True

    def release(self) -> None:
        """Release the lock; does nothing when it isn't held."""
        if self._descriptor is not None:
            close_and_remove(self._descriptor, self._lock_file)
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
    """Return the process named in a lock file, and whether it runs on another machine."""
    process, _, machine = os.read(descriptor, 256).decode(errors="replace").strip().partition(" ")
    is_remote = machine not in ("", socket.gethostname())
    return f"{process or 'unknown'}{f' on {machine}' if is_remote else ''}", is_remote
