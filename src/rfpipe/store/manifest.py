"""Manifests: small JSON files that mark a stage as complete."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.store.files import canonical_json, digest_of, storage_errors, write_atomically
from rfpipe.store.places import content_of

_CHECKSUM = "checksum"


def write_manifest(path: Path, data: dict[str, Any]) -> None:
    """Write a manifest atomically.

    Equal data give identical bytes, so `data` should contain no times, host names or absolute
    paths. Write it last: its existence marks the stores that it describes as complete.

    Raises
    ------
    InputError
        When `data` isn't plain, or contains NaN, infinity or the key ``"checksum"``.
    StoreError
        When the disk is full or the folder isn't writable.
    """
    if _CHECKSUM in data:
        raise InputError("reserved key", value=_CHECKSUM, place=path, remedy="use another key")
    checksum = digest_of(canonical_json(data, str(path)))
    content = canonical_json({**data, _CHECKSUM: checksum}, str(path), indent=2)
    write_atomically(path, content + b"\n")


def read_manifest(path: Path) -> dict[str, Any]:
    """Read the data of a manifest, with tuples as lists.

    Raises
    ------
    StoreError
        When there is no manifest.
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
    except (ValueError, AttributeError, TypeError, InputError):  # InputError: NaN
        is_whole = False
    if not is_whole:
        raise IntegrityError(
            "damaged or altered manifest: its checksum doesn't match",
            place=path,
            remedy="remove it and run the stage that writes it again",
        )
    return data


def manifest_or_empty(path: Path) -> dict[str, Any]:
    """Read a manifest as `read_manifest`; empty if it is missing, unreadable or damaged."""
    try:
        return read_manifest(path)
    except StoreError:
        return {}
