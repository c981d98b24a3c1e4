"""Stage: show the patterns of a level and keep their brackets, pattern by pattern."""

from __future__ import annotations

import logging
from collections.abc import Callable
from math import prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.patterns import Schedule
from rfpipe.photometry import ExactSensor
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.stages.aside import settle
from rfpipe.stages.merging import reference_patterns
from rfpipe.stages.plan import AcquisitionFolder
from rfpipe.stages.progress import Progress
from rfpipe.stages.schedule import read_schedule
from rfpipe.stages.workers import Resources
from rfpipe.store import FrameStore, write_manifest
from rfpipe.units import COUNT_UNIT, COUNTS, RADIANCE_UNIT

__all__ = ["REFERENCE", "run"]

REFERENCE = "reference"
"""The all-off and all-on brackets, taken with level 0: their store and their manifest's key."""

_log = logging.getLogger(__name__)

_TIME = "seconds_per_pattern"

Show = Callable[[int, int], NDArray[Any]]


def run(
    rig: Rig,
    folder: AcquisitionFolder,
    level: int,
    *,
    references: tuple[int, int],
    batch_patterns: int = 16,
    when_patterns_change: Literal["recapture", "refuse"] = "recapture",
    resources: Resources | None = None,
) -> None:
    """Capture what isn't captured yet of a level, and write its manifest.

    Parameters
    ----------
    rig : Rig
    folder : AcquisitionFolder
    level : int
        Level 0 begins with the reference brackets.
    references : (int, int)
        All-off and all-on brackets; exact radiance takes one of each whatever stands here.
    batch_patterns : int
        Patterns shown, then stored, at a time; fewer where memory is short.
    when_patterns_change : {"recapture", "refuse"}
        What to do when pictures of other patterns, or of another rig, stand there.
    resources : Resources, optional
        Memory for the patterns in hand. What the rig itself takes comes on top.

    Raises
    ------
    StaleStoreError
        When there are and `when_patterns_change` is "refuse": says what differs.
    CaptureError
        When the rig fails or returns what is no bracket; what is captured stays.
    LockedError
        When another process captures into this folder.
    """
    schedule = read_schedule(folder, level)
    batch = (resources or Resources()).fitting(_bytes_in_hand(rig), batch_patterns)
    # How long a real rig takes shapes no frame.
    described = {name: value for name, value in rig.describe().items() if name != _TIME}
    entry: dict[str, Any] = {}
    if level == 0:
        counts = (1, 1) if isinstance(rig.sensor, ExactSensor) else references
        shown = {"black_frames": counts[0], "floodlit_frames": counts[1], "rig": described}
        frames = _Frames(
            folder.store(level, REFERENCE), "reference brackets", sum(counts), shown, batch
        )
        entry[REFERENCE] = {
            **frames.capture(
                rig,
                lambda first, last: rig.capture(
                    *reference_patterns(rig.projector_shape, counts[0], first, last)
                ),
                when_patterns_change,
            ),
            "black_frames": counts[0],
            "floodlit_frames": counts[1],
        }

    shown = {"patterns": schedule.count, "shown": schedule.digest(), "rig": described}
    name = f"level {level}"
    frames = _Frames(folder.store(level, "capture"), name, schedule.count, shown, batch)
    captured = frames.capture(
        rig, lambda first, last: _show(rig, schedule, first, last), when_patterns_change
    )
    is_counts = rig.sensor.frame_dtype == COUNTS
    write_manifest(
        folder.manifest(level, "capture"),
        {
            "stage": "capture",
            "level": level,
            "patterns": schedule.count,
            "units": COUNT_UNIT if is_counts else RADIANCE_UNIT,
            "exposures_s": list(rig.sensor.exposures),
            "rig": described,
            **captured,
            **entry,
        },
    )


def _bytes_in_hand(rig: Rig) -> int:
    """Memory that a pattern takes while it is shown and stored."""
    bracket = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
    # The pattern and its picture may pass through a float64 operator; a simulated sensor draws
    # the noise of an exposure from some float32 images.
    doubles = 2 * prod(rig.projector_shape) + 4 * prod(rig.camera_shape) * rig.channels
    return 2 * bracket * rig.sensor.frame_dtype.itemsize + 8 * doubles


def _show(rig: Rig, schedule: Schedule, first: int, last: int) -> NDArray[Any]:
    keys = [(schedule.level, index) for index in range(first, last)]
    return rig.capture(schedule.batch(first, last), keys)


class _Frames:
    """One store of brackets to be captured."""

    def __init__(
        self, path: Path, name: str, count: int, shown: dict[str, Any], batch: int
    ) -> None:
        self.path = path
        self.name = name
        self.count = count
        self.shown = shown
        self.batch = batch

    def capture(
        self, rig: Rig, show: Show, when_changed: Literal["recapture", "refuse"]
    ) -> dict[str, Any]:
        """Capture the items that are missing; return the store's entry for the manifest."""
        shape = tuple(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
        made_for = fingerprint(self.shown)
        settle(self.path, made_for, self.shown, when_changed)
        with FrameStore.create(
            self.path,
            (self.count, *shape),
            rig.sensor.frame_dtype,
            made_for,
            self.shown,
            # a twelfth more bytes than by zstd, written and read in half the time
            compression="lz4",
        ) as frames:
            done = int(np.count_nonzero(frames.done))
            if frames.complete:
                _log.info("%s: all %d patterns are captured", self.name, self.count)
            elif done:
                _log.info(
                    "%s: %d of %d patterns are captured; going on at pattern %d",
                    self.name, done, self.count, frames.missing()[0][0],
                )  # fmt: skip
            with Progress(self.name, self.count, done) as progress:
                for first, last in frames.missing(self.batch):
                    frames.write(first, self._checked(show(first, last), first, shape, rig))
                    progress.advance(last - first)
            return {
                "digest": frames.digest(),
                "dtype": frames.dtype.str,
                "shape": list(frames.shape),
                "fingerprint": made_for,
            }

    def _checked(
        self, block: NDArray[Any], first: int, shape: tuple[int, ...], rig: Rig
    ) -> NDArray[Any]:
        """Refuse what is no bracket before it is entered as captured."""
        if block.shape[1:] != shape or block.dtype != rig.sensor.frame_dtype:
            raise CaptureError(
                f"{self.name}, pattern {first}: the rig returned {block.dtype} frames of shape "
                f"{block.shape[1:]}; expected {rig.sensor.frame_dtype} {shape}. Check the camera's "
                "size, pixel format and exposures, then run again: it goes on at this pattern"
            )
        if block.dtype.kind == "f" and not np.isfinite(block).all():
            bad = first + int(np.argwhere(~np.isfinite(block))[0][0])
            raise CaptureError(
                f"{self.name}, pattern {bad}: the rig returned NaN or infinity; light is finite. "
                "Check the rig, then run again: it goes on at this batch"
            )
        return block
