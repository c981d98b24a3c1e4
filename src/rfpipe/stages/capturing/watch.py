"""The drift watch of a capture: floodlit brackets between the patterns of a level."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.rigs import DRIFT_KEY
from rfpipe.stages.capturing.brackets import Brackets
from rfpipe.stages.capturing.drift import DRIFT, item_count, item_due, look
from rfpipe.stages.capturing.shown import Keys
from rfpipe.stages.folder import AcquisitionFolder, name_of
from rfpipe.stages.merging.merger import Merger
from rfpipe.stages.merging.references import read_merger
from rfpipe.store import FrameStore, restore_header

__all__ = ["DriftWatch", "watch_of"]

# For messages while the capture goes on; the merge measures with its own settings.
_SATURATION_FRACTION = 0.98

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DriftWatch:
    """Takes the looks of one level, and says what each shows.

    Parameters
    ----------
    brackets : Brackets
        The looks.
    frames : FrameStore
        Theirs, opened.
    patterns, every : int
        Of the level, and from one look to the next.
    merger : Merger or None
        Calibrated by level 0, if that has been merged.
    """

    brackets: Brackets
    frames: FrameStore
    patterns: int
    every: int
    merger: Merger | None

    def before(self, position: int) -> None:
        """Take the look that is due before the pattern at `position`, or after the last one."""
        due = item_due(position, self.patterns, self.every)
        if self.frames.done[due]:
            return
        bracket = self.brackets.take(self.frames, due, due + 1)
        if self.merger is None:
            return
        gain, deviation, local = look(self.merger, bracket, due)
        _log.info(
            "drift watch before pattern %d: %s of the floodlit image's light (noise %.2g %%); "
            "parts of the image differ by up to %.2g %%",
            position, ", ".join(f"{100 * part:.2f} %" for part in gain),
            100 * deviation.max(), 100 * float(local),
        )  # fmt: skip

    def entry(self) -> dict[str, Any]:
        """Return what the level's manifest says of the looks."""
        return {**self.brackets.entry(self.frames), "every": self.every}


@contextmanager
def watch_of(
    level_brackets: Brackets, folder: AcquisitionFolder, level: int, every: int
) -> Iterator[DriftWatch | None]:
    """Provide the drift watch of a level, None where there is to be none.

    A level that was begun with a watch goes on with it, as it was; one that was begun without has
    none, since looks at its first part can't be taken afterwards.

    Parameters
    ----------
    level_brackets : Brackets
        Of the level's patterns; their store, if there is one, is that of this capture.
    folder : AcquisitionFolder
    level : int
    every : int
        Patterns from one look to the next, 0 for no watch.
    """
    path, patterns = folder.store(level, DRIFT), level_brackets.count
    is_begun = level_brackets.count_missing() < patterns
    if is_begun and path.exists():
        restore_header(path)
        with FrameStore.open(path) as old:
            of_this_capture = old.attributes.get("made_beside") == level_brackets.made_for
            every = int(old.attributes["every"]) if of_this_capture else 0
    elif is_begun and every:
        _log.warning("%s was begun without a drift watch, and goes on without", name_of(level))
        every = 0
    if not every or not patterns:
        yield None
        return
    rig = level_brackets.rig
    white = np.ones((1, *rig.projector_shape), np.float32)

    def floodlit(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        keys: Keys = [(DRIFT_KEY, level, index) for index in range(first, last)]
        return np.repeat(white, last - first, axis=0), keys

    count = item_count(patterns, every)
    shown = {
        "every": every,
        "made_beside": level_brackets.made_for,
        "rig": level_brackets.shown["rig"],
    }
    brackets = Brackets(rig, path, f"{name_of(level)}, drift watch", count, shown, floodlit)
    brackets.settle("recapture")
    merger = None
    if folder.manifest(0, "merge").exists():
        merger = read_merger(rig.sensor, folder, _SATURATION_FRACTION)
    with brackets.opened() as frames:
        yield DriftWatch(brackets, frames, patterns, every, merger)
