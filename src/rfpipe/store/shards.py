"""Shards of zarr v3: files of several chunks, which an index at their end tells apart."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

__all__ = ["index_bytes", "index_size", "inner_layout", "parse_index", "read_index"]

_ABSENT = np.uint64(2**64 - 1)
_CHECK_BYTES = 4
_INDEX_CODECS = ("bytes", "crc32c")

Index = tuple[NDArray[np.uint64], NDArray[np.uint64]]


def inner_layout(
    codecs: Sequence[dict[str, Any]],
) -> tuple[tuple[int, ...], list[dict[str, Any]]] | None:
    """Return shape and codecs of the chunks in a shard; None of an array without shards.

    Raises
    ------
    ValueError, KeyError, TypeError
        When its index isn't as zarr makes it unless told otherwise.
    """
    if codecs[0]["name"] != "sharding_indexed":
        return None
    settings = codecs[0]["configuration"]
    index = tuple(codec["name"] for codec in settings["index_codecs"])
    if len(codecs) > 1 or index != _INDEX_CODECS or settings["index_location"] != "end":
        raise ValueError(f"shards with an index of {index} at {settings['index_location']!r}")
    return tuple(settings["chunk_shape"]), settings["codecs"]


def index_bytes(lengths: Sequence[int], chunks: int) -> bytes:
    """Return the index of a shard whose first chunks lie one after the other.

    Parameters
    ----------
    lengths
        Bytes of each chunk that there is.
    chunks
        Chunks that a shard has; at the array's end the last ones are absent.
    """
    import google_crc32c

    index = np.full((chunks, 2), _ABSENT, "<u8")
    ends = np.cumsum(lengths, dtype=np.uint64)
    index[: len(lengths), 1] = lengths
    index[: len(lengths), 0] = ends - index[: len(lengths), 1]
    content = index.tobytes()
    return content + int(google_crc32c.value(content)).to_bytes(_CHECK_BYTES, "little")


def index_size(chunks: int) -> int:
    """Return how many bytes the index of a shard of so many chunks takes."""
    return 16 * chunks + _CHECK_BYTES


def parse_index(content: bytes, chunks: int, before: int) -> Index:
    """Return where the chunks of a shard begin, and their lengths.

    Parameters
    ----------
    content
        The last bytes of the shard, as many as `index_bytes` returns.
    chunks
        That a shard has.
    before
        Bytes of the shard before its index.

    Raises
    ------
    ValueError
        When it is damaged.
    """
    import google_crc32c

    entries, check = content[:-_CHECK_BYTES], content[-_CHECK_BYTES:]
    whole = len(entries) == 16 * chunks
    if not whole or int(google_crc32c.value(entries)).to_bytes(_CHECK_BYTES, "little") != check:
        raise ValueError("the index of a shard is damaged")
    starts, lengths = np.frombuffer(entries, "<u8").reshape(chunks, 2).T
    there = starts != _ABSENT
    if (starts[there] + lengths[there] > before).any():
        raise ValueError("the index of a shard points behind its end")
    return starts, lengths


def read_index(file: BinaryIO, chunks: int) -> Index:
    """Read the index of a shard in an open file; as `parse_index`.

    Raises
    ------
    OSError, ValueError
    """
    size = index_size(chunks)
    before = os.fstat(file.fileno()).st_size - size
    if before < 0:
        raise ValueError("a shard is shorter than its index")
    return parse_index(os.pread(file.fileno(), size, before), chunks, before)
