"""Headers of frame stores: a second copy, and what to do when the first is damaged.

A capture's header, its ``zarr.json``, is small beside the hours behind its frames. A copy of it
with a checksum lies in the store's folder. Where that is damaged, too, the header is made as that
of a new store would be, which fits if the frames can be read with it as the journal says.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.store.files import hidden_sibling, remove_tree, storage_errors, write_atomically
from rfpipe.store.frames import FrameStore
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import read_manifest, write_manifest
from rfpipe.store.places import METADATA, content_of

_COPY, _TEXT = "header.json", "metadata"
_SAMPLE = 16  # frames that are read to tell whether a header fits


def keep_header(path: Path) -> None:
    """Keep a copy of the header of a store that is known to be right."""
    header = _header(path)
    if header is not None and _copy(path) != header:
        write_manifest(path / _COPY, {_TEXT: header})


def header_is_whole(path: Path) -> bool:
    """Whether a store's header is that of its copy; True where no copy is kept."""
    copy = _copy(path)
    return not (path / _COPY).exists() if copy is None else copy == _header(path)


def restore_header(path: Path) -> bool:
    """Write a damaged or missing header again, from its copy; tell whether it had to be written."""
    copy = _copy(path)
    if copy is None or copy == _header(path):
        return False
    with StoreLock(path):
        write_atomically(path / METADATA, copy.encode())
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
        before = content_of(place)
        write_atomically(place, expected)
        store = FrameStore.open(path)
        for item in store.done.nonzero()[0][:_SAMPLE].tolist():
            with suppress(StoreError):
                store.read(item, item + 1)
                return True
        with storage_errors(place, "restoring"):
            place.unlink()
            if before is not None:
                write_atomically(place, before)
    return False


def _header(path: Path) -> str | None:
    """Return a store's metadata as they stand there, None where there are none."""
    with storage_errors(path / METADATA, "reading"):
        content = content_of(path / METADATA)
    return None if content is None else content.decode(errors="replace")


def _copy(path: Path) -> str | None:
    """Return the metadata as the copy has them, None where it is missing or damaged."""
    try:
        text = str(read_manifest(path / _COPY)[_TEXT])
        json.loads(text)
    except (StoreError, KeyError, ValueError):
        return None
    return text
