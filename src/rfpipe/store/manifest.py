"""Manifests: the small JSON files that say that a stage is complete."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.store.files import canonical_json, digest_of, storage_errors, write_atomically

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
        raise InputError(f'{path}: the key "{_CHECKSUM}" is the manifest\'s own; use another')
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
    if not path.is_file():
        raise StoreError(f"{path}: no such manifest; run the stage that writes it")
    with storage_errors(path, "reading"):
        content = path.read_bytes()
    advice = "remove it and run the stage that writes it again"
    try:
        data = json.loads(content)
    except ValueError as error:
        raise IntegrityError(f"{path}: damaged manifest ({error}); {advice}") from error
    if not isinstance(data, dict):
        raise IntegrityError(f"{path}: damaged manifest (expected a JSON object); {advice}")
    checksum = data.pop(_CHECKSUM, None)
    try:
        whole = checksum == digest_of(canonical_json(data, str(path)))
    except InputError:  # NaN, which was never written
        whole = False
    if not whole:
        raise IntegrityError(f"{path}: altered manifest (its checksum doesn't match); {advice}")
    return data
