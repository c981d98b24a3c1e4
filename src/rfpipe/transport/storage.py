"""Transports in stores: written whole, opened lazily."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, get_args

from rfpipe.errors import StoreError
from rfpipe.store.arrays import ArrayBundle, open_arrays
from rfpipe.store.places import Place
from rfpipe.transport.algebra import MEMORY_BUDGET
from rfpipe.transport.base import Transport
from rfpipe.transport.places import find_transport
from rfpipe.units import NumberFormat

_CLASSES = {
    "dense": ("rfpipe.transport.dense", "DenseTransport"),
    "footprints": ("rfpipe.transport.footprints.transport", "FootprintTransport"),
    "hierarchical": ("rfpipe.transport.hierarchical.transport", "HierarchicalTransport"),
    "low_rank": ("rfpipe.transport.low_rank", "LowRankTransport"),
    "multiscale": ("rfpipe.transport.multiscale.transport", "MultiscaleTransport"),
    "multilevel": ("rfpipe.transport.multilevel.transport", "MultilevelTransport"),
    "sum": ("rfpipe.transport.sum", "SumTransport"),
    "wavelet": ("rfpipe.transport.wavelet.transport", "WaveletTransport"),
}

_FORMATS = get_args(NumberFormat)


def save_transport(
    transport: Transport,
    path: str | Path,
    number_format: NumberFormat = "float32",
    **attributes: Any,
) -> str:
    """Write a transport into a chunked, compressed store, complete or not at all.

    Parameters
    ----------
    transport : Transport
    path : path
        The store's folder; an older store there is replaced.
    number_format : {"float32", "uint16", "uint8"}
        "float32" keeps every bit. The others round, factors of leaves by about 1e-5 and 3e-3 of
        their values; "uint8" is the smallest, and the default of runs
        (``storage.number_format``). The transport in memory is not changed.
    **attributes
        Plain data to keep beside the transport's own (scene, method, fingerprints).

    Returns
    -------
    str
        Digest of the contents.

    Raises
    ------
    InputError
        If the number format is none of the three.
    """
    return transport.store(path, number_format, **attributes)


def open_transport(path: str | Path | Place, memory_budget: int = MEMORY_BUDGET) -> Transport:
    """Open a stored transport; its arrays are read when first used.

    Parameters
    ----------
    path : path or address
        The ``transport.zarr`` that an acquisition wrote; or a folder or zip file that holds one,
        such as what ``rfpipe publish`` makes; of several, name one:
        ``crate.zip/results/desk/symmetric/transport.zarr``; or one in what ``rfpipe collection
        pack`` made, ``packed/jug/near_far/transport.zarr``. Each may lie on a server and is then
        read from there by ranges, no more of it than is used: ``https://host/crate.zip``,
        ``s3://bucket/run/results/desk/symmetric/transport.zarr``. That needs the extra
        ``publish``; S3 takes credentials, region and endpoint from the usual variables of
        the environment (``AWS_...``), and goes unsigned without credentials.
    memory_budget : int
        Bytes. A transport whose arrays are larger is read anew, part by part, each time that it
        is used; the results are the same. A dense one always stays in memory.

    Raises
    ------
    StoreError
        If there is no transport at `path`, or more than one, if a later version of rfpipe has
        written it, or if a server doesn't answer.
    InputError
        If the address is of another kind.
    IntegrityError
        When an array that is read does not match its digest.
    """
    return unpack_transport(open_arrays(find_transport(path)), memory_budget)


def unpack_transport(bundle: ArrayBundle, memory_budget: int) -> Transport:
    """Build the transport of which a store, or a part of one, keeps arrays and attributes.

    Raises
    ------
    StoreError
        If it is of no kind, or in no number format, that this version knows.
    """
    kind = bundle.attributes.get("kind")
    if kind not in _CLASSES:
        raise StoreError(
            f"{bundle.path}: not a transport (kind {kind!r}, expected one of {sorted(_CLASSES)}); "
            "give the transport.zarr that an acquisition wrote"
        )
    # the first stores didn't name their format
    number_format = bundle.attributes.get("number_format", "float32")
    if number_format not in _FORMATS:
        raise StoreError(
            f"{bundle.path}: number format {number_format!r}, which this version of rfpipe doesn't "
            "know; open it with the version that wrote it, or run the stage that writes it again"
        )
    module, name = _CLASSES[kind]
    cls = getattr(importlib.import_module(module), name)
    transport: Transport = cls.unpack(bundle, memory_budget)
    return transport
