"""An acquisition in memory, in the place of its folder."""
# ruff: noqa: D102, ARG002 - methods and arguments are those of AcquisitionFolder

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import count
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.stages.folder import AcquisitionFolder, Arrays, Facts
from rfpipe.units import RADIANCE


class AcquisitionInMemory(AcquisitionFolder):
    """An acquisition that ends with its process: no digests, and no raw frames once merged.

    Attributes
    ----------
    seconds : dict of str to float
        Wall time of each stage.
    """

    def __init__(self) -> None:
        super().__init__(Path())
        self._held: dict[tuple[int, str], tuple[Arrays, Facts]] = {}
        self._manifests: dict[tuple[int, str], Facts] = {}
        self._frames: dict[Path, FramesInMemory] = {}
        self.seconds: dict[str, float] = defaultdict(float)

    @property
    def is_kept(self) -> bool:
        return False

    def exists(self, level: int, stage: str) -> bool:
        return (level, stage) in self._manifests

    def read_manifest(self, level: int, stage: str) -> Facts:
        return self._manifests[level, stage]

    def standing(self, level: int, stage: str, made_from: str) -> Facts | None:
        return None

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

    @contextmanager
    def doing(self, level: int, stage: str) -> Iterator[None]:
        began = perf_counter()
        yield
        self.seconds[stage] += perf_counter() - began


class FramesInMemory:
    """Frames in memory, with what stages use of `rfpipe.store.FrameStore` and `ItemWriter`."""

    dropped = False

    def __init__(self, shape: tuple[int, ...], dtype: Any) -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        self.done = np.zeros(shape[0], np.bool_)
        self._items = np.empty(shape, dtype)

    @property
    def complete(self) -> bool:
        return bool(self.done.all())

    def missing(self, longest: int) -> list[tuple[int, int]]:
        stop = self.shape[0]
        return [(first, min(first + longest, stop)) for first in range(0, stop, longest)]

    def write(self, start: int, block: NDArray[Any]) -> list[str]:
        self._items[start : start + len(block)] = block
        self.done[start : start + len(block)] = True
        return []

    @contextmanager
    def adding(self, start: int) -> Iterator[Any]:
        at = count(start)
        yield lambda block: [self.write(next(at), item[None]) for item in block] and []

    def enter(self, start: int, digests: list[str]) -> None:
        """Do nothing: there is no journal."""

    def read(self, start: int, stop: int) -> NDArray[Any]:
        return self._items[start:stop]

    def entry(self) -> dict[str, Any]:
        return {"digest": "", "dtype": self.dtype.str, "shape": list(self.shape)}
