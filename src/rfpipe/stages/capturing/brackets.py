"""Brackets on their way from the rig to their store, pattern by pattern."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, IntegrityError, StoreError
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch
from rfpipe.stages.aside import settle
from rfpipe.stages.capturing.shown import Keys
from rfpipe.stages.jobs.progress import Progress
from rfpipe.store import (
    FrameStore,
    keep_header,
    read_manifest,
    rebuild_header,
    restore_header,
)
from rfpipe.store.places import METADATA

__all__ = ["Brackets", "Watch"]

_log = logging.getLogger(__name__)


class Watch(Protocol):
    """What is captured between the patterns of a level."""

    def due(self, first: int, last: int) -> Sequence[int]:
        """Return positions after `first` and before `last` at which something is to be taken."""

    def before(self, position: int) -> None:
        """Take what is due before the pattern at `position`, or after the last one."""

    def after(self, first: int, brackets: NDArray[Any]) -> None:
        """Look at what was captured, from pattern `first` on."""


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

    def settle(self, when_changed: Literal["recapture", "refuse"]) -> None:
        """Make way for these brackets, see `rfpipe.stages.aside.settle`; a damaged header heals.

        A damaged header says nothing about the settings that a store was made with, and must not
        be taken for others.

        Raises
        ------
        StaleStoreError, LockedError
            As there.
        IntegrityError
            When the header is damaged, and is none of a store of these brackets.
        """
        if self.path.exists() and not self._is_known():
            if self._is_of_others or not rebuild_header(self.path, self._made_at):
                raise IntegrityError(
                    f"{self.path / METADATA}: damaged, and its frames aren't known to be those "
                    "that are to be captured now. Restore this file, or the settings that they "
                    f"were captured with; or move {self.path} away, and all of its patterns are "
                    "shown again"
                )
            _log.warning(
                "%s: its header was damaged or missing; made again from the schedule and the "
                "journal, so that no pattern has to be shown again for it", self.path,
            )  # fmt: skip
        settle(self.path, self.made_for, self.shown, when_changed)

    def opened(self) -> FrameStore:
        """Open the store for writing; make it where there is none."""
        frames = self._made_at(self.path)
        keep_header(self.path)
        return frames

    def _is_known(self) -> bool:
        """Whether the header, or its copy, says truly what a store was made for."""
        if restore_header(self.path):
            _log.warning("%s: its header was damaged or missing; restored", self.path)
        try:
            found = FrameStore.open(self.path)
        except StoreError:
            return False
        # from here on only stores without a copy can be damaged
        if fingerprint(found.attributes) != found.fingerprint:
            return False
        return found.fingerprint != self.made_for or (found.shape, found.dtype) == self._layout

    @property
    def _is_of_others(self) -> bool:
        """Whether the store is of other patterns or another rig, as far as anything still tells."""
        name = self.path.stem
        with suppress(StoreError):
            found = FrameStore.open(self.path)
            if self.made_for not in (found.fingerprint, fingerprint(found.attributes)):
                return True  # more than one thing is wrong with it
        try:
            stated = read_manifest(self.path.with_name("capture.json"))
        except StoreError:
            return False
        part = stated if name == "capture" else stated.get(name, {})
        return bool(part.get("fingerprint", self.made_for) != self.made_for)

    @property
    def _layout(self) -> tuple[tuple[int, ...], np.dtype[Any]]:
        sensor = self.rig.sensor
        item = sensor.frame_shape(self.rig.camera_shape, self.rig.channels)
        return (self.count, *item), np.dtype(sensor.frame_dtype)

    def _made_at(self, path: Path) -> FrameStore:
        return FrameStore.create(
            path,
            *self._layout,
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
                    taken = self.take(frames, first, last)
                    if watch:
                        watch.after(first, taken)
                    progress.advance(last - first)
            if watch:
                watch.before(self.count)
            return self.entry(frames)

    def take(self, frames: FrameStore, first: int, last: int) -> NDArray[Any]:
        """Capture items ``first:last`` into the opened store; return their brackets."""
        block = capture_batch(self.rig, *self.patterns(first, last))
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
        due = watch.due(first, last) if watch else ()
        yield from pairwise([first, *due, last])
