"""Storage of an acquisition in memory: no digests, no fingerprints, no journal."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rfpipe.errors import StoreError
from rfpipe.ranges import ranges
from rfpipe.rigs import Rig
from rfpipe.rigs.base import is_simulated
from rfpipe.storage.base import (
    Arrays,
    Attributes,
    Entry,
    Facts,
    Manifest,
    WhenChanged,
    level_name,
    rig_settings,
)
from rfpipe.units import RADIANCE

# ruff: noqa: D102, ARG002 - methods and arguments as in Storage and StoredPictures


class MemoryStorage:
    """Storage of an acquisition that ends with its process; see `rfpipe.storage.base.Storage`.

    Brackets are dropped once they are merged. States aren't stored: the loop passes them on.

    Attributes
    ----------
    seconds : dict of str to float
        Wall time of each stage.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._arrays: dict[tuple[int, str], tuple[Arrays, Attributes]] = {}
        self._manifests: dict[tuple[int, str], Manifest] = {}
        self._pictures: dict[tuple[int, str], MemoryPictures] = {}

    def exists(self, level: int, stage: str) -> bool:
        return (level, stage) in self._manifests

    def read_manifest(self, level: int, stage: str) -> Manifest:
        return self._manifests[level, stage]

    def current_manifest(self, level: int, stage: str, fingerprint: str) -> Manifest | None:
        return None

    def write(
        self,
        level: int,
        stage: str,
        fingerprint: str,
        arrays: Arrays,
        facts: Facts,
        **attributes: Any,
    ) -> None:
        if stage != "refine":
            self._arrays[level, stage] = arrays, {"facts": facts, **attributes}
        self._manifests[level, stage] = {**facts, "digest": ""}

    def write_part(self, level: int, part: str, arrays: Arrays, **attributes: Any) -> Entry:
        self._arrays[level, part] = arrays, attributes
        return {"digest": ""}

    def write_manifest(self, level: int, stage: str, manifest: Manifest) -> None:
        self._manifests[level, stage] = manifest

    def read(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Attributes]:
        return self._arrays[level, part or stage]

    def open(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Attributes]:
        return self.read(level, stage, part)

    def pictures(
        self, level: int, stage: str, part: str | None = None
    ) -> AbstractContextManager[MemoryPictures]:
        return nullcontext(self._pictures[level, part or stage])

    def partial_brackets(self, level: int, part: str) -> AbstractContextManager[MemoryPictures]:
        if (level, part) not in self._pictures:
            raise StoreError(f"{level_name(level)}: no brackets of {part} were captured")
        return nullcontext(self._pictures[level, part])

    def missing_brackets(
        self, level: int, part: str, count: int, longest: int
    ) -> list[tuple[int, int]]:
        return ranges(count, longest)

    def make_room(
        self,
        level: int,
        part: str,
        fingerprint: str,
        attributes: Attributes,
        when_changed: WhenChanged,
    ) -> None:
        """Do nothing: an acquisition in memory captures each pattern once."""

    def record_brackets(
        self,
        level: int,
        part: str,
        shape: tuple[int, ...],
        dtype: DTypeLike,
        fingerprint: str,
        attributes: Attributes,
    ) -> AbstractContextManager[MemoryPictures]:
        self._pictures[level, part] = MemoryPictures(shape, dtype)
        return nullcontext(self._pictures[level, part])

    @contextmanager
    def record_images(
        self, level: int, shape: tuple[int, ...], fingerprint: str, layout: tuple[int, int]
    ) -> Iterator[tuple[MemoryPictures, MemoryPictures]]:
        images = self._pictures[level, "merge"] = MemoryPictures(shape, RADIANCE)
        yield images, images
        del self._pictures[level, "capture"]

    def folder(self, level: int) -> Path:
        return Path()

    def images_without_raw(self, level: int, inputs: Facts, fingerprint: str) -> Manifest | None:
        return None

    def drop_raw(self, level: int) -> None:
        """Do nothing: brackets are dropped as soon as they are merged."""

    def describe_rig(self, rig: Rig) -> Facts:
        """Describe a rig; not a simulated one, whose fingerprint takes as long as a level."""
        return {} if is_simulated(rig) else rig_settings(rig)

    def check_space(self, level: int, needed: int) -> None:
        """Do nothing: nothing is written to a disk."""

    def seconds_since_capture(self) -> float:
        return np.inf

    def recovery_advice(self, level: int) -> str:
        return "watch='warn' continues despite it"

    @contextmanager
    def timing(self, level: int, stage: str) -> Iterator[None]:
        began = perf_counter()
        yield
        self.seconds[stage] += perf_counter() - began


class MemoryPictures:
    """Pictures in memory, as `rfpipe.storage.base.StoredPictures` and `rfpipe.store.ItemWriter`."""

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self.attributes: Attributes = {}
        self.shape, self.dtype = shape, np.dtype(dtype)
        self.done = np.zeros(shape[0], np.bool_)
        self._items = np.empty(shape, dtype)

    def missing(self, longest: int | None = None) -> list[tuple[int, int]]:
        items = self.shape[0]
        return ranges(items, longest or max(1, items))

    def write(self, start: int, block: NDArray[Any]) -> None:
        self._items[start : start + len(block)] = block
        self.done[start : start + len(block)] = True

    @contextmanager
    def adding(self, start: int) -> Iterator[Callable[[NDArray[Any]], list[str]]]:
        """Provide a function that writes items from `start` on and returns their digests."""
        position = start

        def add(block: NDArray[Any]) -> list[str]:
            nonlocal position
            self.write(position, block)
            position += len(block)
            return []

        yield add

    def enter(self, start: int, digests: list[str]) -> None:
        """Do nothing: pictures in memory have no journal."""

    def read(self, start: int, stop: int) -> NDArray[Any]:
        return self._items[start:stop]

    def entry(self) -> Entry:
        return {"digest": "", "dtype": self.dtype.str, "shape": list(self.shape)}
