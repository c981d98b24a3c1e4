"""Transports in stores: written whole, opened lazily."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from rfpipe.errors import StoreError
from rfpipe.transport.base import LazyArrays, Transport

_CLASSES = {
    "dense": ("rfpipe.transport.dense", "DenseTransport"),
    "hierarchical": ("rfpipe.transport.hierarchical", "HierarchicalTransport"),
    "multilevel": ("rfpipe.transport.multilevel", "MultilevelTransport"),
}


def save_transport(transport: Transport, path: str | Path, **attributes: Any) -> str:
    """Write a transport into a chunked, compressed store, complete or not at all.

    Parameters
    ----------
    transport : Transport
    path : path
        The store's folder; an older store there is replaced.
    **attributes
        Plain data to keep beside the transport's own (scene, method, fingerprints).

    Returns
    -------
    str
        Digest of the contents.
    """
    from rfpipe.store.arrays import write_arrays

    arrays, own = transport.pack()
    return write_arrays(Path(path), arrays, {**attributes, **own})


def open_transport(path: str | Path) -> Transport:
    """Open a stored transport; its arrays are read when first used.

    Raises
    ------
    StoreError
        If there is no transport at `path`.
    IntegrityError
        When an array that is read does not match its digest.
    """
    from rfpipe.store.arrays import open_arrays

    bundle = open_arrays(Path(path))
    kind = bundle.attributes.get("kind")
    if kind not in _CLASSES:
        raise StoreError(
            f"{path}: not a transport (kind {kind!r}, expected one of {sorted(_CLASSES)}); "
            "give the transport.zarr that an acquisition wrote"
        )
    module, name = _CLASSES[kind]
    cls = getattr(importlib.import_module(module), name)
    transport: Transport = cls.unpack(
        LazyArrays(list(bundle.names), bundle.read), bundle.attributes, bundle.nbytes_stored
    )
    return transport
