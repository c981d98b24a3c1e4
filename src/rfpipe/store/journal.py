"""Journals: which items of a store are captured, and the digest of each."""

from __future__ import annotations

import os
import re
import time
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from rfpipe.store.files import storage_errors
from rfpipe.store.places import content_of

_SECONDS_BETWEEN_SYNCS = 1.0
_LINE = re.compile(rb'^{"item":(\d+),"digest":"([0-9a-f]+)","check":"[0-9a-f]{8}"}\n', re.MULTILINE)


def read_journal(path: Path, n_items: int) -> dict[int, str]:
    """Read a journal; lines that aren't whole don't count.

    A kill or a power cut tears the last line; a line that someone altered doesn't match its own
    checksum.

    Returns the digest by item, in the order of the lines; lines of items beyond the store's
    `n_items` don't count, and a missing journal is empty.
    """
    with storage_errors(path, "reading"):
        content = content_of(path) or b""
    entries = ((int(match[1]), match[2].decode(), match[0]) for match in _LINE.finditer(content))
    return {
        item: digest
        for item, digest, line in entries
        if item < n_items and line == _line(item, digest)
    }


def journal_bytes(entries: Mapping[int, str]) -> bytes:
    """Content of a journal whose lines stand in the order of `entries`."""
    return b"".join(_line(item, digest) for item, digest in entries.items())


class JournalWriter:
    """Appends to a journal; for the holder of the store's lock.

    Each line is handed to the system at once, so that a killed process loses none; it is brought
    to the disk at most once a second and at `close`.

    Parameters
    ----------
    path
        The journal; made when missing. Its last line must be whole (or the next would join it).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with storage_errors(path, "opening"):
            self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        self._last_sync = time.monotonic()

    def append(self, first: int, digests: Sequence[str]) -> None:
        """Add the items `first`, `first` + 1, ... with their digests, all or none."""
        content = journal_bytes({first + k: digest for k, digest in enumerate(digests)})
        with storage_errors(self._path, "writing", len(content)):
            before = os.fstat(self._descriptor).st_size
            try:
                rest = memoryview(content)
                while rest:  # a nearly full disk takes a part, then fails
                    rest = rest[os.write(self._descriptor, rest) :]
            except OSError:
                os.ftruncate(self._descriptor, before)
                raise
            if time.monotonic() - self._last_sync > _SECONDS_BETWEEN_SYNCS:
                self._sync()

    def close(self) -> None:
        """Bring the journal to the disk and close it."""
        with storage_errors(self._path, "closing"):
            try:
                self._sync()
            finally:
                os.close(self._descriptor)

    def _sync(self) -> None:
        os.fsync(self._descriptor)
        self._last_sync = time.monotonic()


def _line(item: int, digest: str) -> bytes:
    check = zlib.crc32(f"{item}:{digest}".encode())
    return f'{{"item":{item},"digest":"{digest}","check":"{check:08x}"}}\n'.encode()
