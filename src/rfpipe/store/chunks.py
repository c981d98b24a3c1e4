"""The layout of arrays in zarr v3, and their chunks: bytes in, bytes out.

zarr passes each chunk through an event loop and on to a thread, so that several threads that read
or write take as long as one, and a whole array of one chunk takes ten times as long as here. What
rfpipe writes is of one layout: an array is cut along one axis, each file is a chunk or a shard of
several.
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
"""What damaged bytes raise."""

_SHUFFLES = {"noshuffle": 0, "shuffle": 1, "bitshuffle": 2}
_BLOSC_HEADER = 16  # its bytes 4 to 8 are the size unpacked, 12 to 16 packed
_CHECK_BYTES = 4
_ABSENT = np.uint64(2**64 - 1)


def layout(
    compression: Literal["zstd", "lz4"] = "lz4",
    level: int = 1,
    shuffle: Literal["shuffle", "bitshuffle"] = "bitshuffle",
) -> Layout:
    """Return the keyword arguments, for zarr's ``create_array``, that all arrays share.

    lz4 packs radiance, whose low bits are noise, as tightly as zstd to 3 %, counts to a twelfth, in
    half the time.
    """
    from zarr.codecs import BloscCodec

    return {
        "compressors": BloscCodec(cname=compression, clevel=level, shuffle=shuffle),
        "fill_value": 0,
        # All chunks of an array in one folder: no folder a chunk.
        "chunk_key_encoding": {"name": "default", "separator": "."},
        # An all-black frame is a frame: zarr would leave out chunks that are all fill value.
        "config": {"write_empty_chunks": True},
    }


def small_layout(dtype: np.dtype[Any]) -> Layout:
    """Return the `layout` of arrays that are written once and kept: smaller, in thrice the time.

    Indices that mostly ascend pack four times as tightly by bytes as by bits, numbers don't.
    """
    is_index = dtype.kind in "iu" and dtype.itemsize >= 4
    return layout("zstd", level=5, shuffle="shuffle" if is_index else "bitshuffle")


def read_attributes(path: Path | Place, kind: str) -> dict[str, Any]:
    """Return the attributes of a store, whose attribute ``"kind"`` is to be `kind`."""
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
    """The files of an array that is cut along one axis; threads may share it.

    Parameters
    ----------
    path : Path or Place
        The array's folder.
    exactly : bool
        Whether to fetch nothing of what lies behind a file, which isn't wanted next.

    Attributes
    ----------
    shape, dtype
    axis : int
        Along which it is cut; its items are counted there.
    items_per_chunk, items_per_file : int
        Chunks are compressed, and read, as a whole; files are written as a whole. A file is a
        chunk, or a shard of several.
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
        """Return the path, or place, of the file in which an item lies."""
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
                some = slice(first, first + self.items_per_chunk) if count > 1 else ...
                self._unpack(content, array[(*[slice(None)] * self.axis, some)])
        return array

    def take(self, items: NDArray[np.int64]) -> NDArray[Any]:
        """Return items along the last axis, ``(..., items)``; errors as `read`.

        Of an array that is cut there, little else is read.
        """
        if self.axis != len(self.shape) - 1 or not self._checked:
            return np.ascontiguousarray(self.read()[..., items])
        number, within = np.divmod(items, self.items_per_chunk)
        chunks, place = np.unique(number, return_inverse=True)
        held = np.empty((*self.shape[:-1], len(chunks) * self.items_per_chunk), self.dtype)
        for index, content in enumerate(self._contents(chunks.tolist())):
            first = index * self.items_per_chunk
            self._unpack(content, held[..., first : first + self.items_per_chunk])
        return np.ascontiguousarray(held[..., place * self.items_per_chunk + within])

    def read_chunk(self, first: int, out: NDArray[Any]) -> None:
        """Read items of a chunk, from its `first` on, into a contiguous array; errors as `read`."""
        (content,) = self._contents([first // self.items_per_chunk])
        self._unpack(content, out)

    def packed(self, block: NDArray[Any]) -> bytes:
        """Return the bytes of a chunk; the items of a short last one are filled up."""
        fill = np.zeros((self._chunk[0] - len(block), *block.shape[1:]), self.dtype)
        block = np.concatenate([block, fill]) if len(fill) else np.ascontiguousarray(block)
        packed: bytes = block.tobytes() if self._blosc is None else self._blosc.encode(block)
        return packed

    def index(self, lengths: Sequence[int]) -> bytes:
        """Return the index of a shard of chunks of these lengths; nothing where there are none."""
        if not self._sharded:
            return b""
        index = np.full((self.items_per_file // self.items_per_chunk, 2), _ABSENT, "<u8")
        ends = np.cumsum(lengths, dtype=np.uint64)
        index[: len(lengths), 1] = lengths
        index[: len(lengths), 0] = ends - index[: len(lengths), 1]
        content = index.tobytes()
        return content + _crc32c(content)

    def _contents(self, numbers: Sequence[int]) -> Iterator[bytes]:
        """Yield the bytes of some chunks, by their numbers, each file's by few requests."""
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
        """Write the items of a chunk, or its first ones, into an array."""
        if self._checked:
            content, check = content[:-_CHECK_BYTES], content[-_CHECK_BYTES:]
            if _crc32c(content) != check:
                raise ValueError("a chunk isn't what its checksum says")
        is_whole = out.shape == self._chunk and out.flags.c_contiguous
        whole = out if is_whole else np.empty(self._chunk, self.dtype)
        if self._blosc is None:
            whole[...] = np.frombuffer(content, self.dtype).reshape(whole.shape)
        else:
            # the decompressor trusts the header
            sizes = np.frombuffer(content[:_BLOSC_HEADER].ljust(_BLOSC_HEADER, b"\0"), "<u4")
            if (sizes[1], sizes[3]) != (whole.nbytes, len(content)):
                raise ValueError(f"a chunk of {len(content)} bytes says {sizes[3]} and {sizes[1]}")
            self._blosc.decode(content, whole)
        if not is_whole:
            out[...] = whole[tuple(map(slice, out.shape))]


def _bounds(index: bytes, chunks: int) -> tuple[list[int], list[int]]:
    """Return where the chunks of a shard begin and end, by its index."""
    entries, check = index[:-_CHECK_BYTES], index[-_CHECK_BYTES:]
    if len(entries) != 16 * chunks or _crc32c(entries) != check:
        raise ValueError("the index of a shard is damaged")
    starts, lengths = np.frombuffer(entries, "<u8").reshape(chunks, 2).T
    return starts.tolist(), (starts + lengths).tolist()


def _crc32c(content: bytes) -> bytes:
    import google_crc32c

    return int(google_crc32c.value(content)).to_bytes(_CHECK_BYTES, "little")


def _blosc(settings: dict[str, Any]) -> Any:
    """Return the compressor that an array's metadata name."""
    import numcodecs.blosc

    # With threads of its own it orders its blocks by who is first.
    numcodecs.blosc.use_threads = False
    return numcodecs.blosc.Blosc(**{**settings, "shuffle": _SHUFFLES[settings["shuffle"]]})
