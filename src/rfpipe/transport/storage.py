"""Transports in stores: written whole, found in what a user names, opened lazily."""

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
"""Under which an acquisition's transport is stored."""

ZIP_NAME = "transport.zip"
"""Under which `rfpipe keep` brings it into a bucket, as one object."""

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
    bundle = open_arrays(find_transport(path))
    transport = unpack_transport(bundle.without(NOISE), memory_budget)
    transport.lights = bundle.attributes.get("lights")
    transport.noise = bundle.read(NOISE) if NOISE in bundle.names else None
    return transport


def unpack_transport(bundle: ArrayBundle, memory_budget: int) -> Transport:
    """Build the transport that a store, or a part of one, keeps; StoreError if of no known kind."""
    kind = bundle.attributes.get("kind")
    if kind not in _CLASSES:
        raise StoreError(
            f"{bundle.path}: not a transport (kind {kind!r}, expected one of {sorted(_CLASSES)}); "
            "give the transport.zarr that an acquisition wrote"
        )
    number_format = bundle.attributes["number_format"]
    if number_format not in get_args(NumberFormat):
        raise StoreError(
            f"{bundle.path}: number format {number_format!r}, which this version of rfpipe doesn't "
            "know; open it with the version that wrote it, or run the stage that writes it again"
        )
    module, _, name = _CLASSES[kind].partition(":")
    cls: type[Transport] = getattr(import_module(f"rfpipe.transport.{module}"), name)
    return cls.unpack(bundle, memory_budget)


def transports_in(place: Path | Place) -> list[str]:
    """Return the names, relative to a folder, of the transports below it."""
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
    """Return where the one transport lies that `path` names or holds, or raise StoreError."""
    place = locate(path)
    if isinstance(place, Path) and not place.is_dir():
        what = "a file, no store" if place.exists() else "no such file or folder"
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
