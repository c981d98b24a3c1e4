"""Watch over a capture: looks at a fine random pattern, between the patterns of a level.

A look that differs from the first one is repeated, and what changed is named: see
`rfpipe.references.comparison`, and `rfpipe.references.steadiness` for looks one after another.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.sensor import Merged
from rfpipe.references.check_pictures import (
    check_pattern,
    check_picture_count,
    first_check_picture,
    recovery_advice,
)
from rfpipe.references.comparison import Change, change
from rfpipe.references.reference_images import Merger, read_merger
from rfpipe.references.steadiness import Samples, camera_of, motion_of, sample, scatter_of
from rfpipe.rigs.faults import CAPTURE, NOTED, SIGNIFICANCE, Fault, moved_fault, room_fault
from rfpipe.stages.brackets import Brackets, Keys
from rfpipe.storage.files import CHECK_PICTURES, name_of
from rfpipe.store import FrameStore, restore_header
from rfpipe.units import CHECK_PICTURE_KEY

# Change of brightness from one look to the next after which the look is repeated.
_JUMP = 0.01
# Further repetitions of a look whose first one differs, too.
_REPETITIONS = 2
Double = NDArray[np.float64]

_log = logging.getLogger(__name__)


@contextmanager
def watching_level(
    of_level: Brackets, level: int, mode: str = "off", looks: int = 0
) -> Iterator[Watcher | None]:
    """Provide what watches the capture of a level, or None.

    A level that was begun with looks goes on with them, as they were; one that was begun without
    has none, since looks at its first part can't be taken afterwards.

    Parameters
    ----------
    of_level : Brackets
        Of the level's patterns, settled.
    mode : {"off", "warn", "refuse"}
        What to do when the rig moved: refuse ends the capture.
    looks : int
        Patterns from one look to the next, 0 for none.
    """
    path = of_level.folder.store(level, CHECK_PICTURES)
    every = _interval(of_level, path, looks if mode != "off" else 0)
    if not every:
        yield None
        return
    pattern = check_pattern(of_level.rig.projector_shape)

    def repeated(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        keys: Keys = [(CHECK_PICTURE_KEY, level, index) for index in range(first, last)]
        return np.repeat(pattern[None], last - first, axis=0), keys

    about = {"interval": every, "made_beside": of_level.made_for, "rig": of_level.shown["rig"]}
    brackets = Brackets(
        of_level.rig, of_level.folder, path, f"{name_of(level)}, looks at the rig",
        check_picture_count(of_level.count, every), about, repeated,
    )  # fmt: skip
    brackets.settle()
    with brackets.recording() as frames:
        is_merged = of_level.folder.exists(0, "merge")
        merger = read_merger(of_level.rig.sensor, of_level.folder) if is_merged else None
        yield Watcher(of_level, level, merger, brackets, frames, every, mode == "refuse")


def _interval(of_level: Brackets, path: Path, every: int) -> int:
    """Return the patterns between looks, whose store is `path`; those of a level that was begun."""
    if of_level.count_missing() == of_level.count:
        return every if of_level.count else 0
    if path.exists():
        restore_header(path)
        with FrameStore.open(path) as begun:
            if begun.attributes.get("made_beside") == of_level.made_for:
                return int(begun.attributes["interval"])
    return 0


@dataclass(frozen=True)
class Watcher:
    """Takes the looks of a level: brackets of one pattern, again and again between its own."""

    of_level: Brackets
    level: int
    merger: Merger | None
    looks: Brackets
    frames: Any
    every: int
    refuse: bool

    def due(self, first: int, last: int) -> Sequence[int]:
        """Return the positions between two patterns at which a look is due."""
        return range((first // self.every + 1) * self.every, last, self.every)

    def before(self, position: int) -> None:
        """Take the look that is due before the pattern at `position`, or after the last one.

        Raises CaptureError where it shows, and repeated as well, that gain, light or rig changed,
        and that is to end the capture. That look isn't stored: the next run begins by taking it
        again.
        """
        is_last = position == self.of_level.count
        index = self.looks.count - 1 if is_last else position // self.every
        if self.frames.done[index]:
            return
        bracket = self.looks.take(index, index + 1)
        if self.merger is not None:
            self._compare(self.merger, position, index, bracket)
        self.frames.write(index, bracket)

    def _compare(self, merger: Merger, position: int, index: int, bracket: NDArray[Any]) -> None:
        """Compare a look with the first one, and repeat it where more than the lamp may differ."""
        known = first_check_picture(self.of_level.folder, merger)
        if known is None:
            return
        gain = np.ones(known.radiance.shape[-1])
        if index and self.frames.done[index - 1]:
            gain = change(merger, known, self.frames.read(index - 1, index)).gain
        if _is_doubtful(change(merger, known, bracket), gain):
            where = f"{name_of(self.level)}, before pattern {position}"
            self._repeat(merger, known, where, index, bracket)

    def _repeat(
        self, merger: Merger, known: Merged, where: str, index: int, bracket: NDArray[Any]
    ) -> None:
        """Repeat a look that differs; log what changed, or raise CaptureError."""
        takes = [bracket, self.looks.take(index, index + 1)]
        if _scatter(takes, merger) is not None:
            takes += [self.looks.take(index, index + 1) for _ in range(_REPETITIONS)]
            unsteady = _unsteady(takes, merger)
            if unsteady is not None and unsteady.exceeds(CAPTURE):
                self._end(f"{where}: {unsteady.text}")
                return
        first, last = (change(merger, known, each) for each in (takes[0], takes[-1]))
        room = room_fault(abs(last.room), "since the first look")
        if room.exceeds(NOTED):
            self._end(f"{where}: {room.text}", is_harmful=room.exceeds(CAPTURE))
        elif max(first.rest, last.rest) > CAPTURE.moved:
            self._say_moved(where, max(first.rest, last.rest), is_lasting=last.rest > CAPTURE.moved)

    def _say_moved(self, where: str, rest: float, *, is_lasting: bool) -> None:
        """Log that the rig or the scene moved, or raise CaptureError."""
        fault = moved_fault(rest)
        if is_lasting:
            self._end(f"{where}: {fault.text}. Pictures from before and after don't fit together")
        else:
            _log.warning(
                "%s: %s; but not once more: patterns before may show what passed",
                where, fault.change,
            )  # fmt: skip

    def _end(self, text: str, *, is_harmful: bool = True) -> None:
        """Raise CaptureError for what spoils the capture if that is to end it, else log it."""
        if not (self.refuse and is_harmful):
            _log.warning("%s", text)
            return
        folder = self.of_level.folder
        raise CaptureError(f"{text}. The capture ends here; {recovery_advice(folder, self.level)}")

    def entries(self) -> dict[str, Any]:
        """Entries of the looks in the level's manifest."""
        return {CHECK_PICTURES: {**self.looks.entry(self.frames), "interval": self.every}}


def _is_doubtful(shown: Change, before: Double) -> bool:
    """Test whether a look differs by more than a lamp that drifts changes it.

    `before` is the brightness (C,) at the look before.
    """
    jump = np.abs(shown.gain - before) - SIGNIFICANCE * np.sqrt(2) * shown.deviation
    return shown.rest > CAPTURE.moved or abs(shown.room) > NOTED.room or bool((jump > _JUMP).any())


def _scatter(takes: Sequence[NDArray[Any]], merger: Merger) -> Fault | None:
    """Find a change of gain, lamp or queue between looks that were taken one after another."""
    camera = camera_of(merger.sensor)
    return None if camera is None else scatter_of(_samples(takes, merger), camera)


def _unsteady(takes: Sequence[NDArray[Any]], merger: Merger) -> Fault | None:
    """Find what changes between looks except their shape; None where that changes, too."""
    scatter, camera = _scatter(takes, merger), camera_of(merger.sensor)
    is_certain = scatter is not None and scatter.kind in ("flicker", "late")
    unsteady = scatter if is_certain else _room_between(takes, merger) or scatter
    if unsteady is None or unsteady.kind == "late" or camera is None:
        return unsteady
    return None if motion_of(_samples(takes, merger), camera) is not None else unsteady


def _room_between(takes: Sequence[NDArray[Any]], merger: Merger) -> Fault | None:
    """Find light of the room that changes between looks taken one after another."""
    first = merger.merge(takes[0], 0)
    room = [change(merger, first, each).room for each in takes[1:]]
    fault = room_fault(max(map(abs, room)), f"in {len(takes)} pictures")
    return fault if fault.exceeds(NOTED) else None


def _samples(takes: Sequence[NDArray[Any]], merger: Merger) -> Samples:
    return Samples(np.stack([sample(each[0]) for each in takes]), sample(merger.black))
