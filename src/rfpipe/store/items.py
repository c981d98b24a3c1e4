"""The array under a frame store: items read and written by chunk, with their digests."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, StaleStoreError
from rfpipe.store.chunks import (
    DAMAGE,
    ChunkedArray,
    layout,
    read_attributes,
)
from rfpipe.store.files import digest_of, hidden_sibling, remove_tree, storage_errors
from rfpipe.store.places import METADATA

KIND = "frames"
"""Attribute ``"kind"`` of stores of items."""


class ItemArray(ChunkedArray):
    """An array whose first axis counts items; safe for use by several threads."""

    def write_items(self, start: int, block: NDArray[Any]) -> list[str]:
        """Write items from `start` on, which fill complete files; return their digests."""
        stop, step = start + len(block), self.items_per_file
        if start % step or (stop % step and stop != self.shape[0]):
            raise InputError(
                f"items {start} to {stop} don't fill files of {step} items",
                place=self.path,
                remedy="write the runs that missing() returns",
            )
        digests: list[str] = []
        self._check(block)
        for first in range(0, len(block), step):
            with self.adding(start + first) as add:
                for chunk in range(first, min(first + step, len(block)), self.items_per_chunk):
                    digests += add(block[chunk : chunk + self.items_per_chunk])
        return digests

    @contextmanager
    def adding(self, start: int) -> Iterator[Callable[[NDArray[Any]], list[str]]]:
        """Write the items of one file, which begins with item `start`, chunk by chunk.

        The file appears once it is complete; a killed process leaves none.

        Yields
        ------
        callable
            ``add(block)`` writes the items of the next chunk and returns their digests.
        """
        place: Path = self.file(start)
        partial = hidden_sibling(place, f"{os.getpid()}.partial")
        needed = self.items_per_file * self.dtype.itemsize * int(np.prod(self.shape[1:]))
        lengths: list[int] = []
        with storage_errors(self.path, f"writing the items from {start} on", needed):
            try:
                with partial.open("wb") as file:

                    def add(block: NDArray[Any]) -> list[str]:
                        self._check(block)
                        lengths.append(file.write(self.packed(block)))
                        return [digest_of(np.ascontiguousarray(item)) for item in block]

                    yield add
                    file.write(self.index(lengths))
                partial.replace(place)
            except BaseException:
                partial.unlink(missing_ok=True)
                raise

    def read_items(self, start: int, stop: int, digests: Mapping[int, str]) -> NDArray[Any] | None:
        """Return items [start, stop), or None if the digest of one of them differs."""
        step = self.items_per_chunk
        offset = start % step
        block = np.empty((offset + stop - start, *self.shape[1:]), self.dtype)
        try:
            for first in range(0, len(block), step):
                self.read_chunk(start - offset + first, block[first : first + step])
        except DAMAGE:
            return None
        items = block[offset:]
        if [digest_of(item) for item in items] != [digests[n] for n in range(start, stop)]:
            return None
        return items

    def damaged(self, start: int, stop: int, digests: Mapping[int, str]) -> list[int]:
        """Return the items in [start, stop) whose digest differs from the one in `digests`."""
        step = self.items_per_chunk
        firsts = range(start - start % step, stop, step)
        chunks = (range(max(start, first), min(stop, first + step)) for first in firsts)
        return [
            item
            for chunk in chunks
            if chunk.start in digests and self.read_items(chunk.start, chunk.stop, digests) is None
            for item in chunk
        ]

    def whole_files(self, digests: Mapping[int, str]) -> dict[int, str]:
        """Return the digests of the items in complete files; files are written as a whole."""
        step, n_items = self.items_per_file, self.shape[0]
        counts = np.bincount([item // step for item in digests], minlength=-(-n_items // step))
        full = {file for file, n in enumerate(counts) if n == min(step, n_items - int(file) * step)}
        return {item: digest for item, digest in digests.items() if item // step in full}

    def _check(self, block: NDArray[Any]) -> None:
        if block.shape[1:] != self.shape[1:] or block.dtype != self.dtype:
            raise InputError(
                f"block of {block.dtype} {block.shape} doesn't match the store",
                place=self.path,
                remedy=f"expected {self.dtype} (items, {', '.join(map(str, self.shape[1:]))})",
            )


class ItemWriter(ItemArray):
    """Writer of items in a store that the caller or another process has opened for writing.

    Items count as missing until the process that opened the store calls `PictureStore.enter`.

    Parameters
    ----------
    path : Path
        Folder of the store.
    fingerprint : str
        Fingerprint that the store must have.
    """

    def __init__(self, path: Path, fingerprint: str) -> None:
        self._fingerprint = fingerprint
        stored = read_attributes(path, KIND).get("fingerprint")
        if stored != fingerprint:
            raise StaleStoreError(
                "store was made with another configuration: its fingerprint is "
                f"{stored} instead of {fingerprint}",
                place=path,
                remedy="run the stage that writes it again",
            )
        super().__init__(path)

    def __reduce__(self) -> tuple[type[ItemWriter], tuple[Any, ...]]:
        """Pickle for use in another process."""
        return type(self), (self.path, self._fingerprint)


def make_item_array(
    path: Path,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    attributes: dict[str, Any],
    items_per_chunk: int,
    chunks_per_file: int,
) -> None:
    """Create an empty array completely or not at all."""
    import zarr

    if path.is_file() or any(path.glob("*")):
        raise InputError(
            f"a file or folder other than a store exists here: it has no {METADATA}",
            place=path,
            remedy="move it away or choose another place",
        )
    new = hidden_sibling(path, "new")
    remove_tree(new)
    chunks_per_file = min(chunks_per_file, -(-shape[0] // items_per_chunk))
    with storage_errors(path, "making the store"):
        zarr.create_array(
            new,
            shape=shape,
            chunks=(items_per_chunk, *shape[1:]),
            shards=(items_per_chunk * chunks_per_file, *shape[1:]) if chunks_per_file > 1 else None,
            dtype=dtype,
            attributes=attributes,
            **layout(),
        )
        new.rename(path)
