"""Stores of transports: search in folders, zip files and addresses, and lazy opening."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import get_args

from rfpipe.errors import StoreError
from rfpipe.store.arrays import ArrayBundle, open_arrays
from rfpipe.store.location import locate
from rfpipe.store.places import CHECKSUMS, METADATA, Place, content_of
from rfpipe.transport.algebra import MEMORY_BUDGET
from rfpipe.transport.base import NOISE, Transport
from rfpipe.units import NumberFormat

STORE_NAME = "transport.zarr"
"""Name of an acquisition's transport."""

ZIP_NAME = "transport.zip"
"""Name of a transport as one object, to which `rfpipe keep` writes it in a bucket."""

_CLASSES = {
    "dense": "dense:DenseTransport",
    "footprints": "footprints:FootprintTransport",
    "hierarchical": "hierarchical.transport:HierarchicalTransport",
    "low_rank": "low_rank:LowRankTransport",
    "multiscale": "multiscale:MultiscaleTransport",
    "multilevel": "multilevel:MultilevelTransport",
    "sum": "sum:SumTransport",
    "wavelet": "wavelet:WaveletTransport",
}


def open_transport(path: str | Path | Place, memory_budget: int = MEMORY_BUDGET) -> Transport:
    """Open a stored transport; its arrays are read when first used.

    Parameters
    ----------
    path : path or address
        The ``transport.zarr`` that an acquisition wrote; or a folder or zip file that holds one,
        as ``rfpipe publish`` writes them. If it holds several, name one:
        ``crate.zip/results/desk/symmetric/transport.zarr``, or, in a folder of ``rfpipe collection
        pack``, ``packed/jug/near_far/transport.zarr``. On a server, only the ranges that are used
        are read: ``https://host/crate.zip``,
        ``s3://bucket/run/results/desk/symmetric/transport.zarr``. Addresses need the extra
        ``publish``; S3 takes credentials, region and endpoint from the usual environment variables
        (``AWS_...``), and requests are unsigned without credentials.
    memory_budget : int
        Bytes. A transport with larger arrays is read at each use, part by part, with the same
        results. A dense transport always stays in memory.

    Raises
    ------
    StoreError
        If there is no transport at `path`, or more than one, if it was written by a later version
        of rfpipe, or if a server doesn't answer.
    InputError
        If the address has another scheme.
    IntegrityError
        If an array does not match its digest.
    """
    bundle = open_arrays(find_transport(path))
    transport = unpack_transport(bundle.without(NOISE), memory_budget)
    transport.lights = bundle.attributes.get("lights")
    transport.noise = bundle.read(NOISE) if NOISE in bundle.names else None
    return transport


def unpack_transport(bundle: ArrayBundle, memory_budget: int) -> Transport:
    """Build a transport from a store, or a part of one; StoreError if its kind is unknown."""
    kind = bundle.attributes.get("kind")
    if kind not in _CLASSES:
        raise StoreError(
            f"{bundle.path}: not a transport (kind {kind!r}, expected one of {sorted(_CLASSES)}); "
            "give the transport.zarr that an acquisition wrote"
        )
    number_format = bundle.attributes["number_format"]
    if number_format not in get_args(NumberFormat):
        raise StoreError(
            f"{bundle.path}: number format {number_format!r} is unknown to this version of "
            "rfpipe; open it with the version that wrote it, or run the stage that writes it again"
        )
    module, _, name = _CLASSES[kind].partition(":")
    cls: type[Transport] = getattr(import_module(f"rfpipe.transport.{module}"), name)
    return cls.unpack(bundle, memory_budget)


def transports_in(place: Path | Place) -> list[str]:
    """Return the names of the transports below a folder, relative to it."""
    if isinstance(place, Path):
        stores = (store for store in place.rglob(STORE_NAME) if store.is_dir())
        return sorted(store.relative_to(place).as_posix() for store in stores)
    listed = content_of(place / CHECKSUMS)
    if listed is None:
        files = place.files()
    else:
        files = [line[66:] for line in listed.decode(errors="replace").splitlines()]
    ends = (f"/{STORE_NAME}/{METADATA}", f"/{ZIP_NAME}")
    return sorted(name.removesuffix(f"/{METADATA}") for name in files if f"/{name}".endswith(ends))


def find_transport(path: str | Path | Place) -> Path | Place:
    """Locate the transport at `path`, or the only one below it; StoreError otherwise."""
    place = locate(path)
    if isinstance(place, Path) and not place.is_dir():
        what = "a file, not a store" if place.exists() else "no such file or folder"
        raise StoreError(
            f"{place}: {what}; give the {STORE_NAME} that an acquisition wrote, or a folder, zip "
            "file or address that has one. A matrix in a file is read by rfpipe.read_matrix"
        )
    if str(place).endswith(".zarr") or content_of(place / METADATA) is not None:
        return place
    names = transports_in(place)
    if len(names) == 1:
        entry = place / names[0]
        return find_transport(entry) if names[0].endswith(ZIP_NAME) else entry
    if not names:
        raise StoreError(
            f"{place}: no {STORE_NAME} in here; give the {STORE_NAME} that an acquisition wrote, "
            "or a folder, zip file or address that has one"
        )
    listed = "\n".join(f"  {place}/{name}" for name in names)
    raise StoreError(f"{place}: has {len(names)} transports; name one of\n{listed}")
