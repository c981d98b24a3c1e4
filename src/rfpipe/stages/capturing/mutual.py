"""Whether a coaxial rig still is one, by the pictures that its acquisition takes anyway."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, StoreError
from rfpipe.photometry.reciprocity import Reciprocity, Residual
from rfpipe.photometry.sensor import Merged
from rfpipe.stages.capturing.brackets import Brackets
from rfpipe.stages.capturing.watch import merger_before
from rfpipe.stages.folder import AcquisitionFolder, name_of
from rfpipe.stages.merging.merger import Merger
from rfpipe.stages.merging.raw import RawFrames
from rfpipe.stages.schedule import read_schedule
from rfpipe.store import FrameStore

__all__ = ["MUTUAL", "MutualCapture", "MutualWatch", "Tally", "mutual_watch"]

MUTUAL = "reciprocity"
"""What was found, in a level's manifest."""

# Pictures of a level above that new ones are held against: as many as are held at all.
_OF_A_LEVEL = 24

_log = logging.getLogger(__name__)


@dataclass
class Tally:
    """What the pictures of a level told of reciprocity.

    Parameters
    ----------
    name : str
        Of the level, for messages.
    worth_a_word : float
        Error in a picture from which on it is said.
    refuse : bool
        Whether to end the capture there.
    silent : bool
        Whether it has been said already.
    """

    name: str
    worth_a_word: float
    refuse: bool
    silent: bool = False
    judged: int = 0
    is_in_order: bool = True
    deviations: float = 0.0
    error: float = 0.0
    first: int | None = None

    def add(self, index: int, found: Residual) -> None:
        """Enter what one picture told.

        Raises
        ------
        CaptureError
            When it is wrong, and that is to end the capture.
        """
        self.is_in_order &= index == self.judged
        self.judged += 1
        self.deviations = max(self.deviations, found.deviations)
        if not found.is_wrong(self.worth_a_word):
            return
        self.error = max(self.error, found.error)
        is_first, self.first = self.first is None, index if self.first is None else self.first
        text = (
            f"{self.name}, pattern {index}: light doesn't go from camera to projector as it comes "
            f"({found.deviations:.0f} standard deviations): taking the rig for a coaxial one makes "
            f"an error of at least {found.error:.1%} in this picture"
        )
        if self.refuse:
            raise CaptureError(
                f"{text}. The two devices are not aligned any more, or never were. What is "
                "captured is kept: align them and remove the acquisition's folder to begin anew, "
                "or use a method for any rig, such as dual photography; capture.watch: warn goes "
                "on regardless"
            )
        if is_first and not self.silent:
            _log.warning(
                "%s. The two devices are not aligned any more, or never were; capture.watch: "
                "refuse would stop here", text,
            )  # fmt: skip

    def facts(self) -> dict[str, Any]:
        """Return plain data for a manifest."""
        return {
            "judged": self.judged,
            "deviations": float(f"{self.deviations:.4g}"),
            "error": float(f"{self.error:.4g}"),
            "first": self.first,
        }


@dataclass(frozen=True)
class MutualWatch:
    """Holds the merged pictures of a level against each other and those of the levels above.

    Parameters
    ----------
    reciprocity : Reciprocity
    patterns : callable
        ``patterns(first, last)`` returns these patterns of the level.
    tally : Tally
    """

    reciprocity: Reciprocity
    patterns: Callable[[int, int], NDArray[np.float32]]
    tally: Tally

    def judge(self, first: int, merged: Merged) -> None:
        """Judge merged pictures, from pattern `first` on."""
        patterns = self.patterns(first, first + len(merged.radiance))
        for offset, pattern in enumerate(patterns):
            image = merged.radiance[offset], merged.variance[offset]
            self.tally.add(first + offset, self.reciprocity.judge(pattern, *image))


@dataclass(frozen=True)
class MutualCapture:
    """Judges the brackets of a level as they are captured.

    Parameters
    ----------
    watch : MutualWatch
    merger : Merger
    again : callable
        Returns another one that has judged the level from its first pattern on.
    """

    watch: MutualWatch
    merger: Merger
    again: Callable[[], MutualCapture | None]
    name: str = field(default=MUTUAL, init=False)

    def due(self, first: int, last: int) -> Sequence[int]:  # noqa: ARG002
        """Take nothing between patterns."""
        return ()

    def before(self, position: int) -> None:
        """Take nothing before any."""

    def after(self, first: int, brackets: NDArray[Any]) -> None:
        """Judge what was captured."""
        self.watch.judge(first, self.merger.merge(brackets, first))

    def entry(self) -> dict[str, Any]:
        """Return what the level's manifest says: the same however the capture went."""
        in_order = self if self.watch.tally.is_in_order else self.again()
        return (in_order or self).watch.tally.facts()


def mutual_watch(
    level_brackets: Brackets,
    folder: AcquisitionFolder,
    level: int,
    worth_a_word: float,
    *,
    refuse: bool,
    silent: bool = False,
) -> MutualCapture | None:
    """Return the watch of a level that believes in symmetry; None before level 0 is merged.

    Parameters
    ----------
    level_brackets : Brackets
        Of the level's patterns; what of them is captured is judged at once.
    folder : AcquisitionFolder
    level : int
    worth_a_word : float
        Error in a picture, relative, from which on it is said.
    refuse : bool
        Whether to end the capture there.
    silent : bool
        Whether it has been said already.
    """
    merger = merger_before(level_brackets, folder)
    if merger is None or not merger.floodlit.any() or not level_brackets.count:
        return None
    reciprocity = Reciprocity(merger.floodlit, merger.floodlit_variance)
    for above in range(1, level):
        _enter(reciprocity, folder, above)
    tally = Tally(name_of(level), worth_a_word, refuse, silent)
    again = partial(
        mutual_watch, level_brackets, folder, level, worth_a_word, refuse=False, silent=True
    )
    schedule = read_schedule(folder, level)
    watch = MutualCapture(MutualWatch(reciprocity, schedule.batch, tally), merger, again)
    if level_brackets.path.exists():
        if RawFrames(folder, level, "capture").dropped:
            return None
        _judge_captured(watch, level_brackets.path)
    return watch


def _judge_captured(watch: MutualCapture, store: Path) -> None:
    """Judge what of a level is captured; what is damaged will be captured, and judged, again."""
    with FrameStore.open(store) as frames:
        for index in map(int, np.flatnonzero(frames.done)):
            try:
                brackets = frames.read(index, index + 1)
            except StoreError:
                continue
            watch.after(index, brackets)


def _enter(reciprocity: Reciprocity, folder: AcquisitionFolder, level: int) -> None:
    """Make witnesses of a level's first pictures."""
    try:
        schedule = read_schedule(folder, level)
        count = min(schedule.count, _OF_A_LEVEL)
        if not count:
            return
        with folder.frames(level, "merge") as frames:
            images = frames.read(0, count)
    except StoreError:
        return
    for pattern, (radiance, variance) in zip(schedule.batch(0, count), images, strict=True):
        reciprocity.judge(pattern, radiance, variance)
