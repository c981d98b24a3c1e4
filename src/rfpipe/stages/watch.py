"""What watches a capture: a fine random pattern, again and again between the patterns of a level.

It tells what the lamp does and whether the rig moved: half a pixel changes every ray of it by half.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.symmetry import random_signs
from rfpipe.errors import CaptureError, StoreError
from rfpipe.photometry.sensor import Merged
from rfpipe.stages.brackets import Brackets, Keys
from rfpipe.stages.folder import AcquisitionFolder, name_of
from rfpipe.stages.merger import Merger, read_merger
from rfpipe.store import FrameStore, restore_header
from rfpipe.units import LOOK_KEY

MOVES = "moves"
"""The repeated random pattern of a level: its store and its key in manifests."""

# Standard deviations from which on a change counts as one.
_SIGNIFICANCE = 5.0
# A change of the picture, relative to its norm, that is worth a word: half a pixel makes fifty
# times as much, and a lamp that changes here and there a tenth.
_MOVED = 0.02
# What the noise itself is known to, as a share of its square.
_NOISE_KNOWN = 0.1
Double = NDArray[np.float64]

_log = logging.getLogger(__name__)


def look_count(patterns: int, every: int) -> int:
    """Return the looks at a level: one before each `every` patterns, and one after the last."""
    return -(-patterns // every) + 1


def look_positions(patterns: int, every: int) -> Double:
    """Return before which pattern each look is taken."""
    return np.minimum(np.arange(look_count(patterns, every)) * every, patterns).astype(np.float64)


class Change(NamedTuple):
    """How a bracket differs from a picture of the same pattern.

    Attributes
    ----------
    gain, deviation : ndarray of float64, shape (C,)
        Its light relative to the picture's, and the standard deviation.
    rest : float
        What differs beyond brightness and noise, relative to the picture's norm; 0 where nothing.
    """

    gain: Double
    deviation: Double
    rest: float


def change(merger: Merger, known: Merged, bracket: NDArray[Any]) -> Change:
    """Compare a bracket (1, E, ...) with a merged picture (1, *camera_shape, C)."""
    later = merger.merge(bracket, 0)
    both = np.isfinite(known.variance[0]) & np.isfinite(later.variance[0])
    was, now, v_was, v_now = (
        np.where(both, image[0], 0).reshape(-1, image.shape[-1]).astype(np.float64)
        for image in (known.radiance, later.radiance, known.variance, later.variance)
    )
    total = was.sum(axis=0)
    over = np.where(total > 0, total, 1)
    gain = np.where(total > 0, now.sum(axis=0) / over, 1)
    noise = v_now + gain**2 * v_was
    square = float(np.square(now - gain * was).sum() - noise.sum())
    chance = _SIGNIFICANCE * np.sqrt(2 * np.square(noise).sum()) + _NOISE_KNOWN * noise.sum()
    light = float((np.square(gain * was) - gain**2 * v_was).sum())
    rest = np.sqrt(square / light) if light > 0 and square > chance else 0.0
    return Change(gain, np.sqrt(noise.sum(axis=0)) / over, float(rest))


def _first_look(folder: AcquisitionFolder, merger: Merger) -> Merged | None:
    """Return the acquisition's first look, which others are compared with, or None."""
    for store in sorted(folder.path.glob(f"L[0-9]*/{MOVES}.zarr")):
        try:
            with FrameStore.open(store) as frames:
                return merger.merge(frames.read(0, 1), 0)
        except StoreError:  # not taken yet, or damaged
            continue
    return None


def measure_looks(
    folder: AcquisitionFolder, merger: Merger, level: int, *, divide_out: bool
) -> tuple[Double | None, dict[str, Any]]:
    """Measure what the looks at a level tell, and log a change of the light.

    Returns brightness at each pattern to divide by, float64 (patterns, C), None not to divide; and
    facts for the manifest.
    """
    captured = folder.read_manifest(level, "capture")
    known = _first_look(folder, merger) if MOVES in captured else None
    if known is None:
        return None, {}
    every = captured[MOVES]["every"]
    with folder.frames(level, "capture", MOVES) as frames:
        taken = (frames.read(n, n + 1) for n in range(frames.shape[0]))
        looks = [change(merger, known, bracket) for bracket in taken]
    gain = np.stack([look.gain for look in looks])
    deviation = np.stack([look.deviation for look in looks])
    rest = [float(f"{look.rest:.4g}") for look in looks]
    facts = {
        "every": every, "gain": gain.tolist(), "deviation": deviation.tolist(),
        "change": rest, "moved": max(rest) > _MOVED, "divided_out": divide_out,
    }  # fmt: skip
    span, noise = np.ptp(gain, axis=0), deviation.max(axis=0)
    if (span > _SIGNIFICANCE * np.sqrt(2) * noise).any():
        advice = "it is divided out" if divide_out else "merge.divide_out_drift would divide it out"
        _log.warning(
            "%s: the light changed by %.2g %% (noise %.2g %%) in %d looks; %s",
            name_of(level), 100 * span.max(), 100 * noise.max(), len(gain), advice,
        )  # fmt: skip
    if not divide_out:
        return None, {MOVES: facts}
    at, looked = np.arange(captured["patterns"]) + 0.5, look_positions(captured["patterns"], every)
    gains = np.stack([np.interp(at, looked, of_channel) for of_channel in gain.T], axis=1)
    return gains, {MOVES: facts}


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
    path = of_level.folder.store(level, MOVES)
    every = _interval(of_level, path, looks if mode != "off" else 0)
    if not every:
        yield None
        return
    lit = random_signs(of_level.rig.projector_shape, 1, seed=15)[0] > 0
    pattern = np.asarray(lit if lit.any() else ~lit, np.float32)

    def repeated(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        keys: Keys = [(LOOK_KEY, level, index) for index in range(first, last)]
        return np.repeat(pattern[None], last - first, axis=0), keys

    about = {"every": every, "made_beside": of_level.made_for, "rig": of_level.shown["rig"]}
    brackets = Brackets(
        of_level.rig, of_level.folder, path, f"{name_of(level)}, looks at the rig",
        look_count(of_level.count, every), about, repeated,
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
                return int(begun.attributes["every"])
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

        Raises CaptureError where it shows, and once more, that the rig moved, and that is to end
        the capture. That look isn't stored: the next run begins by taking it again.
        """
        is_last = position == self.of_level.count
        index = self.looks.count - 1 if is_last else position // self.every
        if self.frames.done[index]:
            return
        bracket = self.looks.take(index, index + 1)
        rest = self._change(bracket)
        if rest > _MOVED:
            again = self._change(self.looks.take(index, index + 1))
            self._say(position, rest, again > _MOVED)
        self.frames.write(index, bracket)

    def _say(self, position: int, rest: float, is_lasting: bool) -> None:
        """Log what a look shows, or raise CaptureError."""
        text = (
            f"{name_of(self.level)}, before pattern {position}: the same pattern looks different "
            f"by {rest:.1%} from how it looked first, whatever the lamp does"
        )
        if not is_lasting:
            text += ", but not once more: patterns before may show what passed"
        else:
            text += (
                ": the rig or the scene moved. Pictures from before and after don't fit together"
            )
        if is_lasting and self.refuse:
            folder = self.of_level.folder
            if not folder.is_kept:
                raise CaptureError(f"{text}. Put back what moved, and acquire again")
            raise CaptureError(
                f"{text}, so the capture ends here; all that is captured is kept. To begin anew: "
                f"'{folder.retaking()}', with the run's other options. Or put back what moved: "
                f"'{folder.retaking(self.level)}' takes this level alone again, if the pattern "
                "looks as it did first. capture.watch: warn goes on all the same"
            )
        _log.warning("%s", text)

    def _change(self, bracket: NDArray[Any]) -> float:
        """Return by what a look differs from the first one, 0 where none is known."""
        known = _first_look(self.of_level.folder, self.merger) if self.merger else None
        return change(self.merger, known, bracket).rest if self.merger and known else 0.0

    def entries(self) -> dict[str, Any]:
        """Return what the level's manifest says of the looks."""
        return {MOVES: {**self.looks.entry(self.frames), "every": self.every}}
