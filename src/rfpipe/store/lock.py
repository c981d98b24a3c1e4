"""One writer a store: an exclusive lock that ends with its process."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import time
from dataclasses import dataclass
from pathlib import Path

from rfpipe.errors import LockedError, StoreError
from rfpipe.store.files import hidden_sibling, storage_errors

# A file server frees the locks of a machine that died when its lease has run out: 90 s by NFS.
_LEASE_SECONDS = 120.0
_POLL_SECONDS = 2.0
# Reading the lock's holder takes the lock for a moment.
_GLANCE_SECONDS = 0.2


@dataclass(frozen=True)
class Holder:
    """The process and machine that hold a lock, each empty where the lock file doesn't say.

    Where it isn't `is_known`, another machine's process has written its name, and nothing here
    holds the lock: that process was killed, or locks don't reach from one machine to another.
    """

    process: str
    machine: str
    is_known: bool = False

    @property
    def where(self) -> str | None:
        """The machine, where it is another one than this."""
        return None if self.machine in ("", socket.gethostname()) else self.machine

    def __str__(self) -> str:
        return f"{self.process or 'unknown'}{f' on {self.where}' if self.where else ''}"


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
    def holder(path: Path) -> Holder | None:
        """Tell who holds the lock of a store, or may hold it; None where nobody does."""
        try:
            descriptor = os.open(hidden_sibling(path, "lock"), os.O_RDONLY)
        except OSError:
            return None
        try:
            # shared: a file server refuses exclusive locks of files that are open for reading
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return Holder(*_read(descriptor), is_known=True)
        except OSError:  # a file system without locks: no job of ours writes there
            return None
        else:
            process, machine = _read(descriptor)
            return None if machine in ("", socket.gethostname()) else Holder(process, machine)
        finally:
            os.close(descriptor)

    def acquire(self) -> None:
        """Take the lock.

        Raises
        ------
        LockedError
            When another process, or another lock in this one, holds it.
        StoreError
            When the folder isn't writable, or its file system has no locks.
        """
        end = time.monotonic() + _LEASE_SECONDS
        with storage_errors(self._lock_file, "locking"):
            self._lock_file.parent.mkdir(parents=True, exist_ok=True)
            while self._descriptor is None:
                descriptor = os.open(self._lock_file, os.O_RDWR | os.O_CREAT, 0o644)
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    holder = _read(descriptor)
                    os.close(descriptor)
                    self._wait_for(*holder, end)
                    continue
                except OSError as error:
                    os.close(descriptor)
                    if error.errno in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
                        raise StoreError(
                            f"{self._path}: its file system has no locks ({error.strerror}), so "
                            "two machines could write it at the same time. Mount it with them "
                            "(NFS 4, Lustre with -o flock), or put the results elsewhere"
                        ) from error
                    raise
                # Its last holder may have removed the file between our open and our lock.
                if self._is_in_place(descriptor):
                    os.ftruncate(descriptor, 0)
                    os.write(descriptor, f"{os.getpid()} {socket.gethostname()}\n".encode())
                    self._descriptor = descriptor
                else:
                    os.close(descriptor)

    def _wait_for(self, process: str, machine: str, end: float) -> None:
        """Let some time pass where the holder may be on a machine that died, or raise."""
        holder = Holder(process, machine)
        is_elsewhere = holder.where is not None
        if is_elsewhere and time.monotonic() < end:
            time.sleep(_POLL_SECONDS)
            return
        if time.monotonic() < end - _LEASE_SECONDS + _GLANCE_SECONDS:
            time.sleep(_GLANCE_SECONDS / 4)
            return
        waited = f" after {_LEASE_SECONDS:.0f} s" if is_elsewhere else ""
        raise LockedError(
            f"{self._path}: process {holder} is writing this store{waited}; wait "
            "until it ends, or end it, then run again"
        )

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


def _read(descriptor: int) -> tuple[str, str]:
    """Return process and machine of a lock's holder, empty where it hasn't said so yet."""
    process, _, machine = os.read(descriptor, 256).decode(errors="replace").strip().partition(" ")
    return process, machine
