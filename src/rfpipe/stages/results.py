"""Results of a stage: a store and, written last, the manifest that says that it is complete.

A store knows the fingerprint of all that it was made from. Where the workflow runs a stage,
Snakemake has found that it is due and has removed its manifest; in a loop over the stages,
`standing` tells what is left to do.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.provenance import versions
from rfpipe.store import open_arrays, read_manifest, write_arrays, write_manifest
from rfpipe.store.files import digest_of

FILES = "files.json"
"""Name of the manifest of a report's files."""

_log = logging.getLogger(__name__)


def standing(manifest: Path, made_from: str) -> dict[str, Any] | None:
    """Return a manifest whose store was made from the same things, else None.

    One that says anything else, or is damaged, is removed: its store is about to change.

    Parameters
    ----------
    made_from : str
        Fingerprint of all that the stage would make its store from.
    """
    store = manifest.with_suffix(".zarr")
    try:
        stated = read_manifest(manifest)
        # a schedule's manifest says nothing but what is to be shown
        known = stated if "fingerprint" in stated else open_arrays(store).attributes
    except IntegrityError as error:
        _log.warning("made anew, since it is damaged: %s", error)
    except StoreError:
        pass
    else:
        if known.get("fingerprint") == made_from and store.exists():
            return stated
    manifest.unlink(missing_ok=True)
    return None


def write_bundle(
    manifest: Path,
    made_from: str,
    arrays: Mapping[str, NDArray[Any]],
    facts: dict[str, Any],
    **more: Any,
) -> None:
    """Write a bundle of arrays and, beside it, its manifest.

    Parameters
    ----------
    made_from : str
        Fingerprint of all that it is made from.
    facts : dict
        Plain data for the manifest: stage, level, units, counts.
    **more
        Plain data for the store alone.
    """
    store = manifest.with_suffix(".zarr")
    made = {"fingerprint": made_from, "versions": versions()}
    write_arrays(store, arrays, {"facts": facts, **made, **more})
    write_manifest(manifest, {**facts, **open_arrays(store).entry(), **made})


def write_files(manifest: Path, files: Iterable[Path]) -> None:
    """Write a manifest with the digests of files that lie beside it or below."""
    digests = {
        path.relative_to(manifest.parent).as_posix(): digest_of(path.read_bytes()) for path in files
    }
    write_manifest(manifest, {"files": digests})
