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
"""What the stores of items call themselves."""


class ItemArray(ChunkedArray):
    """An array whose first axis counts items; threads may share it."""

    def write_items(self, start: int, block: NDArray[Any]) -> list[str]:
        """Store the items from `start` on, in whole files; return their digests."""
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
        """Store the items of one file, from its first, with no more than one chunk in memory.

        The file is there once all of them are; a process that is killed leaves none.

        Yields
        ------
        callable
            Takes the items of the next chunk, and returns their digests.
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
        """Return items [start, stop), or None when one isn't what its digest says."""
        step = self.items_per_chunk
        before = start % step
        block = np.empty((before + stop - start, *self.shape[1:]), self.dtype)
        try:
            for first in range(0, len(block), step):
                self.read_chunk(start - before + first, block[first : first + step])
        except DAMAGE:
            return None
        items = block[before:]
        if [digest_of(item) for item in items] != [digests[n] for n in range(start, stop)]:
            return None
        return items

    def damaged(self, start: int, stop: int, digests: Mapping[int, str]) -> list[int]:
        """Return those of the items [start, stop) in `digests` that aren't as they were written."""
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
        """Return what covers files wholly, since they are written whole."""
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
    """An array whose lock and journal the caller, or another process, holds.

    The holder enters what was written by `FrameStore.enter`; until then it counts as missing.

    Parameters
    ----------
    path
        The store's folder.
    fingerprint
        What the store must have been made with.
    """

    def __init__(self, path: Path, fingerprint: str) -> None:
        self._made_with = fingerprint
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
        """Let another process have it."""
        return type(self), (self.path, self._made_with)


def make_item_array(
    path: Path,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    attributes: dict[str, Any],
    items_per_chunk: int,
    chunks_per_file: int,
) -> None:
    """Make an empty array, complete or absent."""
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
