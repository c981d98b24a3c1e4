"""Journals: the captured items of a store, and the digest of each."""

from __future__ import annotations

import os
import re
import time
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from rfpipe.platforms import BINARY
from rfpipe.store.files import storage_errors
from rfpipe.store.places import content_of

_SECONDS_BETWEEN_SYNCS = 1.0
_LINE = re.compile(rb'^{"item":(\d+),"digest":"([0-9a-f]+)","check":"[0-9a-f]{8}"}\n', re.MULTILINE)


def read_journal(path: Path, n_items: int) -> dict[int, str]:
    """Read a journal, skipping damaged lines.

    A kill or a power failure truncates the last line; an altered line doesn't match its checksum.

    Returns
    -------
    dict of int to str
        The digest of each item, in the order of the lines, without items beyond `n_items`. Empty
        if there is no journal.
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
    """Return the content of a journal with lines in the order of `entries`."""
    return b"".join(_line(item, digest) for item, digest in entries.items())


class JournalWriter:
    """Appends to a journal; for the process that holds the store's lock.

    Each line is passed to the operating system immediately, so that a killed process loses none.
    The file is synced to the disk at most once a second, and by `close`.

    Parameters
    ----------
    path : Path
        The journal, created if missing. Its last line must be complete.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with storage_errors(path, "opening"):
            self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | BINARY, 0o644)
        self._last_sync = time.monotonic()

    def append(self, first: int, digests: Sequence[str]) -> None:
        """Add the items `first`, `first` + 1, ... with their digests, all or none."""
        content = journal_bytes({first + k: digest for k, digest in enumerate(digests)})
        with storage_errors(self._path, "writing", len(content)):
            before = os.fstat(self._descriptor).st_size
            try:
                unwritten = memoryview(content)
                while unwritten:  # on a nearly full disk, a partial write precedes the error
                    unwritten = unwritten[os.write(self._descriptor, unwritten) :]
            except OSError:
                os.ftruncate(self._descriptor, before)
                raise
            if time.monotonic() - self._last_sync > _SECONDS_BETWEEN_SYNCS:
                self._sync()

    def close(self) -> None:
        """Sync the journal to the disk and close it."""
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
