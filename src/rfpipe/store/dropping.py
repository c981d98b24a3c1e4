"""Removing the items of a store once they have been used, so that it is known to be no damage."""

from __future__ import annotations

import os
from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.store.files import storage_errors
from rfpipe.store.frames import FrameStore
from rfpipe.store.items import DROPPED, ItemArray
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import write_manifest

__all__ = ["drop", "to_disk"]


def drop(path: Path) -> int:
    """Remove the items of a complete frame store; what is left says so and keeps their digests.

    May be cut off anywhere and called again.

    Returns
    -------
    int
        Bytes freed.

    Raises
    ------
    LockedError
        When another process writes the store.
    StoreError
        When items are missing, or can't be removed.
    IntegrityError
        When its metadata or its journal are damaged.
    """
    with StoreLock(path):
        store = FrameStore.open(path)
        if not store.complete:
            raise StoreError(f"{path}: isn't complete; only a complete store can be dropped")
        if not store.dropped:
            write_manifest(path / DROPPED, {"digest": store.digest(), "shape": list(store.shape)})
        freed = 0
        with storage_errors(path, "removing items"):
            for file in ItemArray(path).files():
                freed += file.stat().st_size
                file.unlink()
    return freed


def to_disk(path: Path) -> None:
    """Bring all files in a folder to the disk, so that a power cut can't take them.

    Raises
    ------
    StoreError
        When the disk fails.
    """
    with storage_errors(path, "bringing it to the disk"):
        for place in [*path.rglob("*"), path]:
            descriptor = os.open(place, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
