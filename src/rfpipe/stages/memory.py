"""An acquisition in memory, in the place of its folder."""
# ruff: noqa: D102, ARG002 - methods and arguments are those of AcquisitionFolder

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.stages.folder import AcquisitionFolder, Arrays, Facts
from rfpipe.units import RADIANCE


class AcquisitionInMemory(AcquisitionFolder):
    """An acquisition that ends with its process: manifests have no digests, raw frames no merge."""

    def __init__(self) -> None:
        super().__init__(Path())
        self._held: dict[tuple[int, str], tuple[Arrays, Facts]] = {}
        self._manifests: dict[tuple[int, str], Facts] = {}
        self._frames: dict[Path, FramesInMemory] = {}

    @property
    def is_kept(self) -> bool:
        return False

    def exists(self, level: int, stage: str) -> bool:
        return (level, stage) in self._manifests

    def read_manifest(self, level: int, stage: str) -> Facts:
        return self._manifests[level, stage]

    def standing(self, level: int, stage: str, made_from: str) -> Facts | None:
        return None

    def write(
        self, level: int, stage: str, made_from: str, arrays: Arrays, facts: Facts, **more: Any
    ) -> None:
        entry = self.write_part(level, stage, arrays, facts=facts, **more)
        self._manifests[level, stage] = facts | entry

    def write_part(self, level: int, part: str, arrays: Arrays, **about: Any) -> Facts:
        self._held[level, part] = arrays, about
        return {"digest": ""}

    def write_manifest(self, level: int, stage: str, facts: Facts) -> None:
        self._manifests[level, stage] = facts

    def open(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Facts]:
        return self._held[level, part or stage]

    def frames(self, level: int, stage: str, part: str | None = None) -> Any:
        return nullcontext(self._frames[self.store(level, part or stage)])

    def recording(
        self, path: Path, shape: tuple[int, ...], dtype: Any, made_for: str, shown: Facts
    ) -> Any:
        self._frames[path] = FramesInMemory(shape, dtype)
        return nullcontext(self._frames[path])

    @contextmanager
    def merging(
        self, level: int, shape: tuple[int, ...], made_from: str, layout: tuple[int, int]
    ) -> Iterator[Any]:
        images = self._frames[self.store(level, "merge")] = FramesInMemory(shape, RADIANCE)
        yield images, images
        del self._frames[self.store(level, "capture")]

    def doing(self, level: int, stage: str) -> Any:
        return nullcontext()


class FramesInMemory:
    """Frames in memory, with what stages use of `rfpipe.store.FrameStore`."""

    def __init__(self, shape: tuple[int, ...], dtype: Any) -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        self.done = np.zeros(shape[0], np.bool_)
        self._items = np.empty(shape, dtype)

    @property
    def complete(self) -> bool:
        """True when every item is there."""
        return bool(self.done.all())

    def missing(self, longest: int) -> list[tuple[int, int]]:
        """List the runs of items still to come, of at most so many."""
        count = self.shape[0]
        return [(first, min(first + longest, count)) for first in range(0, count, longest)]

    def write(self, start: int, block: NDArray[Any]) -> None:
        """Keep items."""
        self._items[start : start + len(block)] = block
        self.done[start : start + len(block)] = True

    @contextmanager
    def adding(self, start: int) -> Iterator[Any]:
        """Provide what takes the items from `start` on, block by block."""
        at = start

        def add(block: NDArray[Any]) -> list[str]:
            nonlocal at
            self.write(at, block)
            at += len(block)
            return []

        yield add

    def enter(self, start: int, digests: list[str]) -> None:
        """Do nothing: there is no journal."""

    def read(self, start: int, stop: int) -> NDArray[Any]:
        """Return items ``start:stop``."""
        return self._items[start:stop]

    def entry(self) -> dict[str, Any]:
        """Describe it for a manifest."""
        return {"digest": "", "dtype": self.dtype.str, "shape": list(self.shape)}
