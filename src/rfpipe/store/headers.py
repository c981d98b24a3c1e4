"""Copy of the header of a capture, with a checksum: a small file that protects hours of work."""

from __future__ import annotations

import json
from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.store.files import storage_errors, write_atomically
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import read_manifest, write_manifest
from rfpipe.store.places import METADATA, content_of

_COPY, _TEXT = "header.json", "metadata"


def keep_header(path: Path) -> None:
    """Copy the header of an undamaged store."""
    header = _header(path)
    if header is not None and _copy(path) != header:
        write_manifest(path / _COPY, {_TEXT: header})


def header_is_whole(path: Path) -> bool:
    """Return True if a store's header equals its copy, or there is no copy."""
    copy = _copy(path)
    return not (path / _COPY).exists() if copy is None else copy == _header(path)


def restore_header(path: Path) -> bool:
    """Restore a damaged or missing header from its copy; return True if that was necessary."""
    copy = _copy(path)
    if copy is None or copy == _header(path):
        return False
    with StoreLock(path):
        write_atomically(path / METADATA, copy.encode())
    return True


def _header(path: Path) -> str | None:
    """Return a store's metadata; None without them."""
    with storage_errors(path / METADATA, "reading"):
        content = content_of(path / METADATA)
    return None if content is None else content.decode(errors="replace")


def _copy(path: Path) -> str | None:
    """Return the copy of the metadata; None if it is missing or damaged."""
    try:
        text = str(read_manifest(path / _COPY)[_TEXT])
        json.loads(text)
    except (StoreError, KeyError, ValueError):
        return None
    return text
