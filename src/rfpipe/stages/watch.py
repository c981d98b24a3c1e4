"""Watch over a capture: a fine random pattern, repeated between the patterns of a level.

A look y at the pattern is compared with the first look w, over C channels:

    y = g w + a + b f + d

====== ======= ======= =========================================================================
symbol code    shape   meaning
====== ======= ======= =========================================================================
w      known   (N, C)  the first look, over N rays
y      later   (N, C)  another look
f      white   (N, C)  the floodlit picture
g      gain    (C,)    brightness of the lamp
a, b   room    (C,)    light of the room: even, or as the scene reflects it
d      rest    ()      norm of the residual beyond noise, over w's: 1 for half a pixel
====== ======= ======= =========================================================================
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.symmetry import random_signs
from rfpipe.errors import CaptureError, StoreError
from rfpipe.photometry.sensor import Merged
from rfpipe.rigs.faults import (
    AUTOMATIC_OFF,
    CAPTURE,
    GAIN_CHANGES,
    NOTED,
    RIG_MOVED,
    SIGNIFICANCE,
    Fault,
    moved_fault,
    room_fault,
)
from rfpipe.stages.brackets import Brackets, Keys
from rfpipe.stages.folder import AcquisitionFolder, name_of
from rfpipe.stages.merger import Merger, read_merger
from rfpipe.stages.repeated import (
    Samples,
    camera_of,
    motion_of,
    sample,
    scatter_of,
    smooth_changes,
)
from rfpipe.store import FrameStore, restore_header
from rfpipe.units import LOOK_KEY

MOVES = "moves"
"""The repeated random pattern of a level: its store and its key in manifests."""

# What the noise itself is known to, as a share of its square.
_NOISE_KNOWN = 0.1
# Rays from which on room light and brightness are separable.
_FEWEST = 16
# Share of a change's norm that room light must explain at least: it explains a part of any other.
_EXPLAINED = 0.7
# Change of brightness from one look to the next after which the look is repeated.
_JUMP = 0.01
# Further repetitions of a look whose first one differs, too.
_REPETITIONS = 2
Double = NDArray[np.float64]

_log = logging.getLogger(__name__)


def look_count(patterns: int, every: int) -> int:
    """Return the looks at a level: one before each `every` patterns, and one after the last."""
    return -(-patterns // every) + 1


def look_positions(patterns: int, every: int) -> Double:
    """Return before which pattern each look is taken."""
    return np.minimum(np.arange(look_count(patterns, every)) * every, patterns).astype(np.float64)


class Change(NamedTuple):
    """Difference of a bracket from a picture of the same pattern.

    Attributes
    ----------
    gain, deviation : ndarray of float64, shape (C,)
        Its light relative to the picture's, and the standard deviation.
    rest : float
        What differs beyond brightness, room light and noise, relative to the picture's norm; 0
        where nothing.
    room : float
        Change of the room's light relative to the floodlit picture's; 0 unless it is significant.
    """

    gain: Double
    deviation: Double
    rest: float
    room: float = 0.0


def change(merger: Merger, known: Merged, bracket: NDArray[Any]) -> Change:
    """Compare a bracket (1, E, ...) with a merged picture (1, *camera_shape, C).

    The light of the room, a and b, is 0 unless it explains the residual of g alone.
    """
    later = merger.merge(bracket, 0)
    both = np.isfinite(known.variance[0]) & np.isfinite(later.variance[0])
    floodlit = merger.floodlit[None]
    was, now, v_was, v_now, white = (
        np.where(both, image[0], 0).reshape(-1, image.shape[-1]).astype(np.float64)
        for image in (known.radiance, later.radiance, known.variance, later.variance, floodlit)
    )
    total = was.sum(axis=0)
    over = np.where(total > 0, total, 1)
    gain = np.where(total > 0, now.sum(axis=0) / over, 1)
    noise = v_now + gain**2 * v_was
    deviation = np.sqrt(noise.sum(axis=0)) / over
    light = float((np.square(gain * was) - gain**2 * v_was).sum())
    rest = _beyond_noise(now - gain * was, noise, light)
    if rest == 0 or len(was) < _FEWEST:
        return Change(gain, deviation, rest)
    seen = both.reshape(-1, both.shape[-1]).all(axis=1)
    fitted, room, room_deviation, left = _with_room(*(it[seen] for it in (was, now, white, noise)))
    rest_of_fit = _beyond_noise(left, noise[seen], light)
    is_room = abs(room) > SIGNIFICANCE * room_deviation
    if is_room and rest_of_fit < (1 - _EXPLAINED) * rest:
        return Change(fitted, deviation, rest_of_fit, room)
    return Change(gain, deviation, rest)


def _beyond_noise(difference: Double, noise: Double, light: float) -> float:
    """Norm of a difference without its noise, relative to `light`; 0 for nothing but noise."""
    square = float(np.square(difference).sum() - noise.sum())
    chance = SIGNIFICANCE * np.sqrt(2 * np.square(noise).sum()) + _NOISE_KNOWN * noise.sum()
    return float(np.sqrt(square / light)) if light > 0 and square > chance else 0.0


def _with_room(
    was: Double, now: Double, white: Double, noise: Double
) -> tuple[Double, float, float, Double]:
    """Fit brightness and room light to images (N, C); see `change`.

    Returns
    -------
    gain : ndarray of float64, shape (C,)
    room, deviation : float
        Light of the room relative to `white`, and its standard deviation.
    residual : ndarray of float64, shape (N, C)
    """
    gain, residual = np.ones(was.shape[1]), now - was
    total, variance = 0.0, 0.0
    for channel in range(was.shape[1]):
        terms = np.stack([was[:, channel], np.ones(len(was)), white[:, channel]], axis=1)
        inverse = np.linalg.pinv(terms.T @ terms, rcond=1e-6, hermitian=True)
        solution = inverse @ terms.T @ now[:, channel]
        residual[:, channel] = now[:, channel] - terms @ solution
        gain[channel] = solution[0]
        mean = np.array([0, len(was), white[:, channel].sum()])
        spread = mean @ inverse @ (terms.T * noise[:, channel])
        total += float(mean @ solution)
        variance += float(spread @ terms @ inverse @ mean)
    over = float(white.sum()) or 1.0
    return gain, total / over, float(np.sqrt(max(variance, 0.0))) / over, residual


def first_look(folder: AcquisitionFolder, merger: Merger) -> Merged | None:
    """Merge the acquisition's first look, with which others are compared; None without one."""
    for level in folder.levels():
        try:
            with folder.open_frames(level, MOVES) as frames:
                if frames.done[0]:
                    return merger.merge(frames.read(0, 1), 0)
        except StoreError:  # not taken yet, or damaged
            continue
    return None


def measure_looks(
    folder: AcquisitionFolder,
    merger: Merger,
    level: int,
    *,
    divide_out: bool,
    is_steady: bool = True,
) -> tuple[Double | None, dict[str, Any]]:
    """Measure brightness and changes by the looks at a level, and log a change of the lamp.

    Brightness of gain that changes from picture to picture is not to be divided by: `is_steady` is
    whether the white pictures at the acquisition's beginning were steady.

    Returns brightness at each pattern to divide by, float64 (patterns, C), None not to divide; and
    facts for the manifest.
    """
    captured = folder.read_manifest(level, "capture")
    known = first_look(folder, merger) if MOVES in captured else None
    if known is None:
        return None, {}
    every = captured[MOVES]["every"]
    with folder.frames(level, "capture", MOVES) as frames:
        taken = (frames.read(n, n + 1) for n in range(frames.shape[0]))
        looks = [change(merger, known, bracket) for bracket in taken]
    gain = np.stack([look.gain for look in looks])
    deviation = np.stack([look.deviation for look in looks])
    is_moved = max(look.rest for look in looks) > CAPTURE.moved
    # brightness of another picture does not show gain
    is_steady &= is_moved or smooth_changes(*_series(folder, level, gain, captured))
    facts = {
        "every": every, "gain": gain.tolist(), "deviation": deviation.tolist(),
        "change": _rounded(look.rest for look in looks),
        "room": _rounded(look.room for look in looks),
        "moved": is_moved,
        "steady": is_steady, "divided_out": divide_out and is_steady,
    }  # fmt: skip
    _log_brightness(level, gain, deviation, facts, divide_out=divide_out)
    if not facts["divided_out"]:
        return None, {MOVES: facts}
    at, looked = np.arange(captured["patterns"]) + 0.5, look_positions(captured["patterns"], every)
    gains = np.stack([np.interp(at, looked, of_channel) for of_channel in gain.T], axis=1)
    return gains, {MOVES: facts}


def alarms_of(facts: dict[str, Any]) -> list[str]:
    """Describe what the looks at a level saw, from their facts in its merge's manifest."""
    alarms = [RIG_MOVED] if facts["moved"] else []
    if not facts.get("steady", True):
        alarms.append(GAIN_CHANGES)
    changes = [abs(change) for change in facts.get("room", [])]
    room = room_fault(max(changes, default=0.0), f"in {len(changes)} looks")
    if room.exceeds(CAPTURE):
        alarms.append(room.change)
    return alarms


def _rounded(values: Iterable[float]) -> list[float]:
    return [float(f"{value:.4g}") for value in values]


def _series(
    folder: AcquisitionFolder, level: int, gain: Double, captured: dict[str, Any]
) -> tuple[Double, Double]:
    """Brightness by all looks down to a level, (looks, C), and the pictures before each."""
    gains, times, before = [], [], 0.0
    for above in (*folder.levels_above(level), level):
        if above == level:
            of_level, every, patterns = gain, captured[MOVES]["every"], captured["patterns"]
        else:
            facts = folder.read_manifest(above, "merge")
            if MOVES not in facts:
                continue
            of_level = np.asarray(facts[MOVES]["gain"])
            every, patterns = facts[MOVES]["every"], facts["patterns"]
        gains.append(of_level)
        times.append(before + look_positions(patterns, every) + np.arange(len(of_level)))
        before += patterns + len(of_level)
    return np.concatenate(gains), np.concatenate(times)


def _log_brightness(
    level: int, gain: Double, deviation: Double, facts: dict[str, Any], *, divide_out: bool
) -> None:
    """Log a change of brightness (looks, C) beyond noise, and what becomes of it."""
    span, noise = np.ptp(gain, axis=0), deviation.max(axis=0)
    if not (span > SIGNIFICANCE * np.sqrt(2) * noise).any():
        return
    if facts["divided_out"]:
        advice = "it is divided out"
    elif divide_out:
        advice = f"{GAIN_CHANGES}, so that it can't be divided out: {AUTOMATIC_OFF}"
    else:
        advice = "merge.divide_out_drift would divide it out"
    _log.warning(
        "%s: the lamp's light changed by %.2g %% (noise %.2g %%) in %d looks; %s",
        name_of(level), 100 * span.max(), 100 * noise.max(), len(gain), advice,
    )  # fmt: skip


def look_pattern(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the random pattern that looks repeat, over the projector's rays."""
    lit = random_signs(shape, 1, seed=15)[0] > 0
    return np.asarray(lit if lit.any() else ~lit, np.float32)


def ways_on(folder: AcquisitionFolder, level: int, kind: str = "") -> str:
    """Describe ways on from a capture that ended at a level since the rig or its light changed.

    `kind` is the rig's.
    """
    if kind == "offline":
        return "mend it, and take the pictures again; capture.watch: warn goes on all the same"
    if not folder.is_kept:
        return "watch='warn' goes on all the same"
    ways = (
        f"all that is captured is kept. To begin anew: '{folder.retaking()}', with the run's other "
        "options. "
    )
    if level:
        ways += (
            f"Or put back what changed: '{folder.retaking(level)}' takes this level alone again, "
            "if the pattern looks as it did first. "
        )
    return f"{ways}capture.watch: warn goes on all the same"


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
    pattern = look_pattern(of_level.rig.projector_shape)

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

        Raises CaptureError where it shows, and repeated as well, that gain, light or rig changed,
        and that is to end the capture. That look isn't stored: the next run begins by taking it
        again.
        """
        is_last = position == self.of_level.count
        index = self.looks.count - 1 if is_last else position // self.every
        if self.frames.done[index]:
            return
        bracket = self.looks.take(index, index + 1)
        known = first_look(self.of_level.folder, self.merger) if self.merger else None
        if self.merger and known:
            shown = change(self.merger, known, bracket)
            if self._is_doubtful(shown, self._brightness_before(index, known)):
                self._repeat(position, index, bracket, known)
        self.frames.write(index, bracket)

    def _brightness_before(self, index: int, known: Merged) -> Double:
        """Brightness at the look before, 1 at the first one of a level."""
        if not index or not self.frames.done[index - 1]:
            return np.ones(known.radiance.shape[-1])
        assert self.merger is not None
        return change(self.merger, known, self.frames.read(index - 1, index)).gain

    def _is_doubtful(self, shown: Change, before: Double) -> bool:
        """Test whether a look differs by more than a lamp that drifts changes it."""
        jump = np.abs(shown.gain - before) - SIGNIFICANCE * np.sqrt(2) * shown.deviation
        return (
            shown.rest > CAPTURE.moved or abs(shown.room) > NOTED.room or bool((jump > _JUMP).any())
        )

    def _repeat(self, position: int, index: int, bracket: NDArray[Any], known: Merged) -> None:
        """Repeat a look that differs; log what changed, or raise CaptureError."""
        assert self.merger is not None
        takes = [bracket, self.looks.take(index, index + 1)]
        where = f"{name_of(self.level)}, before pattern {position}"
        if self._scatter(takes) is not None:
            takes += [self.looks.take(index, index + 1) for _ in range(_REPETITIONS)]
            unsteady = self._room_between(takes) or self._scatter(takes)
            is_moved = unsteady is not None and unsteady.kind != "late" and self._differ(takes)
            if not is_moved and unsteady is not None and unsteady.exceeds(CAPTURE):
                self._end(f"{where}: {unsteady.text}")
                return
        first, last = (change(self.merger, known, each) for each in (takes[0], takes[-1]))
        room = room_fault(abs(last.room), "since the first look")
        if room.exceeds(NOTED):
            self._end(f"{where}: {room.text}", is_harmful=room.exceeds(CAPTURE))
        elif max(first.rest, last.rest) > CAPTURE.moved:
            self._say_moved(where, max(first.rest, last.rest), is_lasting=last.rest > CAPTURE.moved)

    def _scatter(self, takes: Sequence[NDArray[Any]]) -> Fault | None:
        """Find what changes between looks that were taken one after another."""
        assert self.merger is not None
        camera = camera_of(self.merger.sensor)
        return None if camera is None else scatter_of(self._samples(takes), camera)

    def _differ(self, takes: Sequence[NDArray[Any]]) -> bool:
        """Test whether looks that were taken one after another differ in their shape."""
        assert self.merger is not None
        camera = camera_of(self.merger.sensor)
        return camera is not None and motion_of(self._samples(takes), camera) is not None

    def _samples(self, takes: Sequence[NDArray[Any]]) -> Samples:
        assert self.merger is not None
        return Samples(np.stack([sample(each[0]) for each in takes]), sample(self.merger.black))

    def _room_between(self, takes: Sequence[NDArray[Any]]) -> Fault | None:
        """Find light of the room that changes between looks taken one after another."""
        assert self.merger is not None
        unsteady = self._scatter(takes)
        if unsteady is not None and unsteady.kind in ("flicker", "late"):
            return None
        first = self.merger.merge(takes[0], 0)
        room = [change(self.merger, first, each).room for each in takes[1:]]
        fault = room_fault(max(map(abs, room)), f"in {len(takes)} pictures")
        return fault if fault.exceeds(NOTED) else None

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
        raise CaptureError(f"{text}. The capture ends here; {ways_on(folder, self.level)}")

    def entries(self) -> dict[str, Any]:
        """Entries of the looks in the level's manifest."""
        return {MOVES: {**self.looks.entry(self.frames), "every": self.every}}
