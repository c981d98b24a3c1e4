"""Chunk files of an array: bytes in, bytes out, as the array's zarr metadata say.

zarr passes each chunk through an event loop and on to a thread, so that several threads that read
or write take as long as one. What a frame store needs is little: its chunks are files of one
layout.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.chunks import METADATA, damaged_metadata
from rfpipe.store.files import hidden_sibling, storage_errors

if TYPE_CHECKING:
    from numcodecs.blosc import Blosc

__all__ = ["ChunkFiles"]

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
            self._chunk = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
            if self._chunk[1:] != self.shape[1:] or self._chunk[0] < 1:
                raise ValueError(f"chunks of {self._chunk} in an array of {self.shape}")
            separator = metadata["chunk_key_encoding"]["configuration"]["separator"]
            if separator != ".":
                raise ValueError(f"chunks named with {separator!r}; expected '.'")
            to_bytes, *compressors = metadata["codecs"]
            if to_bytes["name"] != "bytes" or len(compressors) > 1:
                raise ValueError(f"codecs {metadata['codecs']}")
            self._blosc = _blosc(compressors[0]) if compressors else None
        except (ValueError, KeyError, TypeError) as error:
            raise damaged_metadata(path, error) from error
        self.items_per_chunk: int = self._chunk[0]

    def file(self, chunk: int) -> Path:
        """File of a chunk."""
        return self.path / ".".join(["c", str(chunk), *("0" for _ in self.shape[1:])])

    def read(self, chunk: int, out: NDArray[Any]) -> None:
        """Read the first items of a chunk into a contiguous array.

        Raises
        ------
        OSError, ValueError, RuntimeError
            When the file is missing or damaged.
        """
        content = self.file(chunk).read_bytes()
        whole = out if len(out) == self._chunk[0] else np.empty(self._chunk, self.dtype)
        if self._blosc is None:
            whole[...] = np.frombuffer(content, self.dtype).reshape(self._chunk)
        else:
            # the decompressor trusts the header
            sizes = np.frombuffer(content[:_HEADER_BYTES].ljust(_HEADER_BYTES, b"\0"), "<u4")
            if (sizes[1], sizes[3]) != (whole.nbytes, len(content)):
                raise ValueError(f"chunk {chunk}: sizes {sizes[1]} and {sizes[3]} in its header")
            self._blosc.decode(content, whole)
        if whole is not out:
            out[...] = whole[: len(out)]

    def write(self, chunk: int, block: NDArray[Any]) -> None:
        """Write the items of a chunk, whole or not at all; a short last one is filled up.

        Raises
        ------
        OSError
        """
        if len(block) < self._chunk[0]:
            whole = np.zeros(self._chunk, self.dtype)
            whole[: len(block)] = block
            block = whole
        content = block.tobytes() if self._blosc is None else self._blosc.encode(block)
        place = self.file(chunk)
        partial = hidden_sibling(place, f"{os.getpid()}.partial")
        try:
            partial.write_bytes(content)
            partial.replace(place)
        except OSError:
            partial.unlink(missing_ok=True)
            raise


def _blosc(codec: dict[str, Any]) -> Blosc:
    """Return the compressor that an array's metadata name."""
    import numcodecs.blosc

    # With threads of its own it orders its blocks by who is first.
    numcodecs.blosc.use_threads = False
    if codec["name"] != "blosc":
        raise ValueError(f"codec {codec['name']!r}; expected blosc")
    settings = dict(codec["configuration"])
    settings["shuffle"] = _SHUFFLES[settings["shuffle"]]
    return numcodecs.blosc.Blosc(**settings)
