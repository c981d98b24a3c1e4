"""Stage: show the patterns of a level and keep their brackets, pattern by pattern."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry import ExactSensor
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.stages.aside import settle
from rfpipe.stages.disk import DiskNeed, check_level, check_run
from rfpipe.stages.merging import Keys, reference_patterns
from rfpipe.stages.plan import AcquisitionFolder
from rfpipe.stages.progress import Progress
from rfpipe.stages.schedule import read_schedule
from rfpipe.stages.sensors import write_sensor
from rfpipe.stages.workers import Resources
from rfpipe.store import FrameStore, bytes_on_disk, write_manifest
from rfpipe.units import COUNT_UNIT, COUNTS, RADIANCE_UNIT

__all__ = ["REFERENCE", "frame_settings", "run"]

REFERENCE = "reference"
"""The all-off and all-on brackets, taken with level 0: their store and their manifest's key."""

_log = logging.getLogger(__name__)

_TIME = "seconds_per_pattern"


def run(
    rig: Rig,
    folder: AcquisitionFolder,
    level: int,
    *,
    references: tuple[int, int],
    batch_patterns: int = 16,
    when_patterns_change: Literal["recapture", "refuse"] = "recapture",
    expected_patterns: int = 0,
    keep_raw: bool = True,
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
    expected_patterns : int
        Patterns that all levels may take, if known: level 0 warns when they don't fit on the disk.
    keep_raw : bool
        Whether the brackets will stay once they are merged.
    resources : Resources, optional
        Memory for the patterns in hand. What the rig itself takes comes on top.

    Raises
    ------
    StaleStoreError
        When there are and `when_patterns_change` is "refuse": says what differs.
    StoreError
        When the level doesn't fit on the disk; nothing is shown then.
    CaptureError
        When the rig fails or returns what is no bracket; what is captured stays.
    LockedError
        When another process captures into this folder.
    """
    schedule = read_schedule(folder, level)
    described = frame_settings(rig)
    counts = (1, 1) if isinstance(rig.sensor, ExactSensor) else references
    counted = {"black_frames": counts[0], "floodlit_frames": counts[1]}

    def of_references(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        return reference_patterns(rig.projector_shape, counts[0], first, last)

    def of_schedule(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        return schedule.batch(first, last), [(level, index) for index in range(first, last)]

    shown = {"patterns": schedule.count, "shown": schedule.digest(), "rig": described}
    path = folder.store(level, "capture")
    parts = [_Brackets(rig, path, f"level {level}", schedule.count, shown, of_schedule)]
    if level == 0:
        path = folder.store(level, REFERENCE)
        shown = {**counted, "rig": described}
        parts.insert(
            0, _Brackets(rig, path, "reference brackets", sum(counts), shown, of_references)
        )
    for part in parts:
        settle(part.path, part.made_for, part.shown, when_patterns_change)
    to_capture = sum(part.count_missing() for part in parts)
    if to_capture:
        if level == 0 and expected_patterns:
            brackets = sum(counts) + keep_raw * expected_patterns
            need = DiskNeed.of(rig, brackets, expected_patterns)
            check_run(need, expected_patterns, folder.path, keep_raw=keep_raw)
        merged = folder.store(level, "merge")  # of a capture before: replaced
        present = bytes_on_disk(merged) if merged.exists() else 0
        need = DiskNeed.of(rig, to_capture, schedule.count)
        check_level(f"level {level}", need, folder.path, present, keep_raw=keep_raw)
    batch = (resources or Resources()).fitting(_bytes_in_hand(rig), batch_patterns)
    sensor = write_sensor(folder, rig.sensor) if level == 0 else {}
    *before, captured = [part.capture(batch) for part in parts]
    reference = {REFERENCE: {**before[0], **counted}} if before else {}
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
            **reference,
            **sensor,
        },
    )


def frame_settings(rig: Rig) -> dict[str, Any]:
    """Return a rig's description without how long it takes, which shapes no frame."""
    return {name: value for name, value in rig.describe().items() if name != _TIME}


def _bytes_in_hand(rig: Rig) -> int:
    """Memory that a pattern takes while it is shown and stored."""
    bracket = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
    # The pattern and its picture may pass through a float64 operator; a simulated sensor draws
    # the noise of an exposure from some float32 images.
    doubles = 2 * prod(rig.projector_shape) + 4 * prod(rig.camera_shape) * rig.channels
    return 2 * bracket * rig.sensor.frame_dtype.itemsize + 8 * doubles


@dataclass(frozen=True)
class _Brackets:
    """One store of brackets to be captured, and the patterns to show for them."""

    rig: Rig
    path: Path
    name: str
    count: int
    shown: dict[str, Any]
    patterns: Callable[[int, int], tuple[NDArray[np.float32], Keys]]

    @property
    def made_for(self) -> str:
        """Fingerprint of all that shapes the frames."""
        return fingerprint(self.shown)

    def count_missing(self) -> int:
        """Count the brackets that aren't captured yet."""
        if not self.path.exists():
            return self.count
        with FrameStore.open(self.path) as frames:
            return self.count - int(np.count_nonzero(frames.done))

    def capture(self, batch: int) -> dict[str, Any]:
        """Capture the items that are missing; return the store's entry for the manifest."""
        sensor = self.rig.sensor
        shape = tuple(sensor.frame_shape(self.rig.camera_shape, self.rig.channels))
        with FrameStore.create(
            self.path,
            (self.count, *shape),
            sensor.frame_dtype,
            self.made_for,
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
                for first, last in frames.missing(batch):
                    block = self.rig.capture(*self.patterns(first, last))
                    frames.write(first, self._checked(block, first, shape))
                    progress.advance(last - first)
            return {
                "digest": frames.digest(),
                "dtype": frames.dtype.str,
                "shape": list(frames.shape),
                "fingerprint": self.made_for,
            }

    def _checked(self, block: NDArray[Any], first: int, shape: tuple[int, ...]) -> NDArray[Any]:
        """Refuse what is no bracket before it is entered as captured."""
        dtype = self.rig.sensor.frame_dtype
        if block.shape[1:] != shape or block.dtype != dtype:
            raise CaptureError(
                f"{self.name}, pattern {first}: the rig returned {block.dtype} frames of shape "
                f"{block.shape[1:]}; expected {dtype} {shape}. Check the camera's size, pixel "
                "format and exposures, then run again: it goes on at this pattern"
            )
        if block.dtype.kind == "f" and not np.isfinite(block).all():
            bad = first + int(np.argwhere(~np.isfinite(block))[0][0])
            raise CaptureError(
                f"{self.name}, pattern {bad}: the rig returned NaN or infinity; light is finite. "
                "Check the rig, then run again: it goes on at this batch"
            )
        return block
