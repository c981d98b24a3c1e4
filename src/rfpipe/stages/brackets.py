"""Brackets on their way from the rig to their store, pattern by pattern."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import monotonic
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, StaleStoreError
from rfpipe.jobs.job import Progress
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch
from rfpipe.storage.files import AcquisitionFolder
from rfpipe.store import FrameStore, StoreLock, restore_header
from rfpipe.text import counted

Keys = list[tuple[int, ...]]
"""A key a pattern: for the rig's random numbers, and for messages."""

_NAMED_DIGITS = 12
_SHOWN_DIFFERENCES = 12
_LONGEST_VALUE = 100
_PROSE = ".verdict"
_DIGEST = re.compile("[0-9a-f]{12,}")

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Brackets:
    """One store of brackets to be captured, and the patterns to show for them.

    Attributes
    ----------
    path : Path
        Of the store.
    name : str
        For messages.
    shown : dict
        Plain data: all that shapes the frames. The store has it as its attributes.
    patterns : callable
        ``patterns(first, last)`` returns these of the `count` patterns, and their keys.
    """

    rig: Rig
    folder: AcquisitionFolder
    path: Path
    name: str
    count: int
    shown: dict[str, Any]
    patterns: Callable[[int, int], tuple[NDArray[np.float32], Keys]]

    @property
    def made_for(self) -> str:
        """Fingerprint of all that shapes the frames."""
        return fingerprint(self.shown)

    def missing(self, most: int) -> list[tuple[int, int]]:
        """Return the runs of brackets that aren't captured yet, ``first, last``, of so many."""
        if not self.folder.is_kept or not self.path.exists():
            return [(first, min(first + most, self.count)) for first in range(0, self.count, most)]
        with FrameStore.open(self.path) as frames:
            return list(frames.missing(most))

    def count_missing(self) -> int:
        """Count the brackets that aren't captured yet."""
        return sum(last - first for first, last in self.missing(max(1, self.count)))

    def recording(self) -> Any:
        """Open the store for writing; make it where there is none. A context manager."""
        return self.folder.recording(self.path, *self._layout, self.made_for, self.shown)

    def capture(self, batch: int, watch: Any = None, *, progress: bool = True) -> dict[str, Any]:
        """Capture the brackets that are missing; return the store's entry for the manifest.

        A `rfpipe.stages.watch.Watcher` takes looks between them. Raises CaptureError when the rig
        fails or returns what is no bracket; what is captured stays.
        """
        with self.recording() as frames:
            done = int(np.count_nonzero(frames.done))
            if 0 < done < self.count:
                _log.info(
                    "%s: %d of %d patterns are captured; going on at pattern %d",
                    self.name, done, self.count, frames.missing(1)[0][0],
                )  # fmt: skip
            began = monotonic()
            with Progress(self.name, self.count, done, shown=progress) as bar:
                for start, stop in frames.missing(batch):
                    looks = watch.due(start, stop) if watch else ()
                    for first, last in pairwise([start, *looks, stop]):
                        if watch:
                            watch.before(first)
                        frames.write(first, self.take(first, last))
                        bar.advance(last - first)
            if done < self.count:
                taken = counted(self.count - done, "pattern")
                _log.info("%s: %s in %.1f s", self.name, taken, monotonic() - began)
            if watch:
                watch.before(self.count)
            return self.entry(frames)

    def take(self, first: int, last: int) -> NDArray[Any]:
        """Capture items ``first:last``; return their brackets, which the caller stores."""
        return self._checked(capture_batch(self.rig, *self.patterns(first, last)), first)

    def entry(self, frames: Any) -> dict[str, Any]:
        """Return what a manifest says of the store."""
        return {**frames.entry(), "fingerprint": self.made_for}

    def settle(self, when_changed: Literal["recapture", "refuse"] = "recapture") -> None:
        """Make way for these brackets: afterwards their store stands at its place, or none does.

        A store of something else is renamed, its fingerprint in its new name. Back at the settings
        that it was made with, it is found again, so that the rig needn't be. If its pictures were
        dropped after their merge, it is removed. A damaged header is restored from its copy.

        Raises
        ------
        StaleStoreError
            When a store of something else stands there, none fits, and `when_changed` is "refuse".
        LockedError
            When another process writes the store.
        IntegrityError
            When the header and its copy are damaged.
        """
        if not self.folder.is_kept:
            return
        if self.path.exists() and restore_header(self.path):
            _log.warning("%s: its header was damaged or missing; restored", self.path)
        fitting = self._aside(self.made_for)
        with StoreLock(self.path):
            if self.path.exists():
                with FrameStore.open(self.path) as old:
                    if old.fingerprint == self.made_for:
                        return
                    captured = int(old.done.sum())
                place = self._aside(old.fingerprint)
                if captured and not fitting.exists():
                    self._say_anew(old, captured, place, when_changed)
                FrameStore.discard(place)  # of a change that was undone before it was captured
                self.path.rename(place)
                if old.dropped or not captured:
                    FrameStore.discard(place)
            if fitting.exists():
                fitting.rename(self.path)
                text = "%s: captured with these settings before; taken from %s"
                _log.warning(text, self.path, fitting)

    @property
    def _layout(self) -> tuple[tuple[int, ...], np.dtype[Any]]:
        sensor = self.rig.sensor
        item = sensor.frame_shape(self.rig.camera_shape, self.rig.channels)
        return (self.count, *item), np.dtype(sensor.frame_dtype)

    def _checked(self, block: NDArray[Any], first: int) -> NDArray[Any]:
        """Refuse what is no bracket before it is entered as captured."""
        (_, *shape), dtype = self._layout
        again = "then run again: it goes on there"
        if block.shape[1:] != tuple(shape) or block.dtype != dtype:
            raise CaptureError(
                f"{self.name}, pattern {first}: the rig returned {block.dtype} frames of shape "
                f"{block.shape[1:]}; expected {dtype} {tuple(shape)}. Check the camera's size, "
                f"pixel format and exposures, {again}"
            )
        if block.dtype.kind == "f" and not np.isfinite(block).all():
            bad = first + int(np.argwhere(~np.isfinite(block))[0][0])
            raise CaptureError(
                f"{self.name}, pattern {bad}: the rig returned NaN or infinity; light is finite. "
                f"Check the rig, {again}"
            )
        return block

    def _aside(self, made_for: str) -> Path:
        name = f"{self.path.stem}.{made_for[:_NAMED_DIGITS]}{self.path.suffix}"
        return self.path.with_name(name)

    def _say_anew(self, old: FrameStore, count: int, place: Path, when_changed: str) -> None:
        """Refuse to capture anew, or say that it is about to happen."""
        changed = differing(old.attributes, self.shown)
        kept = (
            "were dropped after their merge (capture.keep_raw)"
            if old.dropped
            else f"are kept in {place}, for when you go back to them; remove it to free the space"
        )
        if when_changed == "refuse":
            raise StaleStoreError(
                f"{self.path}: holds {count} captured patterns of other settings ({changed}); "
                "restore those settings, or set capture.when_patterns_change to recapture to take "
                f"these patterns anew (the old ones {kept})"
            )
        _log.warning(
            "%s: CAPTURING ANEW, since the settings changed (%s). The %d patterns captured with "
            "the old settings %s", self.path, changed, count, kept,
        )  # fmt: skip


def differing(old: dict[str, Any], new: dict[str, Any]) -> str:
    """List the settings that differ, such as ``patterns 64 -> 72, rig.seed 1 -> 2``.

    The shortest come first; last, without their values, those whose values are digests or prose.
    """
    import pandas as pd

    plain = (json.loads(json.dumps(each, sort_keys=True)) for each in (old, new))
    before, after = (
        {str(name): str(values[0]) for name, values in pd.json_normalize([each]).items()}
        for each in plain
    )
    values = {
        name: (before.get(name, "unset"), after.get(name, "unset"))
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name)
    }
    readable = {
        name
        for name, both in values.items()
        if not name.endswith(_PROSE) and all(map(_is_readable, both))
    }
    changed = sorted((f"{name} {' -> '.join(values[name])}" for name in readable), key=len)
    changed += [f"{name} changed" for name in values if name not in readable]
    more = len(changed) - _SHOWN_DIFFERENCES
    if more > 0:
        changed[_SHOWN_DIFFERENCES:] = [f"and {more} more"]
    return ", ".join(changed)


def _is_readable(value: str) -> bool:
    """Test whether a setting's value says more to a reader than that it changed."""
    return len(value) <= _LONGEST_VALUE and not _DIGEST.fullmatch(value)
