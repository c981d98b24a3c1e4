"""Results of a stage: a store and, written last, the manifest that says that it is complete.

Snakemake removes a manifest before its stage runs again, often only because a file upstream is
newer. The store stays. It knows the fingerprint of all that it was made from, so that a stage can
tell that nothing has changed, and write its manifest again instead of doing its work again.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.provenance import versions
from rfpipe.store import ArrayBundle, open_arrays, write_arrays, write_manifest

__all__ = ["accept_bundle", "bundle_entry", "intact_bundle", "write_bundle"]

_log = logging.getLogger(__name__)


def accept_bundle(store: Path, manifest: Path, fingerprint: str) -> bool:
    """Write the manifest of a bundle that was made from the same things, if there is one.

    Parameters
    ----------
    store, manifest : Path
        As for `write_bundle`.
    fingerprint : str
        Of all that the stage would make it from.

    Returns
    -------
    bool
        Whether there was one, undamaged; else the stage has to make it.
    """
    bundle = intact_bundle(store, fingerprint)
    if bundle is None:
        return False
    write_manifest(manifest, _manifest(bundle))
    _log.info("%s: made from the same things before; kept", store)
    return True


def intact_bundle(store: Path, fingerprint: str | None) -> ArrayBundle | None:
    """Return a bundle that was made from the same things, if there is one and it is undamaged.

    `fingerprint` is None where it may be made from anything.
    """
    try:
        bundle = open_arrays(store)
        if fingerprint not in (None, bundle.attributes.get("fingerprint")):
            return None
        for name in bundle.names:
            bundle.read(name)
    except IntegrityError as error:
        _log.warning("made anew, since it is damaged: %s", error)
        return None
    except StoreError:
        return None
    return bundle


def write_bundle(
    store: Path,
    manifest: Path,
    fingerprint: str,
    arrays: Mapping[str, NDArray[Any]],
    facts: dict[str, Any],
    **more: Any,
) -> None:
    """Write a bundle of arrays and its manifest.

    Parameters
    ----------
    store, manifest : Path
    fingerprint : str
        Of all that it is made from.
    arrays : mapping of str to ndarray
    facts : dict
        Plain data for the manifest: stage, level, units, counts.
    **more
        Plain data for the store alone.
    """
    write_arrays(
        store,
        arrays,
        {"fingerprint": fingerprint, "facts": facts, "versions": versions(), **more},
    )
    write_manifest(manifest, _manifest(open_arrays(store)))


def bundle_entry(bundle: ArrayBundle) -> dict[str, Any]:
    """Describe a bundle for a manifest: its digest, and dtype and shape of its arrays."""
    return {
        "digest": bundle.digest,
        "arrays": {
            name: {"dtype": bundle.dtype(name).str, "shape": list(bundle.shape(name))}
            for name in bundle.names
        },
    }


def _manifest(bundle: ArrayBundle) -> dict[str, Any]:
    held = bundle.attributes
    return {
        **held["facts"],
        **bundle_entry(bundle),
        "fingerprint": held["fingerprint"],
        "versions": held["versions"],
    }
