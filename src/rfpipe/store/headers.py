"""Headers of frame stores: a second copy, and what to do when the first is damaged.

A capture's header, its ``zarr.json``, is small beside the hours behind its frames. A copy of it
with a checksum lies in the store's folder. Where that is damaged, too, the header is made as that
of a new store would be, which fits if the frames can be read with it as the journal says.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.store.chunks import METADATA
from rfpipe.store.files import hidden_sibling, remove_tree, storage_errors, write_atomically
from rfpipe.store.frames import FrameStore
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import read_manifest, write_manifest

__all__ = ["HEADER", "header_is_whole", "keep_header", "rebuild_header", "restore_header"]

HEADER = "header.json"
"""The copy of a store's metadata, in its folder."""

_SAMPLE = 16
_TEXT = "metadata"


def keep_header(path: Path) -> None:
    """Keep a copy of the header of a store that is known to be right.

    Raises
    ------
    StoreError
        When the disk is full or the folder isn't writable.
    """
    text = _content(path)
    if text is not None and _kept(path) != text:
        write_manifest(path / HEADER, {_TEXT: text})


def header_is_whole(path: Path) -> bool:
    """Whether a store's header is that of its copy; True where no copy is kept."""
    kept = _kept(path)
    if kept is None:
        return not (path / HEADER).exists()
    return kept == _content(path)


def restore_header(path: Path) -> bool:
    """Write a damaged or missing header again, from its copy.

    Returns
    -------
    bool
        Whether it had to be written.

    Raises
    ------
    LockedError
        When another process writes the store.
    StoreError
        When the disk is full or the folder isn't writable.
    """
    kept = _kept(path)
    if kept is None or kept == _content(path):
        return False
    with StoreLock(path):
        write_atomically(path / METADATA, kept.encode())
    return True


def rebuild_header(path: Path, make: Callable[[Path], FrameStore]) -> bool:
    """Give a store the header of a new one, if its frames can be read with that.

    Its chunks and its journal stay as they are in any case.

    Parameters
    ----------
    path : Path
    make : callable
        Makes an empty store of what is expected at `path`, at a place that it is given.

    Returns
    -------
    bool
        Whether the header was written; False where the journal names no frames, or none of the
        first of them is what it says.

    Raises
    ------
    LockedError
        When another process writes the store.
    StoreError
        When the disk is full or the folder isn't writable.
    """
    new = hidden_sibling(path, "expected")
    remove_tree(new)
    try:
        make(new).close()
        expected = (new / METADATA).read_bytes()
    finally:
        remove_tree(new)
    place = path / METADATA
    with StoreLock(path):
        before = place.read_bytes() if place.is_file() else None
        write_atomically(place, expected)
        if _is_readable(path):
            return True
        with storage_errors(place, "restoring"):
            place.unlink()
            if before is not None:
                write_atomically(place, before)
    return False


def _is_readable(path: Path) -> bool:
    """Whether some of the first frames are what the journal says."""
    store = FrameStore.open(path)
    captured = [int(item) for item in store.done.nonzero()[0][:_SAMPLE]]
    return any(_reads(store, item) for item in captured)


def _reads(store: FrameStore, item: int) -> bool:
    try:
        store.read(item, item + 1)
    except StoreError:
        return False
    return True


def _content(path: Path) -> str | None:
    """Return a store's metadata as they stand there, None where there are none."""
    place = path / METADATA
    if not place.is_file():
        return None
    with storage_errors(place, "reading"):
        return place.read_bytes().decode(errors="replace")


def _kept(path: Path) -> str | None:
    """Return the metadata as the copy has them, None where it is missing or damaged."""
    try:
        held: dict[str, Any] = read_manifest(path / HEADER)
        text = held[_TEXT]
        json.loads(text)
    except (IntegrityError, StoreError, KeyError, ValueError, TypeError):
        return None
    return str(text)
