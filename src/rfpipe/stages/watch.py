"""What watches a capture, by brackets between the patterns of a level and by the patterns' own.

Drift: the floodlit image, again and again, tells what the lamp does. Moves: so does a fine random
pattern whether the rig moved: half a pixel changes every ray of it by half, where white light
changes at edges alone; a change of the lamp changes all rays alike, and is taken off. Reciprocity:
the pictures of a coaxial rig themselves tell, for nothing, whether it still is one.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.calibration.reciprocity import Reciprocity
from rfpipe.calibration.symmetry import random_signs
from rfpipe.errors import CaptureError, StoreError
from rfpipe.keys import DRIFT_KEY, LOOK_KEY
from rfpipe.photometry.sensor import Merged
from rfpipe.stages.brackets import Brackets, Keys
from rfpipe.stages.folder import VERIFICATION, AcquisitionFolder, name_of
from rfpipe.stages.merger import Merger, read_merger
from rfpipe.stages.schedule import read_schedule
from rfpipe.store import FrameStore, restore_header
from rfpipe.units import SATURATION_FRACTION

DRIFT = "drift"
"""The repeated floodlit brackets of a level: their store and their key in manifests."""

MOVES = "moves"
"""The repeated random pattern of a level: its store and its key in manifests."""

MUTUAL = "reciprocity"
"""What a level's pictures tell of reciprocity, in its manifest."""

LOOK_PATTERNS = 8
"""So that a rig that moved is noticed within ten patterns, at an eighth more of them."""

# Standard deviations from which on a change counts as one: among hundreds of cells, noise has 4.
_SIGNIFICANCE = 5.0
# Cells, along either side of an image, whose change is looked at by itself.
_CELLS = 16
# A change of the picture, relative to its norm, that is worth a word: half a pixel makes fifty
# times as much, and a lamp that changes here and there a tenth.
_MOVED = 0.02
# What the noise itself is known to, as a share of its square.
_NOISE_KNOWN = 0.1
# Pictures of a level above that new ones are held against: as many as are held at all.
_WITNESSES = 24

Double = NDArray[np.float64]

_log = logging.getLogger(__name__)


def looks_every(looks: int | None, is_coaxial: bool) -> int:
    """Return the patterns from one look at the rig to the next, 0 for none.

    By default `LOOK_PATTERNS`, but none where the patterns of a coaxial rig tell by themselves.
    """
    return (0 if is_coaxial else LOOK_PATTERNS) if looks is None else looks


def look_count(patterns: int, every: int) -> int:
    """Return the looks at a level: one before each `every` patterns, and one after the last."""
    return -(-patterns // every) + 1


def look_positions(patterns: int, every: int) -> Double:
    """Return before which pattern each look is taken."""
    return np.minimum(np.arange(look_count(patterns, every)) * every, patterns).astype(np.float64)


@contextmanager
def watching_level(
    of_level: Brackets,
    level: int,
    drift_patterns: int = 0,
    mode: str = "off",
    looks: int | None = None,
    mutual_error: float = 0.0,
) -> Iterator[Watcher]:
    """Provide what watches the capture of a level.

    A level that was begun with looks goes on with them, as they were; one that was begun without
    has none, since looks at its first part can't be taken afterwards.

    Parameters
    ----------
    of_level : Brackets
        Of the level's patterns; their store, if there is one, is that of this capture.
    drift_patterns : int
        Patterns from one look at the lamp to the next, 0 for none.
    mode : {"off", "warn", "refuse"}
        What to do when the rig moved, or a coaxial one isn't aligned: refuse ends the capture.
    looks : int or None
        As of `looks_every`.
    mutual_error : float
        Error in a picture of a rig taken for a coaxial one from which on it is said.
    """
    folder, merger = of_level.folder, None
    if folder.exists(0, "merge"):
        merger = read_merger(of_level.rig.sensor, folder, SATURATION_FRACTION)
    is_coaxial = bool(folder.read_manifest(level, "schedule").get("coaxial"))
    shape = of_level.rig.projector_shape
    white = np.ones(shape, np.float32)
    lit = random_signs(shape, 1, 1, seed=15)[0] > 0
    fine = np.asarray(lit if lit.any() else ~lit, np.float32)
    every = looks_every(looks, is_coaxial) if mode != "off" else 0
    with ExitStack() as stack:
        begun = [
            _begin(stack, of_level, level, DRIFT, "drift watch", DRIFT_KEY, white, drift_patterns),
            _begin(stack, of_level, level, MOVES, "look at the rig", LOOK_KEY, fine, every),
        ]
        mutual = None
        if mode != "off" and is_coaxial and 0 < level < VERIFICATION and merger is not None:
            mutual = _Mutual.begin(of_level, level, merger, mutual_error, mode == "refuse")
        looks_of_level = [look for look in begun if look]
        yield Watcher(of_level, level, merger, looks_of_level, mutual, mode == "refuse")


@dataclass(frozen=True)
class Watcher:
    """Takes the looks of a level, and holds its pictures against each other."""

    of_level: Brackets
    level: int
    merger: Merger | None
    looks: Sequence[_Looks]
    mutual: _Mutual | None
    refuse: bool

    def due(self, first: int, last: int) -> Sequence[int]:
        """Return the positions between two patterns at which a look is due."""
        steps = [look.every for look in self.looks]
        return sorted({at for n in steps for at in range((first // n + 1) * n, last, n)})

    def before(self, position: int) -> None:
        """Take the looks that are due before the pattern at `position`, or after the last one."""
        for look in self.looks:
            at_end = position == self.of_level.count
            index = look.brackets.count - 1 if at_end else position // look.every
            if not look.frames.done[index]:
                self._tell(look, position, look.brackets.take(look.frames, index, index + 1))

    def after(self, first: int, brackets: NDArray[Any]) -> None:
        """Judge captured brackets, from pattern `first` on."""
        if self.mutual:
            self.mutual.judge(first, brackets)

    def entries(self) -> dict[str, Any]:
        """Return what the level's manifest says of all of it."""
        looks = {
            look.name: {**look.brackets.entry(look.frames), "every": look.every}
            for look in self.looks
        }
        return {**looks, **({MUTUAL: self.mutual.facts()} if self.mutual else {})}

    def _tell(self, look: _Looks, position: int, bracket: NDArray[Any]) -> None:
        """Say what a look shows; CaptureError where the rig moved and that ends the capture."""
        if self.merger is None:
            return
        if look.name == DRIFT:
            gain, deviation, local = brightness(self.merger, bracket, 0)
            _log.info(
                "drift watch before pattern %d: %s of the floodlit image's light (noise %.2g %%); "
                "parts of the image differ by up to %.2g %%",
                position, ", ".join(f"{100 * part:.2f} %" for part in gain),
                100 * deviation.max(), 100 * float(local),
            )  # fmt: skip
            return
        first = _first_look(self.of_level.folder, self.merger)
        change = _change(self.merger, first, bracket) if first else 0.0
        if change <= _MOVED:
            return
        text = (
            f"{name_of(self.level)}, before pattern {position}: the rig or the scene moved: the "
            f"same pattern looks different by {change:.1%} from how it looked first, whatever the "
            "lamp does. Pictures from before and after don't fit together"
        )
        if self.refuse:
            raise CaptureError(
                f"{text}. What is captured is kept: put things back, or remove the acquisition's "
                "folder and begin anew; capture.watch: warn goes on regardless"
            )
        _log.warning("%s", text)


@dataclass(frozen=True)
class _Looks:
    name: str
    brackets: Brackets
    frames: Any
    every: int


def _begin(
    stack: ExitStack, of_level: Brackets, level: int,
    name: str, title: str, key: int, pattern: NDArray[np.float32], every: int,
) -> _Looks | None:  # fmt: skip
    path, patterns = of_level.folder.store(level, name), of_level.count
    if of_level.count_missing() < patterns:  # it was begun
        if path.exists():
            restore_header(path)
            with FrameStore.open(path) as old:
                is_of_this = old.attributes.get("made_beside") == of_level.made_for
                every = int(old.attributes["every"]) if is_of_this else 0
        elif every:
            text = "%s was begun without a %s, and goes on without"
            _log.warning(text, name_of(level), title)
            every = 0
    if not every or not patterns:
        return None

    def repeated(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        keys: Keys = [(key, level, index) for index in range(first, last)]
        return np.repeat(pattern[None], last - first, axis=0), keys

    about = {"every": every, "made_beside": of_level.made_for, "rig": of_level.shown["rig"]}
    brackets = Brackets(
        of_level.rig, of_level.folder, path, f"{name_of(level)}, {title}",
        look_count(patterns, every), about, repeated,
    )  # fmt: skip
    brackets.settle()
    return _Looks(name, brackets, stack.enter_context(brackets.recording()), every)


# --- what looks tell: the lamp


def brightness(merger: Merger, bracket: NDArray[Any], index: int) -> tuple[Double, Double, Double]:
    """Compare one look's bracket (1, E, ...) of the floodlit pattern with that of level 0.

    Returns
    -------
    gain, deviation : ndarray of float64, shape (C,)
        Its light, relative, and the standard deviation.
    local : ndarray of float64, shape ()
        Largest significant change of a sixteenth by a sixteenth of the image beyond that of the
        whole, relative; 0 where none is.

    Raises
    ------
    CaptureError
        When the floodlit image has a channel without light.
    """
    merged = merger.merge(bracket, index)
    seen, seen_variance, known, known_variance = (
        _cells(image)
        for image in (
            merged.radiance[0], merged.variance[0], merger.floodlit, merger.floodlit_variance,
        )
    )  # fmt: skip
    total = known.sum(axis=0)
    if not (total > 0).all():
        raise CaptureError(
            "the floodlit image has a channel without light, so that drift can't be watched: set "
            "capture.drift_minutes to null"
        )
    gain = seen.sum(axis=0) / total
    variance = seen_variance.sum(axis=0) + gain**2 * known_variance.sum(axis=0)
    expected = known * gain
    noise = np.sqrt(seen_variance + gain**2 * known_variance)
    significant = np.abs(seen - expected) > _SIGNIFICANCE * noise
    change = np.divide(
        np.abs(seen - expected), expected, out=np.zeros_like(seen), where=expected > 0
    )
    local = np.where(significant, change, 0).max(initial=0.0)
    return gain, np.sqrt(variance) / total, np.asarray(local)


def _cells(image: NDArray[np.float32]) -> Double:
    """Sum an image (*camera_shape, C) over the cells of its views, ``(cells, C)``."""
    *shape, channels = image.shape
    planes = image.reshape(*RayDomain(tuple(shape)).stack_shape, channels).astype(np.float64)
    rows, columns = (
        np.arange(min(extent, _CELLS)) * extent // min(extent, _CELLS)
        for extent in planes.shape[1:3]
    )
    sums = np.add.reduceat(np.add.reduceat(planes, rows, axis=1), columns, axis=2)
    return sums.reshape(-1, channels)


def measure_drift(
    folder: AcquisitionFolder, merger: Merger, level: int, *, divide_out: bool
) -> tuple[Double | None, dict[str, Any]]:
    """Measure and log what a drift watch saw of a level.

    Returns
    -------
    gains : ndarray of float64, shape (patterns, C), or None
        Brightness at each pattern, between the looks, to divide by; None not to divide.
    facts : dict
        For the manifest; empty where nothing watched.
    """
    captured = folder.read_manifest(level, "capture")
    if DRIFT not in captured:
        return None, {}
    every, patterns = captured[DRIFT]["every"], captured["patterns"]
    with folder.frames(level, "capture", DRIFT) as frames:
        looks = [brightness(merger, frames.read(n, n + 1), n) for n in range(frames.shape[0])]
    gain, deviation, local = (np.stack(part) for part in zip(*looks, strict=True))
    span = gain.max(axis=0) - gain.min(axis=0)
    is_change = span > _SIGNIFICANCE * np.sqrt(2) * deviation.max(axis=0)
    change = float(np.where(is_change, span, 0).max(initial=0.0))
    noise, parts = float(deviation.max(initial=0.0)), float(local.max(initial=0.0))
    if change or parts:
        advice = "it is divided out" if divide_out else "merge.divide_out_drift would divide it out"
        _log.warning(
            "%s: the light changed by %.2g %% (noise %.2g %%) in %d looks; %s. Parts of the image "
            "changed by up to %.2g %% more, which stays: check for stray light and for what moved",
            name_of(level), 100 * change, 100 * noise, len(gain), advice, 100 * parts,
        )  # fmt: skip
    else:
        _log.info(
            "%s: the light kept steady, to its noise of %.2g %%, in %d looks",
            name_of(level), 100 * noise, len(gain),
        )  # fmt: skip
    facts = {
        "every": every, "gain": gain.tolist(), "deviation": deviation.tolist(),
        "local": local.tolist(), "divided_out": divide_out,
    }  # fmt: skip
    gains = None
    if divide_out:
        at, known = np.arange(patterns) + 0.5, look_positions(patterns, every)
        gains = np.stack([np.interp(at, known, of_channel) for of_channel in gain.T], axis=1)
    return gains, {DRIFT: facts}


# --- what looks tell: the rig's place


def measure_moves(folder: AcquisitionFolder, merger: Merger, level: int) -> dict[str, Any]:
    """Return what each look at the rig changed by, for the manifest; empty where nothing looked."""
    captured = folder.read_manifest(level, "capture")
    if MOVES not in captured:
        return {}
    first = _first_look(folder, merger)
    with folder.frames(level, "capture", MOVES) as frames:
        changes = [
            _change(merger, first, frames.read(n, n + 1)) if first else 0.0
            for n in range(frames.shape[0])
        ]
    facts = {
        "every": captured[MOVES]["every"],
        "change": [float(f"{change:.4g}") for change in changes],
        "moved": any(change > _MOVED for change in changes),
    }
    return {MOVES: facts}


def _first_look(folder: AcquisitionFolder, merger: Merger) -> Merged | None:
    """Return an acquisition's first look, merged; None where there is none yet."""
    for store in sorted(folder.path.glob(f"L[0-9]*/{MOVES}.zarr")):
        try:
            with FrameStore.open(store) as frames:
                if frames.done[0]:
                    return merger.merge(frames.read(0, 1), 0)
        except StoreError:
            continue
    return None


def _change(merger: Merger, first: Merged, bracket: NDArray[Any]) -> float:
    """Return how a look's bracket (1, E, ...) differs from the first look, relative to its norm.

    Beyond brightness and noise; 0 where that is all.
    """
    later = merger.merge(bracket, 0)
    known = np.isfinite(first.variance[0]) & np.isfinite(later.variance[0])
    was, now, v_was, v_now = (
        np.where(known, image[0], 0).reshape(-1, image.shape[-1]).astype(np.float64)
        for image in (first.radiance, later.radiance, first.variance, later.variance)
    )
    over = np.square(was).sum(axis=0)
    gain = np.where(over > 0, (was * now).sum(axis=0) / np.where(over > 0, over, 1), 1)
    noise = v_now + gain**2 * v_was
    light = float((np.square(gain * was)).sum() - (gain**2 * v_was).sum())
    if light <= 0:
        return 0.0
    square = float(np.square(now - gain * was).sum() - noise.sum())
    chance = _SIGNIFICANCE * np.sqrt(2 * np.square(noise).sum()) + _NOISE_KNOWN * noise.sum()
    return float(np.sqrt(max(square, 0.0) / light)) if square > chance else 0.0


# --- what the patterns themselves tell


class _Mutual:
    """Holds the pictures of a level against each other and those of the levels above."""

    def __init__(
        self, of_level: Brackets, level: int, merger: Merger, worth_a_word: float, refuse: bool
    ) -> None:
        self._of_level, self._level, self._merger = of_level, level, merger
        self._worth_a_word, self._refuse, self._silent = worth_a_word, refuse, False
        self._patterns = read_schedule(of_level.folder, level).batch
        self._reciprocity = Reciprocity(merger.floodlit, merger.floodlit_variance)
        self._in_order = True
        self._judged = 0
        self._first: int | None = None
        self._deviations = self._error = 0.0

    @classmethod
    def begin(cls, of_level: Brackets, *about: Any, silent: bool = False) -> _Mutual | None:
        """Judge what is captured of a level; None where there is nothing to be held against."""
        self = cls(of_level, *about)
        if not self._merger.floodlit.any() or not of_level.count:
            return None
        self._silent = silent
        for above in range(1, self._level):
            self._enter(above)
        if of_level.count_missing() < of_level.count:
            with FrameStore.open(of_level.path) as frames:
                if frames.dropped:
                    return None
                for index in map(int, np.flatnonzero(frames.done)):
                    try:
                        brackets = frames.read(index, index + 1)
                    except StoreError:  # it will be captured, and judged, again
                        continue
                    self.judge(index, brackets)
        return self

    def judge(self, first: int, brackets: NDArray[Any]) -> None:
        """Judge brackets, from pattern `first` on; CaptureError where one is to end the capture."""
        merged = self._merger.merge(brackets, first)
        patterns = self._patterns(first, first + len(brackets))
        for offset, pattern in enumerate(patterns):
            index = first + offset
            residual = self._reciprocity.judge(
                pattern, merged.radiance[offset], merged.variance[offset]
            )
            self._in_order &= index == self._judged
            self._judged += 1
            self._deviations = max(self._deviations, residual.deviations)
            if residual.is_wrong(self._worth_a_word):
                self._error = max(self._error, residual.error)
                self._say(index, residual.deviations, residual.error)

    def facts(self) -> dict[str, Any]:
        """Return what the level's manifest says: the same however the capture went."""
        if not self._in_order:
            again = _Mutual.begin(
                self._of_level, self._level, self._merger, self._worth_a_word, False, silent=True
            )
            if again:
                return again.facts()
        return {
            "judged": self._judged,
            "deviations": float(f"{self._deviations:.4g}"),
            "error": float(f"{self._error:.4g}"),
            "first": self._first,
        }

    def _say(self, index: int, deviations: float, error: float) -> None:
        is_first, self._first = self._first is None, index if self._first is None else self._first
        text = (
            f"{name_of(self._level)}, pattern {index}: light doesn't go from camera to projector "
            f"as it comes ({deviations:.0f} standard deviations): taking the rig for a coaxial "
            f"one makes an error of at least {error:.1%} in this picture. The two devices are not "
            "aligned any more, or never were"
        )
        if self._refuse:
            raise CaptureError(
                f"{text}. What is captured is kept: align them and remove the acquisition's folder "
                "to begin anew, or use a method for any rig, such as dual photography; "
                "capture.watch: warn goes on regardless"
            )
        if is_first and not self._silent:
            _log.warning("%s; capture.watch: refuse would stop here", text)

    def _enter(self, level: int) -> None:
        """Make witnesses of a level's first pictures."""
        folder = self._of_level.folder
        if not folder.exists(level, "merge"):
            return
        try:
            schedule = read_schedule(folder, level)
            with folder.frames(level, "merge") as frames:
                count = min(schedule.count, _WITNESSES)
                images = frames.read(0, count)
        except StoreError:
            return
        for pattern, (radiance, variance) in zip(schedule.batch(0, count), images, strict=True):
            self._reciprocity.judge(pattern, radiance, variance)
