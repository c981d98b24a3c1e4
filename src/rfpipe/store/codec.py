"""Chunk files of an array: bytes in, bytes out, as the array's zarr metadata say.

zarr passes each chunk through an event loop and on to a thread, so that several threads that read
or write take as long as one. What a frame store needs is little: its chunks are files of one
layout, or lie one after the other in shards of one layout.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.chunks import METADATA, damaged_metadata
from rfpipe.store.files import hidden_sibling, storage_errors
from rfpipe.store.shards import index_bytes, inner_layout, read_index

if TYPE_CHECKING:
    from numcodecs.blosc import Blosc

__all__ = ["ChunkFiles", "blosc_of", "unpack"]

_SHUFFLES = {"noshuffle": 0, "shuffle": 1, "bitshuffle": 2}
_HEADER_BYTES = 16  # of blosc: its bytes 4 to 8 are the size unpacked, 12 to 16 packed


class ChunkFiles:
    """The files of an array that is cut along its first axis alone.

    Parameters
    ----------
    path
        The array's folder.

    Attributes
    ----------
    path : Path
    shape : tuple of int
    dtype : numpy.dtype
    items_per_chunk : int
        Chunks are compressed, and read, as a whole.
    items_per_file : int
        As many, unless files are shards of several chunks. Files are written as a whole.

    Raises
    ------
    IntegrityError
        When the metadata are damaged, or of another layout.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with storage_errors(path / METADATA, "reading"):
            content = (path / METADATA).read_bytes()
        try:
            metadata = json.loads(content)
            self.shape: tuple[int, ...] = tuple(metadata["shape"])
            self.dtype = np.dtype(metadata["data_type"])
            file = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
            inner = inner_layout(metadata["codecs"])
            self._sharded = inner is not None
            self._chunk: tuple[int, ...]
            self._chunk, codecs = inner or (file, metadata["codecs"])
            for part in (file, self._chunk):
                if part[1:] != self.shape[1:] or part[0] < 1:
                    raise ValueError(f"chunks of {part} in an array of {self.shape}")
            if file[0] % self._chunk[0]:
                raise ValueError(f"chunks of {self._chunk} in shards of {file}")
            separator = metadata["chunk_key_encoding"]["configuration"]["separator"]
            if separator != ".":
                raise ValueError(f"chunks named with {separator!r}; expected '.'")
            to_bytes, *compressors = codecs
            if to_bytes["name"] != "bytes" or len(compressors) > 1:
                raise ValueError(f"codecs {codecs}")
            self._blosc = blosc_of(compressors[0]) if compressors else None
        except (ValueError, KeyError, TypeError) as error:
            raise damaged_metadata(path, error) from error
        self.items_per_chunk: int = self._chunk[0]
        self.items_per_file: int = file[0]

    def file(self, item: int) -> Path:
        """File in which an item lies."""
        number = item // self.items_per_file
        return self.path / ".".join(["c", str(number), *("0" for _ in self.shape[1:])])

    def read(self, first: int, out: NDArray[Any]) -> None:
        """Read items of a chunk, from its `first` on, into a contiguous array.

        Raises
        ------
        OSError, ValueError, RuntimeError
            When the file is missing or damaged.
        """
        content = self._content(first)
        whole = out if len(out) == self._chunk[0] else np.empty(self._chunk, self.dtype)
        unpack(content, self._blosc, whole)
        if whole is not out:
            out[...] = whole[: len(out)]

    def write(self, first: int, block: NDArray[Any]) -> None:
        """Write the items of a file, whole or not at all; a short last chunk is filled up.

        Raises
        ------
        OSError
        """
        with self.writing(first) as add:
            for start in range(0, len(block), self.items_per_chunk):
                add(block[start : start + self.items_per_chunk])

    @contextmanager
    def writing(self, first: int) -> Iterator[Callable[[NDArray[Any]], None]]:
        """Write a file chunk by chunk; it is there once all of them are, or not at all.

        Parameters
        ----------
        first
            The first item of the file.

        Yields
        ------
        callable
            Takes the items of the next chunk.

        Raises
        ------
        OSError
        ValueError
            When there were more or fewer chunks than the file has.
        """
        place = self.file(first)
        partial = hidden_sibling(place, f"{os.getpid()}.partial")
        lengths: list[int] = []
        items = min(self.items_per_file, self.shape[0] - first)
        try:
            with partial.open("wb") as file:

                def add(block: NDArray[Any]) -> None:
                    lengths.append(file.write(self._packed(block)))

                yield add
                if len(lengths) != -(-items // self.items_per_chunk):
                    raise ValueError(f"{place}: {len(lengths)} chunks for {items} items")
                if self._sharded:
                    file.write(index_bytes(lengths, self.items_per_file // self.items_per_chunk))
            partial.replace(place)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise

    def _packed(self, block: NDArray[Any]) -> bytes:
        if len(block) < self._chunk[0]:
            whole = np.zeros(self._chunk, self.dtype)
            whole[: len(block)] = block
            block = whole
        return block.tobytes() if self._blosc is None else bytes(self._blosc.encode(block))

    def _content(self, first: int) -> bytes:
        """Return the bytes of the chunk that begins with an item."""
        if not self._sharded:
            return self.file(first).read_bytes()
        with self.file(first).open("rb", buffering=0) as file:
            starts, lengths = read_index(file, self.items_per_file // self.items_per_chunk)
            chunk = first % self.items_per_file // self.items_per_chunk
            return os.pread(file.fileno(), int(lengths[chunk]), int(starts[chunk]))


def unpack(content: bytes, blosc: Blosc | None, out: NDArray[Any]) -> None:
    """Unpack a chunk into a contiguous array.

    Raises
    ------
    ValueError, RuntimeError
        When it is damaged.
    """
    if blosc is None:
        out[...] = np.frombuffer(content, out.dtype).reshape(out.shape)
        return
    # the decompressor trusts the header
    sizes = np.frombuffer(content[:_HEADER_BYTES].ljust(_HEADER_BYTES, b"\0"), "<u4")
    if (sizes[1], sizes[3]) != (out.nbytes, len(content)):
        raise ValueError(f"a chunk of {len(content)} bytes says {sizes[3]}, of them {sizes[1]}")
    blosc.decode(content, out)


def blosc_of(codec: dict[str, Any]) -> Blosc:
    """Return the compressor that an array's metadata name.

    Raises
    ------
    ValueError, KeyError
        When it is another one.
    """
    import numcodecs.blosc

    # With threads of its own it orders its blocks by who is first.
    numcodecs.blosc.use_threads = False
    if codec["name"] != "blosc":
        raise ValueError(f"codec {codec['name']!r}; expected blosc")
    settings = dict(codec["configuration"])
    if settings["cname"] not in numcodecs.blosc.list_compressors():
        raise ValueError(f"compressor {settings['cname']!r}")
    settings["shuffle"] = _SHUFFLES[settings["shuffle"]]
    return numcodecs.blosc.Blosc(**settings)
