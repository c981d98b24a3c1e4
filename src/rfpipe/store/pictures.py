"""Journaled stores of frames: what a capture writes, pattern by pattern, and can resume."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rfpipe.errors import (
    IncompleteError,
    InputError,
    IntegrityError,
    StaleStoreError,
    StoreError,
)
from rfpipe.ranges import ranges
from rfpipe.store.chunks import damaged_metadata, read_attributes
from rfpipe.store.files import (
    canonical_data,
    canonical_json,
    digest_of,
    remove_tree,
    storage_errors,
    write_atomically,
)
from rfpipe.store.items import KIND, ItemArray, make_item_array
from rfpipe.store.journal import JournalWriter, journal_bytes, read_journal
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import write_manifest
from rfpipe.store.places import METADATA

_JOURNAL = "journal.jsonl"
# Says, in a store's folder, that its items were removed on purpose.
_DROPPED = "dropped.json"
_log = logging.getLogger(__name__)


class PictureStore:
    """A zarr array whose first axis counts items (patterns), with a journal of captured items.

    An item counts as captured when it is in the journal, which it enters after its chunk is
    written. A process killed at any moment loses at most the block that it was writing, and a
    resumed store ends with the same bytes as one written without interruption. The journal also
    contains the digest of each item; every read checks it, and so detects damage by a power
    failure.

    A store is opened by `create` for writing or by `open` for reading, and is a context manager.
    Several threads may use it. One process may write while others read.

    Attributes
    ----------
    path : Path
        Folder with a zarr array, which any zarr reader opens, and the journal.
    shape : tuple of int
        (items, *item_shape).
    dtype : numpy.dtype
        Dtype of the frames.
    items_per_chunk, items_per_file : int
        See `rfpipe.store.chunks.ChunkedArray`.
    fingerprint : str
        Fingerprint of the configuration with which it was made.
    attributes : dict
        Plain data of the writer.
    dropped : bool
        True if its items were removed on purpose (`drop`); it is complete, but can't be read.
    """

    def __init__(self, path: Path) -> None:
        header = read_attributes(path, KIND)
        self.path = path
        try:
            self.fingerprint: str = header["fingerprint"]
            self.attributes: dict[str, Any] = header["attributes"]
        except KeyError as error:
            raise damaged_metadata(path, error) from error
        self._array = ItemArray(path)
        self.shape = self._array.shape
        self.dtype = self._array.dtype
        self.items_per_chunk = self._array.items_per_chunk
        self.items_per_file = self._array.items_per_file
        # Digest by captured item; a file with an item that the journal lost is written again.
        self._digests = self._array.whole_files(read_journal(path / _JOURNAL, self.shape[0]))
        self.dropped = (path / _DROPPED).exists()
        if self.dropped and not self.complete:
            raise IntegrityError(
                "damaged journal of a store whose items were dropped",
                place=path / _JOURNAL,
                remedy=f"remove {path} and run the stage that writes it again",
            )
        self._journal: JournalWriter | None = None
        self._lock = StoreLock(path)
        self._thread_lock = threading.Lock()

    @classmethod
    def create(
        cls,
        path: Path,
        shape: tuple[int, ...],
        dtype: DTypeLike,
        fingerprint: str,
        attributes: dict[str, Any],
        *,
        items_per_chunk: int = 1,
        chunks_per_file: int = 1,
    ) -> PictureStore:
        """Create a store, or resume an existing one; it is locked until `close`.

        A resumed store keeps its attributes and chunks. All its items are read and checked;
        damaged ones count as missing.

        Parameters
        ----------
        path, shape, dtype, fingerprint, attributes
            Attributes of the store; the number of items may be 0.
        items_per_chunk : int
            With 1, a resumed capture repeats no item. With more, small frames are written faster:
            a file takes about 0.5 ms.
        chunks_per_file : int
            With more than 1, files are shards of zarr v3, whose chunks can be read separately. One
            writer writes a complete shard.

        Raises
        ------
        LockedError
            When another process writes the store.
        StaleStoreError
            When the existing store has another fingerprint, shape or dtype: restore the settings,
            or `discard` it.
        IntegrityError
            When its metadata are damaged.
        StoreError
            When the disk is full or the folder isn't writable.
        InputError
            When `path` exists and isn't a store.
        """
        frame_dtype = np.dtype(dtype)
        header = {"kind": KIND, "fingerprint": fingerprint, "attributes": attributes}
        header = canonical_data(header, f"{path}: attributes")
        lock = StoreLock(path)
        lock.acquire()
        try:
            if not (path / METADATA).exists():
                make_item_array(path, shape, frame_dtype, header, items_per_chunk, chunks_per_file)
            store = cls(path)
            store._check_configuration(shape, frame_dtype, fingerprint)
            if not store.dropped:
                store._repair()
            store._journal = JournalWriter(path / _JOURNAL)
        except BaseException:
            lock.release()
            raise
        store._lock = lock
        return store

    @classmethod
    def open(cls, path: Path) -> PictureStore:
        """Open a store for reading, with the items that are captured now.

        Raises StoreError if there is no store, IntegrityError if its metadata are damaged.
        """
        return cls(path)

    @staticmethod
    def discard(path: Path) -> None:
        """Remove a store, if it exists; LockedError if another process writes it."""
        with StoreLock(path):
            remove_tree(path)

    @property
    def done(self) -> NDArray[np.bool_]:
        """True for captured items, (items,) bool."""
        done = np.zeros(self.shape[0], dtype=np.bool_)
        with self._thread_lock:
            done[list(self._digests)] = True
        return done

    @property
    def complete(self) -> bool:
        """True if all items are captured."""
        return len(self._digests) == self.shape[0]

    def missing(self, longest: int | None = None) -> list[tuple[int, int]]:
        """List the runs [start, stop) of missing items, in order; each covers complete files.

        A run has at most `longest` items, rounded down to complete files, and at least one file.
        """
        edges = np.flatnonzero(np.diff(~self.done, prepend=False, append=False))
        runs = [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
        if longest is None:
            return runs
        step = max(1, longest // self.items_per_file) * self.items_per_file
        return [part for start, stop in runs for part in ranges(stop, step, start)]

    def write(self, start: int, block: NDArray[Any]) -> None:
        """Write items, then enter them in the journal.

        Parameters
        ----------
        start : int
            Index of the first item.
        block : ndarray
            (B, *item_shape), in the store's dtype; complete files.

        Raises
        ------
        InputError
            When the block doesn't fit the store.
        StoreError
            When the store isn't open for writing, an item is captured already, or the disk is
            full. Captured items stay.
        """
        stop = start + len(block)
        self._open_journal()
        self._check_range(start, stop)
        captured = next((item for item in range(start, stop) if item in self._digests), None)
        if captured is not None:
            raise StoreError(
                f"item {captured} is captured already",
                place=self.path,
                remedy="write the runs that missing() returns, or discard the store to start over",
            )
        self.enter(start, self._array.write_items(start, block))

    def enter(self, start: int, digests: Sequence[str]) -> None:
        """Enter items from `start` on that an `ItemWriter` wrote; raises as `write`."""
        journal = self._open_journal()
        with self._thread_lock:
            journal.append(start, digests)
            self._digests.update(enumerate(digests, start))

    def read(self, start: int, stop: int) -> NDArray[Any]:
        """Return items [start, stop), (stop - start, *item_shape), checked against the journal.

        Raises
        ------
        StoreError
            When an item isn't captured yet, or the items were dropped.
        IntegrityError
            When a chunk is missing, truncated or altered.
        InputError
            When the range is out of bounds.
        """
        self._check_range(start, stop)
        absent = next((item for item in range(start, stop) if item not in self._digests), None)
        if absent is not None:
            raise IncompleteError(
                f"item {absent} isn't captured yet; {len(self._digests)} of {self.shape[0]} are",
                place=self.path,
                remedy="run the stage that writes it to the end",
            )
        if self.dropped and start < stop:
            raise StoreError(
                f"its {self.shape[0]} items were dropped after they had been used",
                place=self.path,
                remedy="remove it and run the stage that writes it again",
            )
        block = self._array.read_items(start, stop, self._digests)
        if block is None:
            item = next(iter(self._array.damaged(start, stop, self._digests)), start)
            raise IntegrityError(
                f"item {item} is missing, truncated or altered; its digest in {_JOURNAL} is "
                f"{self._digests[item]}",
                place=self._array.file(item),
                remedy=f"Run the stage that writes {self.path} again: it checks every item and "
                "replaces the damaged ones",
            )
        return block

    def damaged(self) -> list[int]:
        """List the captured items that are damaged, by reading all of them."""
        return self._array.damaged(0, self.shape[0], self._digests)

    def files_of(self, items: Sequence[int]) -> list[Path]:
        """Return the file of each item."""
        return [self._array.file(item) for item in items]

    def digest(self) -> str:
        """Return the digest of all items in order; IncompleteError if one isn't captured yet."""
        if not self.complete:
            raise IncompleteError(
                f"{len(self._digests)} of {self.shape[0]} items are captured",
                place=self.path,
                remedy="capture all items: the digest of a store covers all of them",
            )
        header = canonical_json([self.dtype.str, list(self.shape)], str(self.path))
        items = "".join(self._digests[item] for item in range(self.shape[0]))
        return digest_of(header, items.encode())

    def entry(self) -> dict[str, Any]:
        """Describe a complete store for a manifest: digest, dtype, shape; raises as `digest`."""
        return {"digest": self.digest(), "dtype": self.dtype.str, "shape": list(self.shape)}

    def close(self) -> None:
        """Sync the journal to the disk and release the lock; no effect on a closed store."""
        journal, self._journal = self._journal, None
        try:
            if journal is not None:
                journal.close()
                if self.complete:  # sort the lines, so that equal stores have equal bytes
                    self._write_journal(dict(sorted(self._digests.items())))
        finally:
            self._lock.release()

    def __reduce__(self) -> tuple[type[PictureStore], tuple[Path]]:
        """Pickle for reading in another process."""
        return type(self), (self.path,)

    def __enter__(self) -> PictureStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open_journal(self) -> JournalWriter:
        if self._journal is None:
            raise StoreError(
                "store isn't open for writing", place=self.path, remedy="use PictureStore.create"
            )
        return self._journal

    def _check_range(self, start: int, stop: int) -> None:
        if not 0 <= start <= stop <= self.shape[0]:
            raise InputError(
                "no such range of items",
                value=f"{start} to {stop}",
                place=self.path,
                remedy=f"expected a range within 0 to {self.shape[0]}",
            )

    def _check_configuration(
        self, shape: tuple[int, ...], dtype: np.dtype[Any], fingerprint: str
    ) -> None:
        made = {"fingerprint": self.fingerprint, "shape": self.shape, "dtype": self.dtype}
        expected = {"fingerprint": fingerprint, "shape": tuple(shape), "dtype": dtype}
        if made != expected:
            raise StaleStoreError(
                f"store was made with another configuration, {made} instead of {expected}; "
                f"{len(self._digests)} items are captured",
                place=self.path,
                remedy="restore the settings with which it was made, or discard it to start over",
            )

    def _repair(self) -> None:
        """Remove partial files and the journal lines of damaged items; needs the lock."""
        for partial in self.path.glob(".*partial*"):
            partial.unlink()
        damaged = self._array.damaged(0, self.shape[0], self._digests)
        for item in damaged:
            del self._digests[item]
        self._digests = self._array.whole_files(self._digests)
        self._write_journal(self._digests)
        if damaged:
            _log.warning(
                "%s: %d items are damaged and will be written again, from item %d on",
                *(self.path, len(damaged), damaged[0]),
            )

    def _write_journal(self, digests: dict[int, str]) -> None:
        """Write the journal, if its content changes."""
        journal, content = self.path / _JOURNAL, journal_bytes(digests)
        if (journal.read_bytes() if journal.exists() else b"") != content:
            write_atomically(journal, content)


def is_dropped(path: Path) -> bool:
    """Return True if the items of a store were dropped after they had been used."""
    return (path / _DROPPED).exists()


def drop(path: Path) -> int:
    """Remove the items of a complete frame store, but keep their digests.

    An interrupted call can be repeated.

    Returns
    -------
    int
        Number of bytes freed.

    Raises
    ------
    LockedError
        When another process writes the store.
    StoreError
        When items are missing or can't be removed.
    IntegrityError
        When metadata or journal are damaged.
    """
    with StoreLock(path):
        store = PictureStore.open(path)
        if not store.complete:
            raise IncompleteError(
                "only the items of a complete store can be dropped",
                place=path,
                remedy="run the stage that writes it to the end",
            )
        if not store.dropped:
            write_manifest(path / _DROPPED, {"digest": store.digest(), "shape": list(store.shape)})
        freed = 0
        with storage_errors(path, "removing items"):
            for file in sorted(path.glob("c.*")):
                freed += file.stat().st_size
                file.unlink()
    return freed
