"""Brackets on their way from the rig to their store, pattern by pattern."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, IntegrityError, LockedError, StaleStoreError, StoreError
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.progress import Progress
from rfpipe.store import FrameStore, StoreLock, read_manifest, rebuild_header, restore_header
from rfpipe.store.places import METADATA

Keys = list[tuple[int, ...]]
"""A key a pattern: for the rig's random numbers, and for messages."""

Shared = Literal["none", "black", "all"]

_NAMED_DIGITS = 12
_SHOWN_DIFFERENCES = 6
_POLL_SECONDS = 0.2

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Brackets:
    """One store of brackets to be captured, and the patterns to show for them.

    Parameters
    ----------
    path : Path
        Of the store.
    name : str
        For messages.
    count : int
        Patterns in all.
    shown : dict
        Plain data: all that shapes the frames. The store has it as its attributes.
    patterns : callable
        ``patterns(first, last)`` returns these patterns and their keys.
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

        Parameters
        ----------
        batch : int
            Patterns shown, then stored, at a time.
        watch : Watcher, optional
            Takes looks between the patterns, see `rfpipe.stages.watch`.

        Raises
        ------
        CaptureError
            When the rig fails or returns what is no bracket; what is captured stays.
        """
        with self.recording() as frames:
            done = int(np.count_nonzero(frames.done))
            if frames.complete:
                _log.info("%s: all %d patterns are captured", self.name, self.count)
            elif done:
                _log.info(
                    "%s: %d of %d patterns are captured; going on at pattern %d",
                    self.name, done, self.count, frames.missing(1)[0][0],
                )  # fmt: skip
            with Progress(self.name, self.count, done, shown=progress) as bar:
                for first, last in _cut(frames.missing(batch), watch):
                    if watch:
                        watch.before(first)
                    taken = self.take(frames, first, last)
                    if watch:
                        watch.after(first, taken)
                    bar.advance(last - first)
            if watch:
                watch.before(self.count)
            return self.entry(frames)

    def take(self, frames: Any, first: int, last: int) -> NDArray[Any]:
        """Capture items ``first:last`` into the opened store; return their brackets."""
        block = capture_batch(self.rig, *self.patterns(first, last))
        frames.write(first, self._checked(block, first))
        return block

    def entry(self, frames: Any) -> dict[str, Any]:
        """Return what a manifest says of the store."""
        return {**frames.entry(), "fingerprint": self.made_for}

    def settle(self, when_changed: Literal["recapture", "refuse"] = "recapture") -> None:
        """Make way for these brackets: afterwards their store stands at its place, or none does.

        A store of something else is renamed, its fingerprint in its new name. Back at the settings
        that it was made with, it is found again, so that the rig needn't be. If its pictures were
        dropped after their merge, it is removed. A damaged header heals.

        Raises
        ------
        StaleStoreError
            When a store of something else stands there, none fits, and `when_changed` is "refuse".
        LockedError
            When another process writes the store.
        IntegrityError
            When the header is damaged, and is none of a store of these brackets.
        """
        if not self.folder.is_kept:
            return
        if self.path.exists():
            self._heal()
        with StoreLock(self.path):
            fitting = self._aside(self.made_for)
            if self.path.exists():
                with FrameStore.open(self.path) as old:
                    if old.fingerprint == self.made_for:
                        return
                    captured = int(old.done.sum())
                    place = self._aside(old.fingerprint)
                if captured and not fitting.exists():
                    self._say_anew(old, place, when_changed)
                if place.exists():  # of a change that was undone before it was captured
                    FrameStore.discard(place)
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

    def _heal(self) -> None:
        """Restore a damaged header, which must not be taken for that of other settings."""
        if restore_header(self.path):
            _log.warning("%s: its header was damaged or missing; restored", self.path)
        with suppress(StoreError):
            held = FrameStore.open(self.path)
            # from here on only stores without a copy can be damaged
            if fingerprint(held.attributes) == held.fingerprint and (
                held.fingerprint != self.made_for or (held.shape, held.dtype) == self._layout
            ):
                return
        if self._is_of_others or not rebuild_header(
            self.path, lambda path: replace(self, path=path).recording()
        ):
            raise IntegrityError(
                f"{self.path / METADATA}: damaged, and its frames aren't known to be those that "
                "are to be captured now. Restore this file, or the settings that they were "
                f"captured with; or move {self.path} away, and all of its patterns are shown again"
            )
        _log.warning(
            "%s: its header was damaged or missing; made again from the schedule and the journal, "
            "so that no pattern has to be shown again for it", self.path,
        )  # fmt: skip

    @property
    def _is_of_others(self) -> bool:
        """Whether the store is of other patterns or another rig, as far as anything still tells."""
        name = self.path.stem
        with suppress(StoreError):
            held = FrameStore.open(self.path)
            if self.made_for not in (held.fingerprint, fingerprint(held.attributes)):
                return True  # more than one thing is wrong with it
        try:
            stated = read_manifest(self.path.with_name("capture.json"))
        except StoreError:
            return False
        part = stated if name == "capture" else stated.get(name, {})
        return bool(part.get("fingerprint", self.made_for) != self.made_for)

    def _aside(self, made_for: str) -> Path:
        name = f"{self.path.stem}.{made_for[:_NAMED_DIGITS]}{self.path.suffix}"
        return self.path.with_name(name)

    def _say_anew(self, old: FrameStore, place: Path, when_changed: str) -> None:
        """Refuse to capture anew, or say that it is about to happen."""
        count, changed = int(old.done.sum()), differing(old.attributes, self.shown)
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


def take_shared(
    share: Shared, folder: AcquisitionFolder, references: Brackets, black: int, batch: int
) -> None:
    """Fill reference brackets that are missing with shared ones; take those where there are none.

    Dark frames are the rig's, whatever stands before it; the floodlit ones are a scene's, by
    whatever method it is acquired. They lie in ``references`` in the folder of results.

    Parameters
    ----------
    share : {"none", "black", "all"}
        "black": the all-off brackets, of all acquisitions by the same rig; "all": the all-on ones
        of the same scene as well.
    references : Brackets
        The acquisition's: `black` brackets all off, then those all on.
    batch : int
        Patterns shown, then stored, at a time.

    Raises
    ------
    RfpipeError
        As `Brackets.capture`, `Brackets.settle`.
    """
    about = {
        "rig": {name: it for name, it in references.shown["rig"].items() if name != "scene"},
        "layout": [list(references.rig.camera_shape), references.rig.channels],
    }
    scene = {"scene": references.shown["rig"].get("scene"), "name": folder.path.parent.name}
    parts: list[tuple[str, int, int, dict[str, Any]]] = [
        ("black", 0, black, {}), ("floodlit", black, references.count, scene)
    ]  # fmt: skip
    for name, first, last, of in parts[: {"none": 0, "black": 1, "all": 2}[share]]:
        runs = [(max(a, first), min(b, last)) for a, b in references.missing(batch)]
        missing = [(a, b) for a, b in runs if a < b]
        if not missing:
            continue
        shown = {"shared": name, "count": last - first, **about, **of}
        place = folder.path.parents[1] / "references" / f"{name}_{fingerprint(shown)[:12]}.zarr"

        def patterns(begin: int, end: int, at: int = first) -> tuple[NDArray[np.float32], Keys]:
            return references.patterns(at + begin, at + end)

        shared = replace(
            references, path=place, name=f"{name} brackets for all", count=last - first,
            shown=shown, patterns=patterns,
        )  # fmt: skip
        with _waiting_for(place.with_suffix(".taking")):
            shared.settle()
            if shared.count_missing():
                shared.capture(batch)
        with FrameStore.open(place) as taken, references.recording() as frames:
            for begin, end in missing:
                frames.write(begin, taken.read(begin - first, end - first))
        text = "reference brackets: %d of %d are shared (%s)"
        _log.info(text, last - first, references.count, place.name)


@contextmanager
def _waiting_for(path: Path) -> Iterator[None]:
    """Hold a lock, once whoever takes the same brackets has taken them."""
    lock = StoreLock(path)
    while True:
        with suppress(LockedError):
            lock.acquire()
            break
        time.sleep(_POLL_SECONDS)
    try:
        yield
    finally:
        lock.release()


def differing(old: dict[str, Any], new: dict[str, Any]) -> str:
    """Say which settings differ, such as ``patterns 64 -> 72, rig.seed 1 -> 2``."""
    before, after = _flat(old), _flat(new)
    changed = [
        f"{name} {before.get(name, 'unset')} -> {after.get(name, 'unset')}"
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name)
    ]
    more = len(changed) - _SHOWN_DIFFERENCES
    return ", ".join(changed[:_SHOWN_DIFFERENCES]) + (f" and {more} more" if more > 0 else "")


def _flat(value: Any, name: str = "") -> dict[str, str]:
    """Name each setting by its place, such as ``rig.sensor.bits``."""
    if isinstance(value, list | tuple) and any(isinstance(item, dict) for item in value):
        value = {str(index): item for index, item in enumerate(value)}
    if isinstance(value, dict):
        parts = [_flat(item, f"{name}.{key}" if name else key) for key, item in value.items()]
        return {key: text for part in parts for key, text in part.items()}
    return {name: str(list(value) if isinstance(value, tuple) else value)}


def _cut(runs: Iterable[tuple[int, int]], watch: Any) -> Iterator[tuple[int, int]]:
    """Cut runs of items where looks are to be taken between them."""
    for first, last in runs:
        due = watch.due(first, last) if watch else ()
        yield from pairwise([first, *due, last])
