"""Brackets on their way from the rig to their store, pattern by pattern."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.stages.capturing.shown import Keys
from rfpipe.stages.jobs.progress import Progress
from rfpipe.store import FrameStore

__all__ = ["Brackets", "Watch"]

_log = logging.getLogger(__name__)


class Watch(Protocol):
    """What is captured between the patterns of a level."""

    @property
    def every(self) -> int:
        """Patterns from one time to the next."""

    def before(self, position: int) -> None:
        """Take what is due before the pattern at `position`, or after the last one."""


@dataclass(frozen=True)
class Brackets:
    """One store of brackets to be captured, and the patterns to show for them.

    Parameters
    ----------
    rig : Rig
    path : Path
    name : str
        For messages.
    count : int
        Patterns in all.
    shown : dict
        Plain data: all that shapes the frames.
    patterns : callable
        ``patterns(first, last)`` returns these patterns and their keys.
    """

    rig: Rig
    path: Path
    name: str
    count: int
    shown: dict[str, Any]
    patterns: Callable[[int, int], tuple[NDArray[np.float32], Keys]]

    @property
    def made_for(self) -> str:
        """Fingerprint of all that shapes the frames."""
        return fingerprint(self.shown)

    def count_missing(self) -> int:
        """Count the brackets that aren't captured yet."""
        if not self.path.exists():
            return self.count
        with FrameStore.open(self.path) as frames:
            return self.count - int(np.count_nonzero(frames.done))

    def missing(self, most: int) -> list[tuple[int, int]]:
        """Return the runs of brackets that aren't captured yet, ``first, last``, of so many."""
        if not self.path.exists():
            return [(first, min(first + most, self.count)) for first in range(0, self.count, most)]
        with FrameStore.open(self.path) as frames:
            return list(frames.missing(most))

    def opened(self) -> FrameStore:
        """Open the store for writing; make it where there is none."""
        sensor = self.rig.sensor
        return FrameStore.create(
            self.path,
            (self.count, *sensor.frame_shape(self.rig.camera_shape, self.rig.channels)),
            sensor.frame_dtype,
            self.made_for,
            self.shown,
            # a twelfth more bytes than by zstd, written and read in half the time
            compression="lz4",
        )

    def capture(self, batch: int, watch: Watch | None = None) -> dict[str, Any]:
        """Capture the items that are missing; return the store's entry for the manifest.

        Parameters
        ----------
        batch : int
            Patterns shown, then stored, at a time.
        watch : Watch, optional
            Brackets to be taken between these.

        Raises
        ------
        CaptureError
            When the rig fails or returns what is no bracket; what is captured stays.
        """
        with self.opened() as frames:
            done = int(np.count_nonzero(frames.done))
            if frames.complete:
                _log.info("%s: all %d patterns are captured", self.name, self.count)
            elif done:
                _log.info(
                    "%s: %d of %d patterns are captured; going on at pattern %d",
                    self.name, done, self.count, frames.missing()[0][0],
                )  # fmt: skip
            with Progress(self.name, self.count, done) as progress:
                for first, last in _cut(frames.missing(batch), watch):
                    if watch:
                        watch.before(first)
                    self.take(frames, first, last)
                    progress.advance(last - first)
            if watch:
                watch.before(self.count)
            return self.entry(frames)

    def take(self, frames: FrameStore, first: int, last: int) -> NDArray[Any]:
        """Capture items ``first:last`` into the opened store; return their brackets."""
        block = self.rig.capture(*self.patterns(first, last))
        frames.write(first, self._checked(block, first, frames.shape[1:]))
        return block

    def entry(self, frames: FrameStore) -> dict[str, Any]:
        """Return what a manifest says of the store."""
        return {**frames.entry(), "fingerprint": self.made_for}

    def _checked(self, block: NDArray[Any], first: int, shape: tuple[int, ...]) -> NDArray[Any]:
        """Refuse what is no bracket before it is entered as captured."""
        dtype = self.rig.sensor.frame_dtype
        if block.shape[1:] != shape or block.dtype != dtype:
            raise CaptureError(
                f"{self.name}, pattern {first}: the rig returned {block.dtype} frames of shape "
                f"{block.shape[1:]}; expected {dtype} {shape}. Check the camera's size, pixel "
                "format and exposures, then run again: it goes on at this pattern"
            )
        if block.dtype.kind == "f" and not np.isfinite(block).all():
            bad = first + int(np.argwhere(~np.isfinite(block))[0][0])
            raise CaptureError(
                f"{self.name}, pattern {bad}: the rig returned NaN or infinity; light is finite. "
                "Check the rig, then run again: it goes on at this batch"
            )
        return block


def _cut(runs: Iterable[tuple[int, int]], watch: Watch | None) -> Iterator[tuple[int, int]]:
    """Cut runs of items where something else is to be taken between them."""
    for first, last in runs:
        due = range((first // watch.every + 1) * watch.every, last, watch.every) if watch else ()
        yield from pairwise([first, *due, last])
