"""Parts of an array, read by ranges of its files: what lies between them isn't fetched."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.chunks import DAMAGE, METADATA, damaged_metadata
from rfpipe.store.codec import blosc_of, unpack
from rfpipe.store.places import Place, Range, end_of_file, ranges_of_file
from rfpipe.store.shards import index_size, inner_layout, parse_index

__all__ = ["read_runs", "take_runs"]

Runs = NDArray[np.int64]

_CHECK_BYTES = 4  # of each chunk, behind it: its crc32c


@dataclass(frozen=True)
class _Layout:
    """How an array is cut along its last axis: items a chunk and a file, and the compressor."""

    leading: tuple[int, ...]
    dtype: np.dtype[Any]
    chunk: int
    file: int
    blosc: Any


def read_runs(array: Path | Place, runs: Runs) -> NDArray[Any] | None:
    """Read runs of an array along its last axis, one after the other.

    Each chunk is checked against its own checksum; the array's digest is of the whole.

    Parameters
    ----------
    array : Path or Place
        A zarr array.
    runs : ndarray of int64, shape (n, 2)
        Begin and end of each.

    Returns
    -------
    ndarray or None
        ``(..., items)``; None of an array that isn't cut along its last axis: that is read whole.

    Raises
    ------
    OSError, RuntimeError, ValueError, KeyError, TypeError
        When it is damaged.
    IntegrityError
        When its metadata are.
    StoreError
        When it can't be fetched.
    """
    layout = _layout(array)
    if layout is None:
        return None
    items = _items(runs)
    chunks = np.unique(items // layout.chunk)
    if not len(chunks):
        return np.empty((*layout.leading, 0), layout.dtype)
    held = np.concatenate(list(_chunks(array, layout, chunks)), axis=-1)
    place = np.searchsorted(chunks, items // layout.chunk) * layout.chunk + items % layout.chunk
    return np.ascontiguousarray(held[..., place])


def take_runs(array: NDArray[Any], runs: Runs) -> NDArray[Any]:
    """Return runs of an array in memory along its last axis, one after the other."""
    return np.ascontiguousarray(array[..., _items(runs)])


def _items(runs: Runs) -> NDArray[np.int64]:
    lengths = runs[:, 1] - runs[:, 0]
    first: NDArray[np.int64] = np.repeat(runs[:, 0] - np.cumsum(lengths) + lengths, lengths)
    return first + np.arange(lengths.sum())


def _layout(array: Path | Place) -> _Layout | None:
    try:
        metadata = json.loads(_one(array / METADATA, (0, None)))
        shape = tuple(metadata["shape"])
        file = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
        found = inner_layout(metadata["codecs"])
        if found is None:
            return None
        chunk, codecs = found
        names = [codec["name"] for codec in codecs]
        of_last = chunk[:-1] == file[:-1] == shape[:-1]
        if not of_last or names != ["bytes", "blosc", "crc32c"]:
            return None
        dtype = np.dtype(metadata["data_type"])
        return _Layout(shape[:-1], dtype, chunk[-1], file[-1], blosc_of(codecs[1]))
    except DAMAGE as error:
        raise damaged_metadata(array, error) from error


def _chunks(array: Path | Place, layout: _Layout, chunks: Runs) -> Any:
    """Yield some chunks of an array, by their numbers, each file's by requests of their own."""
    in_file = layout.file // layout.chunk
    zeros = ["0"] * len(layout.leading)
    for number in np.unique(chunks // in_file):
        file = array / ".".join(["c", *zeros, str(number)])
        end, size = end_of_file(file, index_size(in_file))
        starts, lengths = parse_index(end, in_file, size - len(end))
        own = chunks[chunks // in_file == number] % in_file
        ranges = [(int(starts[n]), int(starts[n] + lengths[n])) for n in own]
        for content in ranges_of_file(file, ranges):
            yield _unpacked(content, layout)


def _unpacked(content: bytes, layout: _Layout) -> NDArray[Any]:
    import google_crc32c

    packed, check = content[:-_CHECK_BYTES], content[-_CHECK_BYTES:]
    if int(google_crc32c.value(packed)).to_bytes(_CHECK_BYTES, "little") != check:
        raise ValueError("a chunk isn't what its checksum says")
    out = np.empty((*layout.leading, layout.chunk), layout.dtype)
    unpack(packed, layout.blosc, out)
    return out


def _one(file: Path | Place, wanted: Range) -> bytes:
    return ranges_of_file(file, [wanted])[0]
