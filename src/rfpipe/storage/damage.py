"""Damaged results of stages: their error, and the removal of their manifests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rfpipe.errors import DamagedStageError, StoreError
from rfpipe.storage.base import STAGES
from rfpipe.store import restore_header


@contextmanager
def raising_damage_of(manifest: Path) -> Iterator[None]:
    """Raise DamagedStageError for a `StoreError`: its stage runs again without its manifest."""
    try:
        yield
    except StoreError as error:
        remedy = f"{error.remedy}. To do so, remove {manifest} and run again"
        raise DamagedStageError(
            error.what,
            value=error.value,
            place=error.place,
            remedy=remedy.removeprefix(". "),
            manifest=manifest,
        ) from error


def clear(error: DamagedStageError) -> bool:
    """Remove the manifest of a damaged stage, so that the stage runs again; return whether it does.

    The manifests of the following stages of its level are removed, too. Captures stay, since only
    the user knows whether the scene is still in place; of a capture, damaged headers are restored.
    """
    manifest = error.manifest
    if manifest.stem == "capture":
        restored = [restore_header(store) for store in manifest.parent.glob("*.zarr")]
        if not any(restored):
            return False
    for path in with_followers(manifest):
        path.unlink(missing_ok=True)
    return True


def with_followers(manifest: Path) -> list[Path]:
    """Return the manifests of a stage and of the following stages of its level.

    Snakemake makes a missing file again only if a file that follows from it is missing, too.
    """
    if manifest.stem not in STAGES:
        return [manifest]
    followers = STAGES[STAGES.index(manifest.stem) :]
    return [manifest.with_name(f"{stage}.json") for stage in followers]
