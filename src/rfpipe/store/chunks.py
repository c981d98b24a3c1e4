"""Layout of arrays in zarr v3, and fast reading and writing of their chunks.

zarr passes each chunk through an event loop to a thread, so several threads are as slow as one, and
an array of a single chunk takes ten times as long as with this module. All arrays of rfpipe have
the same layout: they are cut along one axis, and each file is a chunk or a shard of several chunks.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.store.files import storage_errors
from rfpipe.store.places import METADATA, Place, content_of, read_ranges

Layout = dict[str, Any]

DAMAGE = (OSError, RuntimeError, ValueError, KeyError, TypeError)
"""Exceptions that damaged bytes raise."""

_SHUFFLES = {"noshuffle": 0, "shuffle": 1, "bitshuffle": 2}
_BLOSC_HEADER = 16  # bytes 4 to 8 are the size before compression, 12 to 16 after it
_CHECK_BYTES = 4
_ABSENT = np.uint64(2**64 - 1)


def layout(
    compression: Literal["zstd", "lz4"] = "lz4",
    level: int = 1,
    shuffle: Literal["shuffle", "bitshuffle"] = "bitshuffle",
) -> Layout:
    """Return the keyword arguments for zarr's ``create_array`` that all arrays share.

    lz4 needs half the time of zstd. Its files are 3 % larger for radiance, whose low bits are
    noise, and 8 % for counts.
    """
    from zarr.codecs import BloscCodec

    return {
        "compressors": BloscCodec(cname=compression, clevel=level, shuffle=shuffle),
        "fill_value": 0,
        # all chunks of an array in one folder, instead of a folder for each
        "chunk_key_encoding": {"name": "default", "separator": "."},
        # zarr would omit chunks of black frames, since black is the fill value
        "config": {"write_empty_chunks": True},
    }


def small_layout(dtype: np.dtype[Any]) -> Layout:
    """Return a `layout` for permanent arrays: smaller files, in three times the time.

    Mostly ascending indices become four times smaller with a shuffle of bytes than with one of
    bits; other numbers don't.
    """
    is_index = dtype.kind in "iu" and dtype.itemsize >= 4
    return layout("zstd", level=5, shuffle="shuffle" if is_index else "bitshuffle")


def read_attributes(path: Path | Place, kind: str) -> dict[str, Any]:
    """Return the attributes of a store.

    Raises
    ------
    StoreError
        When there is no store, or its attribute ``"kind"`` isn't `kind`.
    IntegrityError
        When its metadata are damaged.
    """
    with storage_errors(path, "reading"):
        content = content_of(path / METADATA)
    if content is None:
        remedy = "run the stage that writes it" if isinstance(path, Path) else "check the address"
        raise StoreError(f"there is no store of {kind}", place=path, remedy=remedy)
    try:
        attributes = json.loads(content)["attributes"]
        stored = attributes["kind"]
    except (ValueError, KeyError, TypeError) as error:
        raise damaged_metadata(path, error) from error
    if stored != kind:
        raise StoreError(f"store of another kind than {kind!r}", value=stored, place=path)
    return dict(attributes)


def damaged_metadata(path: Path | Place, error: Exception) -> IntegrityError:
    """Build the error for a store whose metadata can't be read."""
    remedy = (
        f"restore this file, or remove {path} and run the stage that writes it again"
        if isinstance(path, Path)
        else "check that the address leads to this file, not to a web page, and fetch it again"
    )
    return IntegrityError(
        f"damaged metadata: {type(error).__name__}: {error}", place=path / METADATA, remedy=remedy
    )


class ChunkedArray:
    """Files of an array that is cut along one axis; safe for use by several threads.

    Parameters
    ----------
    path : Path or Place
        Folder of the array.
    exactly : bool
        Disable read-ahead, for single files of a remote place.

    Attributes
    ----------
    shape : tuple of int
    dtype : numpy.dtype
    axis : int
        Axis along which the array is cut into items.
    items_per_chunk, items_per_file : int
        Items per chunk, the unit of compression and reading, and per file, the unit of writing. A
        file is a chunk or a shard of several chunks.
    """

    def __init__(self, path: Path | Place, *, exactly: bool = False) -> None:
        self.path, self._exactly = path, exactly
        try:
            metadata = json.loads(self._content(path / METADATA))
            self.shape: tuple[int, ...] = tuple(metadata["shape"])
            self.dtype = np.dtype(metadata["data_type"])
            file = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
            codecs, self._chunk = metadata["codecs"], file
            self._sharded = codecs[0]["name"] == "sharding_indexed"
            if self._sharded:
                settings = codecs[0]["configuration"]
                self._chunk, codecs = tuple(settings["chunk_shape"]), settings["codecs"]
            extents = zip(self.shape, self._chunk, file, strict=True)
            cut = [n for n, (all_, *parts) in enumerate(extents) if parts != [max(1, all_)] * 2]
            self.axis = cut[0] if cut else 0
            self.items_per_chunk: int = self._chunk[self.axis] if file else 1
            self.items_per_file: int = file[self.axis] if file else 1
            settings = {codec["name"]: codec.get("configuration") for codec in codecs}
            if len(cut) > 1 or settings.keys() - {"bytes", "blosc", "crc32c"}:
                raise ValueError(f"chunks of {self._chunk} in files of {file}, {codecs}")
            self._checked = "crc32c" in settings
            self._blosc = _blosc(settings["blosc"]) if "blosc" in settings else None
        except (ValueError, KeyError, TypeError, IndexError, FileNotFoundError) as error:
            raise damaged_metadata(path, error) from error

    def file(self, item: int) -> Any:
        """Return the path or place of the file that contains an item."""
        index = [0] * len(self.shape)
        if index:
            index[self.axis] = item // self.items_per_file
        return self.path / ".".join(["c", *map(str, index)])

    def read(self) -> NDArray[Any]:
        """Return the whole array, or raise one of `DAMAGE`, or StoreError."""
        array = np.zeros(self.shape, self.dtype)
        if array.size:
            count = -(-self.shape[self.axis] // self.items_per_chunk) if self.shape else 1
            for number, content in enumerate(self._contents(range(count))):
                first = number * self.items_per_chunk
                items = slice(first, first + self.items_per_chunk) if count > 1 else ...
                self._unpack(content, array[(*[slice(None)] * self.axis, items)])
        return array

    def take(self, items: NDArray[np.int64]) -> NDArray[Any]:
        """Return items along the last axis, ``(..., items)``; raises as `read`.

        If the array is cut along this axis, only the chunks with these items are read.
        """
        if self.axis != len(self.shape) - 1 or not self._checked:
            return np.ascontiguousarray(self.read()[..., items])
        number, within = np.divmod(items, self.items_per_chunk)
        chunks, place = np.unique(number, return_inverse=True)
        chunk_items = np.empty((*self.shape[:-1], len(chunks) * self.items_per_chunk), self.dtype)
        for index, content in enumerate(self._contents(chunks.tolist())):
            first = index * self.items_per_chunk
            self._unpack(content, chunk_items[..., first : first + self.items_per_chunk])
        return np.ascontiguousarray(chunk_items[..., place * self.items_per_chunk + within])

    def read_chunk(self, first: int, out: NDArray[Any]) -> None:
        """Read the chunk beginning with item `first` into a contiguous array; raises as `read`."""
        (content,) = self._contents([first // self.items_per_chunk])
        self._unpack(content, out)

    def packed(self, block: NDArray[Any]) -> bytes:
        """Return the bytes of a chunk, padded with zeros if it has too few items."""
        fill = np.zeros((self._chunk[0] - len(block), *block.shape[1:]), self.dtype)
        block = np.concatenate([block, fill]) if len(fill) else np.ascontiguousarray(block)
        packed: bytes = block.tobytes() if self._blosc is None else self._blosc.encode(block)
        return packed

    def index(self, lengths: Sequence[int]) -> bytes:
        """Return the index of a shard, from the lengths of its chunks; empty for other files."""
        if not self._sharded:
            return b""
        index = np.full((self.items_per_file // self.items_per_chunk, 2), _ABSENT, "<u8")
        ends = np.cumsum(lengths, dtype=np.uint64)
        index[: len(lengths), 1] = lengths
        index[: len(lengths), 0] = ends - index[: len(lengths), 1]
        content = index.tobytes()
        return content + _crc32c(content)

    def _contents(self, numbers: Sequence[int]) -> Iterator[bytes]:
        """Yield the bytes of chunks by their numbers, with few requests per file."""
        in_file = self.items_per_file // self.items_per_chunk
        for number, chunks in groupby(numbers, lambda number: number // in_file):
            file = self.file(number * self.items_per_file)
            if not self._sharded:
                yield self._content(file)
                continue
            size = 16 * in_file + _CHECK_BYTES
            starts, ends = _bounds(read_ranges(file, [(-size, None)])[0], in_file)
            yield from read_ranges(file, [(starts[n % in_file], ends[n % in_file]) for n in chunks])

    def _content(self, file: Path | Place) -> bytes:
        return read_ranges(file, [(0, None)])[0] if self._exactly else file.read_bytes()

    def _unpack(self, content: bytes, out: NDArray[Any]) -> None:
        """Unpack a chunk, or its first items, into an array."""
        if self._checked:
            content, check = content[:-_CHECK_BYTES], content[-_CHECK_BYTES:]
            if _crc32c(content) != check:
                raise ValueError("a chunk doesn't match its checksum")
        fits = out.shape == self._chunk and out.flags.c_contiguous
        chunk = out if fits else np.empty(self._chunk, self.dtype)
        if self._blosc is None:
            chunk[...] = np.frombuffer(content, self.dtype).reshape(chunk.shape)
        else:
            # the decompressor trusts the sizes in the header
            sizes = np.frombuffer(content[:_BLOSC_HEADER].ljust(_BLOSC_HEADER, b"\0"), "<u4")
            if (sizes[1], sizes[3]) != (chunk.nbytes, len(content)):
                raise ValueError(
                    f"the header of a chunk of {len(content)} bytes states {sizes[3]} bytes, "
                    f"{sizes[1]} decompressed"
                )
            self._blosc.decode(content, chunk)
        if not fits:
            out[...] = chunk[tuple(map(slice, out.shape))]


def _bounds(index: bytes, chunks: int) -> tuple[list[int], list[int]]:
    """Return the first and the last-plus-one byte of each chunk from the index of a shard."""
    entries, check = index[:-_CHECK_BYTES], index[-_CHECK_BYTES:]
    if len(entries) != 16 * chunks or _crc32c(entries) != check:
        raise ValueError("the index of a shard is damaged")
    starts, lengths = np.frombuffer(entries, "<u8").reshape(chunks, 2).T
    return starts.tolist(), (starts + lengths).tolist()


def _crc32c(content: bytes) -> bytes:
    import google_crc32c

    return int(google_crc32c.value(content)).to_bytes(_CHECK_BYTES, "little")


def _blosc(settings: dict[str, Any]) -> Any:
    """Return the compressor for the settings in an array's metadata."""
    import numcodecs.blosc

    # with several threads, the order of its blocks would depend on their speed
    numcodecs.blosc.use_threads = False
    return numcodecs.blosc.Blosc(**{**settings, "shuffle": _SHUFFLES[settings["shuffle"]]})
