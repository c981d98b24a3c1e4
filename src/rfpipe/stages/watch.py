"""Watch over a capture by check pictures, taken between the patterns of a level.

A check picture that differs from the first one is repeated, to name the cause of the change: see
`rfpipe.references.comparison`, and `rfpipe.references.repeats`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.errors import CaptureError, IntegrityError, StoreError
from rfpipe.photometry.sensor import MergedImages
from rfpipe.references.check_pictures import (
    check_pattern,
    check_picture_count,
    first_check_picture,
    recovery_advice,
)
from rfpipe.references.comparison import Difference, compare_pictures
from rfpipe.references.reference_images import ReferenceImages, read_references
from rfpipe.references.repeats import fault_of_repeats, gain_fault_of_repeats
from rfpipe.rigs import Rig
from rfpipe.rigs.faults import CAPTURE, NOTED, SIGNIFICANCE, moved_fault, room_fault
from rfpipe.stages.brackets import BracketSet, Keys, open_recording, take_brackets
from rfpipe.storage.base import CHECK_PICTURES, Storage, StoredPictures, level_name
from rfpipe.units import CHECK_PICTURE_KEY

_MAX_STEP = 0.01
"""Relative change of brightness from one check picture to the next above which it is repeated."""

_MORE_REPEATS = 2
"""Number of further repeats where the first repeat shows unsteady gain."""

_log = logging.getLogger(__name__)


@contextmanager
def watching_level(
    rig: Rig, storage: Storage, level_brackets: BracketSet, mode: str = "off", interval: int = 0
) -> Iterator[Watcher | None]:
    """Provide the watcher of a level's capture; None for none.

    A capture that is resumed keeps the interval with which it began, or stays without check
    pictures.

    Parameters
    ----------
    rig : Rig
    storage : Storage
    level_brackets : BracketSet
        Brackets of the level's patterns.
    mode : {"off", "warn", "refuse"}
        Reaction to a change of rig or light: "refuse" ends the capture.
    interval : int
        Patterns from one check picture to the next, 0 for no check pictures.
    """
    level = level_brackets.level
    interval = _interval(storage, level_brackets, interval if mode != "off" else 0)
    if not interval:
        yield None
        return
    pattern = check_pattern(rig.projector_shape)

    def repeated(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        keys: Keys = [(CHECK_PICTURE_KEY, level, index) for index in range(first, last)]
        return np.repeat(pattern[None], last - first, axis=0), keys

    settings = {
        "interval": interval,
        "level_fingerprint": level_brackets.fingerprint,
        "rig": level_brackets.settings["rig"],
    }
    check_brackets = BracketSet(
        level, CHECK_PICTURES, f"{level_name(level)}, check pictures",
        check_picture_count(level_brackets.count, interval), settings, repeated,
    )  # fmt: skip
    storage.make_room(level, CHECK_PICTURES, check_brackets.fingerprint, settings, "recapture")
    with open_recording(rig, storage, check_brackets) as store:
        references = None
        if storage.exists(0, "merge"):
            references = read_references(rig.sensor, storage)
        yield Watcher(
            rig, storage, level_brackets, references, check_brackets, store, interval,
            is_refusing=mode == "refuse",
        )  # fmt: skip


def _interval(storage: Storage, level_brackets: BracketSet, interval: int) -> int:
    """Return the interval of a new capture, or the one with which the capture began."""
    if level_brackets.count_missing(storage) == level_brackets.count:
        return interval if level_brackets.count else 0
    try:
        with storage.partial_brackets(level_brackets.level, CHECK_PICTURES) as store:
            if store.attributes.get("level_fingerprint") == level_brackets.fingerprint:
                return int(store.attributes["interval"])
    except IntegrityError:
        raise
    except StoreError:  # begun without check pictures
        pass
    return 0


@dataclass(frozen=True)
class Watcher:
    """Captures and compares the check pictures of a level.

    Attributes
    ----------
    rig : Rig
    storage : Storage
    level_brackets : BracketSet
        Brackets of the level's patterns.
    references : ReferenceImages or None
        None before level 0 is merged; check pictures are not compared then.
    check_brackets : BracketSet
        Brackets of the check pictures.
    store : StoredPictures
        The check pictures so far, open for writing.
    interval : int
        Patterns from one check picture to the next.
    is_refusing : bool
        Whether a harmful change ends the capture, or is logged.
    """

    rig: Rig
    storage: Storage
    level_brackets: BracketSet
    references: ReferenceImages | None
    check_brackets: BracketSet
    store: StoredPictures
    interval: int
    is_refusing: bool

    def due(self, first: int, last: int) -> range:
        """Return the positions between two patterns at which a check picture is due."""
        return range((first // self.interval + 1) * self.interval, last, self.interval)

    def before(self, position: int) -> None:
        """Take the check picture before the pattern at `position`, or after the last pattern.

        After the last pattern there may be none, see `check_picture_count`.

        Raises
        ------
        CaptureError
            If gain, room light or rig changed and the watcher refuses that. The check picture isn't
            stored then: the next run takes it first.
        """
        index = min(-(-position // self.interval), self.check_brackets.count - 1)
        if self.store.done[index]:
            return
        bracket = self._take(index)
        if self.references is not None:
            self._compare(self.references, position, index, bracket)
        self.store.write(index, bracket)

    def entries(self) -> dict[str, Any]:
        """Return the entries of the check pictures for the level's manifest."""
        entry = self.check_brackets.entry(self.store)
        return {CHECK_PICTURES: {**entry, "interval": self.interval}}

    def _take(self, index: int) -> NDArray[Any]:
        return take_brackets(self.rig, self.check_brackets, index, index + 1)

    def _compare(
        self, references: ReferenceImages, position: int, index: int, bracket: NDArray[Any]
    ) -> None:
        """Compare a check picture with the first one; examine a difference beyond drift."""
        first = first_check_picture(self.storage, references)
        if first is None:
            return
        previous_gain = np.ones(first.radiance.shape[-1])
        if index and self.store.done[index - 1]:
            previous = self.store.read(index - 1, index)
            previous_gain = compare_pictures(references, first, previous).gain
        if _exceeds_drift(compare_pictures(references, first, bracket), previous_gain):
            place = f"{level_name(self.level_brackets.level)}, before pattern {position}"
            self._examine(references, first, place, index, bracket)

    def _examine(
        self,
        references: ReferenceImages,
        first: MergedImages,
        place: str,
        index: int,
        bracket: NDArray[Any],
    ) -> None:
        """Repeat a check picture that differs; log the cause, or raise CaptureError."""
        repeats = [bracket, self._take(index)]
        if gain_fault_of_repeats(repeats, references) is not None:
            repeats += [self._take(index) for _ in range(_MORE_REPEATS)]
            fault = fault_of_repeats(repeats, references)
            if fault is not None and fault.exceeds(CAPTURE):
                self._report(index, f"{place}: {fault.text}")
                return
        before, after = (
            compare_pictures(references, first, repeat) for repeat in (repeats[0], repeats[-1])
        )
        room = room_fault(abs(after.room), "since the first check picture")
        if room.exceeds(NOTED):
            self._report(index, f"{place}: {room.text}", is_harmful=room.exceeds(CAPTURE))
        elif max(before.residual, after.residual) > CAPTURE.moved:
            self._report_motion(index, place, before.residual, after.residual)

    def _report_motion(self, index: int, place: str, before: float, after: float) -> None:
        """Report motion, by the residuals of a check picture and of its last repeat."""
        fault = moved_fault(max(before, after))
        if after > CAPTURE.moved:
            text = f"{place}: {fault.text}. Pictures from before and after are inconsistent"
            self._report(index, text)
        else:
            _log.warning(
                "%s: %s; its repeat looks normal, so something passed briefly: the pictures before "
                "this check picture may show it",
                place, fault.change,
            )  # fmt: skip

    def _report(self, index: int, text: str, *, is_harmful: bool = True) -> None:
        """Raise CaptureError for a harmful change if the watcher refuses it, else log it.

        What a level's first check picture shows may have happened during the level before.
        """
        if not (self.is_refusing and is_harmful):
            _log.warning("%s", text)
            return
        level = self.level_brackets.level
        advice = recovery_advice(self.storage, level if index else max(0, level - 1))
        raise CaptureError(f"{text}. The capture ends here", remedy=advice)


def _exceeds_drift(difference: Difference, previous_gain: Double) -> bool:
    """Test whether a check picture differs by more than the drift of a lamp.

    `previous_gain` is the gain (C,) of the previous check picture.
    """
    noise = SIGNIFICANCE * np.sqrt(2) * difference.deviation
    step = np.abs(difference.gain - previous_gain) - noise
    is_room = abs(difference.room) > NOTED.room
    return difference.residual > CAPTURE.moved or is_room or bool((step > _MAX_STEP).any())
