"""Results in files: a store of arrays and, written last, its manifest beside it."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.provenance import versions
from rfpipe.storage.base import Facts, Manifest
from rfpipe.store import open_arrays, read_manifest, write_arrays, write_manifest
from rfpipe.store.files import digest_of

FILES = "files.json"
"""Name of the manifest of a report's files."""

_log = logging.getLogger(__name__)


def current_manifest(manifest: Path, fingerprint: str) -> Manifest | None:
    """Return a manifest if its store has a fingerprint, else None.

    A manifest of another fingerprint, or a damaged one, is removed, since its store is about to
    change.
    """
    store = manifest.with_suffix(".zarr")
    try:
        facts = read_manifest(manifest)
        # the manifest of a schedule has no fingerprint
        attributes = facts if "fingerprint" in facts else open_arrays(store).attributes
    except IntegrityError as error:
        _log.warning("written again, since it is damaged: %s", error)
    except StoreError:
        pass
    else:
        if attributes.get("fingerprint") == fingerprint and store.exists():
            return facts
    manifest.unlink(missing_ok=True)
    return None


def write_result(
    manifest: Path,
    fingerprint: str,
    arrays: Mapping[str, NDArray[Any]],
    facts: Facts,
    **attributes: Any,
) -> None:
    """Write arrays and, beside them, a manifest of `facts`; `attributes` are for the store."""
    store = manifest.with_suffix(".zarr")
    stamp = {"fingerprint": fingerprint, "versions": versions()}
    write_arrays(store, arrays, {"facts": facts, **stamp, **attributes})
    write_manifest(manifest, {**facts, **open_arrays(store).entry(), **stamp})


def write_files(manifest: Path, files: Iterable[Path]) -> None:
    """Write a manifest with the digests of files that lie beside it or below."""
    digests = {
        path.relative_to(manifest.parent).as_posix(): digest_of(path.read_bytes()) for path in files
    }
    write_manifest(manifest, {"files": digests})
