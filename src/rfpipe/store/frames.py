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
from rfpipe.store.chunks import damaged_metadata, read_attributes
from rfpipe.store.files import (
    canonical_json,
    digest_of,
    plain,
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


class FrameStore:
    """A zarr array whose first axis counts items (patterns), with a journal of what it holds.

    An item is captured when the journal says so, which happens after its chunk is written: a
    process killed at any moment loses at most the block that it was writing, and a resumed
    store ends with the same bytes as one written without a break. The journal also keeps each
    item's digest, which every read checks (and so finds what a power cut damaged).

    Made by `create`, for writing, or `open`, for reading; a context manager. Threads may share
    it; of processes, one may write while any number read.

    Attributes
    ----------
    path : Path
        Its folder: a zarr array that any zarr reader opens, and the journal.
    shape : tuple of int
        (items, *item shape).
    dtype : numpy.dtype
        Of the frames.
    items_per_chunk, items_per_file : int
        See `rfpipe.store.chunks.ChunkedArray`.
    fingerprint : str
        The configuration that it was made with.
    attributes : dict
        Plain data that its maker left.
    dropped : bool
        Whether its items were removed on purpose (`drop`): it is complete, but can't be read.
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
    ) -> FrameStore:
        """Make a store, or resume the one that stands there; locked until `close`.

        A resumed store keeps its own attributes and chunks. Each of its items is
        read and checked: a damaged one counts as missing, to be written again.

        Parameters
        ----------
        path, shape, dtype, fingerprint, attributes
            As the class has them; no items is fine.
        items_per_chunk
            One resumes at the very item where it stopped; several are quicker for small frames (a
            file costs about half a millisecond).
        chunks_per_file
            Several make shards of zarr v3: fewer files, of which each chunk can be read by itself.
            A shard is written whole, by one writer.

        Raises
        ------
        LockedError
            When another process writes it.
        StaleStoreError
            When a store with another fingerprint, shape or dtype stands there: restore the
            settings, or `discard` it.
        IntegrityError
            When its metadata are damaged.
        StoreError
            When the disk is full or the folder isn't writable.
        InputError
            When something that is no store stands there.
        """
        wanted = np.dtype(dtype)
        header = {"kind": KIND, "fingerprint": fingerprint, "attributes": attributes}
        header = plain(header, f"{path}: attributes")
        lock = StoreLock(path)
        lock.acquire()
        try:
            if not (path / METADATA).exists():
                make_item_array(path, shape, wanted, header, items_per_chunk, chunks_per_file)
            store = cls(path)
            store._refuse_other(shape, wanted, fingerprint)
            if not store.dropped:
                store._repair()
            store._journal = JournalWriter(path / _JOURNAL)
        except BaseException:
            lock.release()
            raise
        store._lock = lock
        return store

    @classmethod
    def open(cls, path: Path) -> FrameStore:
        """Open a store for reading; it shows what was captured at this moment.

        Raises StoreError when there is none, IntegrityError when its metadata are damaged.
        """
        return cls(path)

    @staticmethod
    def discard(path: Path) -> None:
        """Remove a store, if there is one; LockedError when another process writes it."""
        with StoreLock(path):
            remove_tree(path)

    @property
    def done(self) -> NDArray[np.bool_]:
        """(items,) bool: which are captured."""
        done = np.zeros(self.shape[0], dtype=np.bool_)
        with self._thread_lock:
            done[list(self._digests)] = True
        return done

    @property
    def complete(self) -> bool:
        """True when every item is captured."""
        return len(self._digests) == self.shape[0]

    def missing(self, longest: int | None = None) -> list[tuple[int, int]]:
        """List the runs [start, stop) of items still to capture, in order, in whole files.

        Runs are cut to at most `longest` items, rounded down to whole files but at least one.
        """
        edges = np.flatnonzero(np.diff(~self.done, prepend=False, append=False))
        runs = [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
        if longest is None:
            return runs
        step = max(1, longest // self.items_per_file) * self.items_per_file
        return [
            (first, min(first + step, stop))
            for start, stop in runs
            for first in range(start, stop, step)
        ]

    def write(self, start: int, block: NDArray[Any]) -> None:
        """Store items, then enter them in the journal.

        Parameters
        ----------
        start
            Index of the first.
        block
            (B, *item shape), in the store's dtype; whole files.

        Raises
        ------
        InputError
            When the block doesn't fit.
        StoreError
            When the store isn't open for writing, an item is captured already, or the disk is
            full: all that is in the journal stays.
        """
        stop = start + len(block)
        self._open_journal()
        self._check_range(start, stop)
        taken = next((item for item in range(start, stop) if item in self._digests), None)
        if taken is not None:
            raise StoreError(
                f"item {taken} is captured already",
                place=self.path,
                remedy="write the runs that missing() returns, or discard the store to start over",
            )
        self.enter(start, self._array.write_items(start, block))

    def enter(self, start: int, digests: Sequence[str]) -> None:
        """Enter items from `start` on that an `ItemWriter` wrote; errors as `write`."""
        journal = self._open_journal()
        with self._thread_lock:
            journal.append(start, digests)
            self._digests.update(enumerate(digests, start))

    def read(self, start: int, stop: int) -> NDArray[Any]:
        """Return items [start, stop), (stop - start, *item shape), checked against the journal.

        Raises
        ------
        StoreError
            When an item isn't captured yet, or the items were dropped.
        IntegrityError
            When a chunk is missing, truncated or altered; names the file and what to do.
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
        """List the captured items that can't be read as they were written; reads them all."""
        return self._array.damaged(0, self.shape[0], self._digests)

    def files_of(self, items: Sequence[int]) -> list[Path]:
        """Files in which items lie."""
        return [self._array.file(item) for item in items]

    def digest(self) -> str:
        """Digest of all items in their order; StoreError when one isn't captured yet."""
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
        """Describe a complete store for a manifest: digest, dtype and shape; errors as `digest`."""
        return {"digest": self.digest(), "dtype": self.dtype.str, "shape": list(self.shape)}

    def close(self) -> None:
        """Bring the journal to the disk and release the lock; a second time does nothing."""
        journal, self._journal = self._journal, None
        try:
            if journal is not None:
                journal.close()
                if self.complete:  # the lines stand in the order of the items, however they came
                    self._write_journal(dict(sorted(self._digests.items())))
        finally:
            self._lock.release()

    def __reduce__(self) -> tuple[type[FrameStore], tuple[Path]]:
        """Let another process read it."""
        return type(self), (self.path,)

    def __enter__(self) -> FrameStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open_journal(self) -> JournalWriter:
        if self._journal is None:
            raise StoreError(
                "store isn't open for writing", place=self.path, remedy="use FrameStore.create"
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

    def _refuse_other(self, shape: tuple[int, ...], dtype: np.dtype[Any], fingerprint: str) -> None:
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
        """Forget what a kill, a power cut or a meddler left unusable; needs the lock."""
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
        """Make the journal hold these lines, if it doesn't yet."""
        journal, content = self.path / _JOURNAL, journal_bytes(digests)
        if (journal.read_bytes() if journal.exists() else b"") != content:
            write_atomically(journal, content)


def is_dropped(path: Path) -> bool:
    """Whether the items of a store were dropped once they had been used."""
    return (path / _DROPPED).exists()


def drop(path: Path) -> int:
    """Remove the items of a complete frame store; what is left says so and keeps their digests.

    May be cut off anywhere and called again.

    Returns the bytes freed. Raises LockedError when another process writes the store, StoreError
    when items are missing or can't be removed, IntegrityError when metadata or journal are damaged.
    """
    with StoreLock(path):
        store = FrameStore.open(path)
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
