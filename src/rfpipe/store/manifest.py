"""Manifests: the small JSON files that say that a stage is complete."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.store.files import canonical_json, digest_of, storage_errors, write_atomically
from rfpipe.store.places import content_of

_CHECKSUM = "checksum"


def write_manifest(path: Path, data: dict[str, Any]) -> None:
    """Write a manifest, whole or not at all.

    Equal data give identical bytes, so `data` should hold no times, host names or absolute
    paths. Write it last: its existence says that the stores it describes are complete.

    Raises
    ------
    InputError
        When `data` isn't plain, or holds NaN, infinity or the key ``"checksum"``.
    StoreError
        When the disk is full or the folder isn't writable.
    """
    if _CHECKSUM in data:
        raise InputError("reserved key", value=_CHECKSUM, place=path, remedy="use another key")
    checksum = digest_of(canonical_json(data, str(path)))
    content = canonical_json({**data, _CHECKSUM: checksum}, str(path), indent=2)
    write_atomically(path, content + b"\n")


def read_manifest(path: Path) -> dict[str, Any]:
    """Read what was given to `write_manifest`, tuples as lists.

    Raises
    ------
    StoreError
        When there is none.
    IntegrityError
        When it is truncated or altered.
    """
    with storage_errors(path, "reading"):
        content = content_of(path)
    if content is None:
        raise StoreError("no such manifest", place=path, remedy="run the stage that writes it")
    try:
        data: dict[str, Any] = json.loads(content)
        checksum = data.pop(_CHECKSUM, None)
        is_whole = checksum == digest_of(canonical_json(data, str(path)))
    except (ValueError, AttributeError, TypeError, InputError):  # NaN, too, was never written
        is_whole = False
    if not is_whole:
        raise IntegrityError(
            "damaged or altered manifest: its checksum doesn't match",
            place=path,
            remedy="remove it and run the stage that writes it again",
        )
    return data


def manifest_or_empty(path: Path) -> dict[str, Any]:
    """Read a manifest as `read_manifest`; empty where it is missing, unreadable or damaged."""
    try:
        return read_manifest(path)
    except StoreError:
        return {}
