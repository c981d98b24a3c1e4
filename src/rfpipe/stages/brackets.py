"""Sets of brackets: patterns, their keys, and the capture of those that are missing."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import pairwise
from time import monotonic
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.jobs.job import Progress
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch
from rfpipe.storage.base import Facts, Storage, StoredPictures
from rfpipe.text import counted

Keys = list[tuple[int, ...]]
"""One key per pattern, which seeds simulated noise and names the pattern in messages."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BracketSet:
    """Brackets to be captured for one store, and their patterns.

    Attributes
    ----------
    level : int
    part : str
        Name of the store.
    name : str
        Name in messages.
    count : int
        Number of brackets.
    settings : dict
        Plain data that determine the frames; the store's attributes.
    patterns : callable
        ``patterns(first, last)`` returns patterns ``first:last``, and their keys.
    """

    level: int
    part: str
    name: str
    count: int
    settings: Facts
    patterns: Callable[[int, int], tuple[NDArray[np.float32], Keys]]

    @property
    def fingerprint(self) -> str:
        """Fingerprint of all that determines the frames."""
        return fingerprint(self.settings)

    def missing(self, storage: Storage, longest: int) -> list[tuple[int, int]]:
        """List the runs of brackets that aren't captured, of at most `longest`."""
        return storage.missing_brackets(self.level, self.part, self.count, longest)

    def count_missing(self, storage: Storage) -> int:
        """Count the brackets that aren't captured."""
        return sum(last - first for first, last in self.missing(storage, max(1, self.count)))

    def entry(self, store: StoredPictures) -> Facts:
        """Describe the captured brackets for a manifest."""
        return {**store.entry(), "fingerprint": self.fingerprint}


class CheckPictureTaker(Protocol):
    """Takes check pictures between the patterns of a level; see `rfpipe.stages.watch`."""

    def due(self, first: int, last: int) -> range:
        """Return the positions between two patterns at which a check picture is due."""

    def before(self, position: int) -> None:
        """Take the check picture that is due before the pattern at a position."""


def capture_brackets(
    rig: Rig,
    storage: Storage,
    brackets: BracketSet,
    batch: int,
    watcher: CheckPictureTaker | None = None,
    *,
    progress: bool = True,
) -> Facts:
    """Capture the brackets that are missing; return their entry for the manifest.

    Parameters
    ----------
    batch : int
        Patterns displayed, then stored, at a time.
    watcher : CheckPictureTaker, optional
        Takes check pictures between them.

    Raises
    ------
    CaptureError
        When the rig fails or returns invalid frames; captured brackets stay.
    """
    name, count = brackets.name, brackets.count
    with open_recording(rig, storage, brackets) as store:
        done = int(np.count_nonzero(store.done))
        if 0 < done < count:
            _log.info(
                "%s: %d of %d patterns are captured; going on at pattern %d",
                name, done, count, store.missing(1)[0][0],
            )  # fmt: skip
        began = monotonic()
        with Progress(name, count, done, is_visible=progress) as bar:
            for start, stop in store.missing(batch):
                _capture_batch(rig, brackets, store, start, stop, watcher)
                bar.advance(stop - start)
        if done < count:
            _log.info(
                "%s: %s in %.1f s", name, counted(count - done, "pattern"), monotonic() - began
            )
        if watcher:
            watcher.before(count)
        return brackets.entry(store)


def _capture_batch(
    rig: Rig,
    brackets: BracketSet,
    store: StoredPictures,
    start: int,
    stop: int,
    watcher: CheckPictureTaker | None,
) -> None:
    """Capture and store brackets ``start:stop``, with the check pictures that are due."""
    checks = watcher.due(start, stop) if watcher else ()
    for first, last in pairwise([start, *checks, stop]):
        if watcher:
            watcher.before(first)
        store.write(first, take_brackets(rig, brackets, first, last))


def open_recording(
    rig: Rig, storage: Storage, brackets: BracketSet
) -> AbstractContextManager[StoredPictures]:
    """Open the store of brackets for writing; create it if there is none."""
    shape, dtype = _layout(rig, brackets)
    return storage.record_brackets(
        brackets.level, brackets.part, shape, dtype, brackets.fingerprint, brackets.settings
    )


def take_brackets(rig: Rig, brackets: BracketSet, first: int, last: int) -> NDArray[Any]:
    """Capture brackets ``first:last``, without storing them; validates what the rig returns."""
    block = capture_batch(rig, *brackets.patterns(first, last))
    (_, *shape), dtype = _layout(rig, brackets)
    goes_on = "then run again: the capture continues there"
    if block.shape[1:] != tuple(shape) or block.dtype != dtype:
        raise CaptureError(
            f"{brackets.name}, pattern {first}: the rig returned {block.dtype} frames of shape "
            f"{block.shape[1:]}; expected {dtype} {tuple(shape)}",
            remedy=f"Check the camera's size, pixel format and exposures, {goes_on}",
        )
    if block.dtype.kind == "f" and not np.isfinite(block).all():
        pattern = first + int(np.argwhere(~np.isfinite(block))[0][0])
        raise CaptureError(
            f"{brackets.name}, pattern {pattern}: the rig returned NaN or infinity; light is "
            "finite",
            remedy=f"Check the rig, {goes_on}",
        )
    return block


def _layout(rig: Rig, brackets: BracketSet) -> tuple[tuple[int, ...], np.dtype[Any]]:
    item = rig.sensor.frame_shape(rig.camera_shape, rig.channels)
    return (brackets.count, *item), np.dtype(rig.sensor.frame_dtype)
