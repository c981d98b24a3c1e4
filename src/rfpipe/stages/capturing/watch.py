"""What watches a capture: brackets taken between the patterns of a level, and what they tell.

The floodlit image again and again tells what the lamp does (`drift`); a fine random pattern, again
and again, whether the rig moved (`moves`); the patterns of a coaxial rig themselves, for nothing,
whether it still is one (`mutual`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.keys import DRIFT_KEY, LOOK_KEY
from rfpipe.stages.capturing import moves
from rfpipe.stages.capturing.brackets import Brackets, Watch
from rfpipe.stages.capturing.drift import DRIFT, item_count, item_due, look
from rfpipe.stages.capturing.moves import MOVES, move_pattern
from rfpipe.stages.capturing.shown import Keys
from rfpipe.stages.folder import AcquisitionFolder, name_of
from rfpipe.stages.merging.merger import Merger
from rfpipe.stages.merging.references import read_merger
from rfpipe.store import FrameStore, restore_header
from rfpipe.units import SATURATION_FRACTION

__all__ = ["LookWatch", "Watches", "drift_watch", "merger_before", "move_watch"]

_log = logging.getLogger(__name__)

_Tell = Callable[[int, int, NDArray[Any]], None]
"""``tell(position, index, bracket)`` says what a look shows; it may refuse to go on."""


@dataclass(frozen=True)
class LookWatch:
    """Takes the looks of one level, and says what each shows.

    Parameters
    ----------
    name : str
        Of their store, and their key in the level's manifest.
    brackets : Brackets
        The looks.
    frames : FrameStore
        Theirs, opened.
    patterns, every : int
        Of the level, and from one look to the next.
    tell : callable
    """

    name: str
    brackets: Brackets
    frames: FrameStore
    patterns: int
    every: int
    tell: _Tell

    def due(self, first: int, last: int) -> Sequence[int]:
        """Return the positions between two patterns at which a look is due."""
        return range((first // self.every + 1) * self.every, last, self.every)

    def before(self, position: int) -> None:
        """Take the look that is due before the pattern at `position`, or after the last one."""
        index = item_due(position, self.patterns, self.every)
        if not self.frames.done[index]:
            self.tell(position, index, self.brackets.take(self.frames, index, index + 1))

    def after(self, first: int, brackets: NDArray[Any]) -> None:
        """Learn nothing from the level's own patterns."""

    def entry(self) -> dict[str, Any]:
        """Return what the level's manifest says of the looks."""
        return {**self.brackets.entry(self.frames), "every": self.every}


@dataclass(frozen=True)
class Watches:
    """Several watches as one."""

    watches: Sequence[Watch]

    def due(self, first: int, last: int) -> Sequence[int]:
        """Return where any of them takes something."""
        return sorted({at for watch in self.watches for at in watch.due(first, last)})

    def before(self, position: int) -> None:
        """Take what is due."""
        for watch in self.watches:
            watch.before(position)

    def after(self, first: int, brackets: NDArray[Any]) -> None:
        """Show all of them what was captured."""
        for watch in self.watches:
            watch.after(first, brackets)


def merger_before(brackets: Brackets, folder: AcquisitionFolder) -> Merger | None:
    """Return what level 0 learnt, None where it isn't merged yet."""
    if not folder.manifest(0, "merge").exists():
        return None
    return read_merger(brackets.rig.sensor, folder, SATURATION_FRACTION)


@contextmanager
def drift_watch(
    level_brackets: Brackets, folder: AcquisitionFolder, level: int, every: int
) -> Iterator[LookWatch | None]:
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
    merger = merger_before(level_brackets, folder)

    def tell(position: int, index: int, bracket: NDArray[Any]) -> None:
        if merger is None:
            return
        gain, deviation, local = look(merger, bracket, index)
        _log.info(
            "drift watch before pattern %d: %s of the floodlit image's light (noise %.2g %%); "
            "parts of the image differ by up to %.2g %%",
            position, ", ".join(f"{100 * part:.2f} %" for part in gain),
            100 * deviation.max(), 100 * float(local),
        )  # fmt: skip

    white = np.ones(level_brackets.rig.projector_shape, np.float32)
    shown = _Shown(DRIFT, "drift watch", DRIFT_KEY, white)
    with _looks(shown, level_brackets, folder, level, every, tell) as watch:
        yield watch


@contextmanager
def move_watch(
    level_brackets: Brackets, folder: AcquisitionFolder, level: int, every: int, *, refuse: bool
) -> Iterator[LookWatch | None]:
    """Provide what tells whether the rig moved during a level, None where nothing is to.

    Parameters
    ----------
    level_brackets, folder, level, every
        As of `drift_watch`.
    refuse : bool
        Whether to end the capture where it moved.
    """
    merger = merger_before(level_brackets, folder)

    def tell(position: int, _index: int, bracket: NDArray[Any]) -> None:
        known = None if merger is None else moves.first_look(folder, merger)
        if known is None or merger is None:
            return
        found = moves.compare(merger, known, bracket)
        moves.told(found, f"{name_of(level)}, before pattern {position}", refuse=refuse)

    shown = _Shown(MOVES, "look at the rig", LOOK_KEY, move_pattern(level_brackets.rig))
    with _looks(shown, level_brackets, folder, level, every, tell) as watch:
        yield watch


@dataclass(frozen=True)
class _Shown:
    """What is shown again and again: its store's name, for messages, its key, and the pattern."""

    name: str
    title: str
    key: int
    pattern: NDArray[np.float32]


@contextmanager
def _looks(
    shown: _Shown,
    level_brackets: Brackets,
    folder: AcquisitionFolder,
    level: int,
    every: int,
    tell: _Tell,
) -> Iterator[LookWatch | None]:
    path, patterns = folder.store(level, shown.name), level_brackets.count
    is_begun = level_brackets.count_missing() < patterns
    if is_begun and path.exists():
        restore_header(path)
        with FrameStore.open(path) as old:
            of_this_capture = old.attributes.get("made_beside") == level_brackets.made_for
            every = int(old.attributes["every"]) if of_this_capture else 0
    elif is_begun and every:
        _log.warning("%s was begun without a %s, and goes on without", name_of(level), shown.title)
        every = 0
    if not every or not patterns:
        yield None
        return

    def repeated(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        keys: Keys = [(shown.key, level, index) for index in range(first, last)]
        return np.repeat(shown.pattern[None], last - first, axis=0), keys

    count = item_count(patterns, every)
    about = {
        "every": every,
        "made_beside": level_brackets.made_for,
        "rig": level_brackets.shown["rig"],
    }
    rig, title = level_brackets.rig, f"{name_of(level)}, {shown.title}"
    brackets = Brackets(rig, path, title, count, about, repeated)
    brackets.settle("recapture")
    with brackets.opened() as frames:
        yield LookWatch(shown.name, brackets, frames, patterns, every, tell)
