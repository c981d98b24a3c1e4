"""Results of a stage: a store and, written last, the manifest that says that it is complete.

Both know the fingerprint of all that they were made from. A job that runs again, often only because
something upstream is newer, believes a manifest that stands there and says that nothing has
changed. Where there is none, the store is checked, and what is wrong with it is made anew.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.provenance import versions
from rfpipe.store import ArrayBundle, open_arrays, read_manifest, write_arrays, write_manifest

__all__ = ["accept_bundle", "intact_bundle", "standing_manifest", "write_bundle"]

_log = logging.getLogger(__name__)


def standing_manifest(manifest: Path, fingerprint: str) -> dict[str, Any] | None:
    """Return a manifest that says that its store was made from the same things, else None.

    One that says anything else, or is damaged, is removed: its store is about to change.
    """
    try:
        stated = read_manifest(manifest)
    except IntegrityError as error:
        _log.warning("made anew, since it is damaged: %s", error)
    except StoreError:
        return None
    else:
        if stated["fingerprint"] == fingerprint and manifest.with_suffix(".zarr").exists():
            return stated
    manifest.unlink()
    return None


def accept_bundle(manifest: Path, fingerprint: str, *, believing: bool = False) -> bool:
    """Write the manifest of a bundle that was made from the same things, if there is one.

    Parameters
    ----------
    manifest : Path
        The bundle lies beside it.
    fingerprint : str
        Of all that the stage would make it from.
    believing : bool
        Whether a `standing_manifest` is enough; whoever reads the bundle checks it.

    Returns
    -------
    bool
        Whether there was one, undamaged; else the stage has to make it.
    """
    if believing and standing_manifest(manifest, fingerprint):
        return True
    bundle = intact_bundle(manifest.with_suffix(".zarr"), fingerprint)
    if bundle is None:
        return False
    _write_manifest(manifest, bundle)
    _log.info("%s: made from the same things before; kept", bundle.path)
    return True


def intact_bundle(store: Path, fingerprint: str | None) -> ArrayBundle | None:
    """Return a bundle that was made from the same things, if there is one and it is undamaged.

    `fingerprint` is None where it may be made from anything.
    """
    try:
        bundle = open_arrays(store)
        if fingerprint not in (None, bundle.attributes.get("fingerprint")):
            return None
        bundle.read_all()
    except IntegrityError as error:
        _log.warning("made anew, since it is damaged: %s", error)
        return None
    except StoreError:
        return None
    return bundle


def write_bundle(
    manifest: Path,
    fingerprint: str,
    arrays: Mapping[str, NDArray[Any]],
    facts: dict[str, Any],
    **more: Any,
) -> None:
    """Write a bundle of arrays and, beside it, its manifest.

    Parameters
    ----------
    manifest : Path
    fingerprint : str
        Of all that it is made from.
    arrays : mapping of str to ndarray
    facts : dict
        Plain data for the manifest: stage, level, units, counts.
    **more
        Plain data for the store alone.
    """
    store = manifest.with_suffix(".zarr")
    about = {"fingerprint": fingerprint, "facts": facts, "versions": versions(), **more}
    write_arrays(store, arrays, about)
    _write_manifest(manifest, open_arrays(store))


def _write_manifest(manifest: Path, bundle: ArrayBundle) -> None:
    held = bundle.attributes
    made = {name: held[name] for name in ("fingerprint", "versions")}
    write_manifest(manifest, {**held["facts"], **bundle.entry(), **made})
