"""Whole arrays, read from the disk or from where they lie.

Most arrays of a bundle are one chunk: unpacked as `codec` does it, they take a tenth of the time
that zarr takes for its event loop and its threads. Others are zarr's.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.chunks import DAMAGE, METADATA, damaged_metadata
from rfpipe.store.codec import blosc_of, unpack
from rfpipe.store.places import Place, array_keys

__all__ = ["read_whole"]

Read = Callable[[list[str]], dict[str, bytes]]


def read_whole(array: Path | Place, *, exactly: bool = False) -> NDArray[Any]:
    """Read a zarr array.

    Parameters
    ----------
    array : Path or Place
    exactly : bool
        Whether to fetch nothing of what lies behind it, which isn't wanted next.

    Raises
    ------
    OSError, RuntimeError, ValueError, KeyError, TypeError
        When it is damaged.
    IntegrityError
        When its metadata are.
    StoreError
        When it can't be fetched.
    """
    read = _reader(array, exactly)
    try:
        content = read([METADATA])[METADATA]
        metadata = json.loads(content)
        names = array_keys(metadata)
        empty = _empty(metadata)
    except DAMAGE as error:
        raise damaged_metadata(array, error) from error
    if empty is None:
        return _by_zarr(array, lambda: {METADATA: content, **read(names)})
    out, blosc = empty
    for name in names:
        unpack(read([name])[name], blosc, out)
    return out


def _reader(array: Path | Place, exactly: bool) -> Read:
    if isinstance(array, Path):
        return lambda names: {name: (array / name).read_bytes() for name in names}
    return array.read_exactly if exactly else array.read_many


def _empty(metadata: dict[str, Any]) -> tuple[NDArray[Any], Any] | None:
    """Return room for an array of one chunk, or of none, and its compressor; None for others.

    Raises
    ------
    ValueError, KeyError, TypeError
        When the metadata are damaged.
    """
    kind = (metadata["zarr_format"], metadata["node_type"], metadata["chunk_grid"]["name"])
    if kind != (3, "array", "regular"):
        raise ValueError(f"{kind} of zarr's format, node and grid")
    shape = tuple(metadata["shape"])
    chunk = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    to_bytes, *compressors = metadata["codecs"]
    one = all(length in (0, step) for length, step in zip(shape, chunk, strict=True))
    if not one or to_bytes["name"] != "bytes" or len(compressors) > 1:
        return None
    if to_bytes.get("configuration", {}).get("endian", "little") != "little":
        return None
    blosc = blosc_of(compressors[0]) if compressors else None
    return np.zeros(shape, np.dtype(metadata["data_type"])), blosc


def _by_zarr(array: Path | Place, fetch: Callable[[], dict[str, bytes]]) -> NDArray[Any]:
    import zarr
    from zarr.buffer.cpu import Buffer

    store: Any = array
    if not isinstance(array, Path):
        held: Any = {name: Buffer.from_bytes(data) for name, data in fetch().items()}
        store = zarr.storage.MemoryStore(held, read_only=True)
    try:
        opened: Any = zarr.open_array(store, mode="r")
    except DAMAGE as error:
        raise damaged_metadata(array, error) from error
    found: NDArray[Any] = np.asarray(opened[...], order="C")
    return found
