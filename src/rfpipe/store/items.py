"""The array under a frame store: items read and written by chunk, with their digests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.store.chunks import (
    DAMAGE,
    METADATA,
    Compression,
    layout,
    open_array,
)
from rfpipe.store.files import digest_of, hidden_sibling, remove_tree, storage_errors

__all__ = ["ItemArray", "item_digests", "make_item_array"]


class ItemArray:
    """A zarr array whose first axis counts items.

    Parameters
    ----------
    path
        Its folder.
    writable
        False opens it for reading.

    Raises
    ------
    IntegrityError
        When its metadata are damaged.
    """

    def __init__(self, path: Path, *, writable: bool) -> None:
        self._path = path
        self._array = open_array(path, "r+" if writable else "r")
        self.shape: tuple[int, ...] = self._array.shape
        self.dtype: np.dtype[Any] = np.dtype(self._array.dtype)
        self.items_per_chunk: int = self._array.chunks[0]

    def write(self, start: int, block: NDArray[Any]) -> None:
        """Store the items from `start` on; whole chunks."""
        action = f"writing items {start} to {start + len(block) - 1}"
        with storage_errors(self._path, action, block.nbytes):
            self._array[start : start + len(block)] = block

    def read(self, start: int, stop: int, digests: Mapping[int, str]) -> NDArray[Any] | None:
        """Items [start, stop), or None when one isn't what its digest says."""
        # zarr takes a missing chunk for zeros, which are what a black frame holds.
        if not all(self.chunk_file(first).exists() for first in self._chunk_starts(start, stop)):
            return None
        try:
            block = np.asarray(self._array[start:stop])
        except DAMAGE:
            return None
        if item_digests(block) != [digests[item] for item in range(start, stop)]:
            return None
        return block

    def damaged(self, start: int, stop: int, digests: Mapping[int, str]) -> list[int]:
        """Those of the items [start, stop) in `digests` that can't be read as they were written."""
        damaged: list[int] = []
        for first in self._chunk_starts(start, stop):
            chunk = range(max(start, first), min(stop, first + self.items_per_chunk))
            items = [item for item in chunk if item in digests]
            if len(items) < len(chunk) or self.read(chunk.start, chunk.stop, digests) is None:
                damaged += [i for i in items if self.read(i, i + 1, digests) is None]
        return damaged

    def chunk_file(self, item: int) -> Path:
        """File that holds an item."""
        key = [item // self.items_per_chunk, *(0 for _ in self.shape[1:])]
        return self._path / ".".join(["c", *map(str, key)])

    def whole_chunks(self, digests: Mapping[int, str]) -> dict[int, str]:
        """Keep what covers chunks wholly, since they are written whole."""
        step, n_items = self.items_per_chunk, self.shape[0]
        if step == 1:
            return dict(digests)
        held = np.bincount([item // step for item in digests], minlength=-(-n_items // step))
        full = {
            chunk for chunk, n in enumerate(held) if n == min(step, n_items - int(chunk) * step)
        }
        return {item: digest for item, digest in digests.items() if item // step in full}

    def _chunk_starts(self, start: int, stop: int) -> range:
        step = self.items_per_chunk
        return range(start - start % step, stop, step)


def item_digests(block: NDArray[Any]) -> list[str]:
    """Digest of each item's bytes in a C-ordered block."""
    return [digest_of(item) for item in block]


def make_item_array(
    path: Path,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    attributes: dict[str, Any],
    *,
    items_per_chunk: int,
    compression: Compression,
) -> None:
    """Make an empty array, complete or absent.

    Raises
    ------
    InputError
        When something that is no array stands there.
    StoreError
        When the disk is full or the folder isn't writable.
    """
    import zarr

    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError(
            f"{path}: stands here but is no store (it has no {METADATA}); move it away or choose "
            "another place"
        )
    new = hidden_sibling(path, "new")
    remove_tree(new)
    with storage_errors(path, "making the store"):
        zarr.create_array(
            new,
            shape=shape,
            chunks=(items_per_chunk, *shape[1:]),
            dtype=dtype,
            attributes=attributes,
            **layout(compression),
        )
        new.rename(path)
