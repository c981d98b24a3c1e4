"""Stage: show the patterns of a level and keep their brackets, pattern by pattern."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import prod
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry import ExactSensor
from rfpipe.rigs import Rig
from rfpipe.rigs.base import sequence_patterns
from rfpipe.stages.capturing.brackets import Brackets
from rfpipe.stages.capturing.moves import every_of
from rfpipe.stages.capturing.mutual import MutualCapture, mutual_watch
from rfpipe.stages.capturing.sensors import write_sensor
from rfpipe.stages.capturing.shared import Shared, take_shared
from rfpipe.stages.capturing.shown import Keys, reference_patterns, symmetry_patterns
from rfpipe.stages.capturing.warm_up import seconds_since_capture, warm_up
from rfpipe.stages.capturing.watch import LookWatch, Watches, drift_watch, move_watch
from rfpipe.stages.disk import check_disk, disk_bytes
from rfpipe.stages.folder import (
    REFERENCE,
    SYMMETRY,
    VERIFICATION,
    AcquisitionFolder,
    name_of,
)
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.results import standing
from rfpipe.stages.schedule import read_schedule
from rfpipe.store import bytes_on_disk, write_manifest
from rfpipe.units import COUNT_UNIT, COUNTS, RADIANCE_UNIT

__all__ = ["Watching", "brackets_of", "frame_settings", "run"]

_TIME = "seconds_per_pattern"

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Watching:
    """What is looked after while patterns are shown.

    Parameters
    ----------
    mode : {"off", "warn", "refuse"}
        What to do when the rig moved, or a coaxial one isn't aligned: refuse ends the capture.
    looks : int or None
        Patterns from one look at the rig to the next, 0 for none. None: eight, where the patterns
        of a method that rests on ``T = T'`` don't tell by themselves.
    mutual_error : float
        Error in a picture of a rig taken for a coaxial one from which on it is said; 0: not
        watched.
    """

    mode: Literal["off", "warn", "refuse"] = "off"
    looks: int | None = None
    mutual_error: float = 0.0


def run(
    rig: Rig,
    folder: AcquisitionFolder,
    level: int,
    *,
    references: tuple[int, int],
    symmetry_frames: int = 0,
    batch_patterns: int = 16,
    when_patterns_change: Literal["recapture", "refuse"] = "recapture",
    warm_up_minutes: float = 0.0,
    drift_patterns: int = 0,
    watching: Mapping[str, Any] | None = None,
    share: Shared = "none",
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
    symmetry_frames : int
        Brackets of random patterns that follow them, for `rfpipe.stages.symmetry.run`.
    batch_patterns : int
        Patterns shown, then stored, at a time; fewer where memory is short. A rig with sequences
        shows as many as one of them takes.
    when_patterns_change : {"recapture", "refuse"}
        What to do when pictures of other patterns, or of another rig, stand there.
    warm_up_minutes : float
        For how long the lamp warms up when no bracket was taken for as long.
    drift_patterns : int
        Patterns from one look at the floodlit image to the next, from level 1 on; 0 for none.
    watching : mapping, optional
        Parameters of `Watching`; none watches nothing else.
    share : {"none", "black", "all"}
        Reference brackets to share, see `rfpipe.stages.capturing.shared.take_shared`.
    resources : Resources, optional
        Memory for the patterns in hand. What the rig itself takes comes on top.

    Raises
    ------
    StaleStoreError
        When there are and `when_patterns_change` is "refuse": says what differs.
    StoreError
        When the level doesn't fit on the disk; nothing is shown then.
    CaptureError
        When the rig fails or returns what is no bracket, or moved and that is to end the capture;
        what is captured stays.
    LockedError
        When another process captures into this folder.
    """
    counts = _counts(rig, references)
    counted = {"black_frames": counts[0], "floodlit_frames": counts[1]}
    facts: dict[str, dict[str, Any]] = {REFERENCE: counted, SYMMETRY: {"frames": symmetry_frames}}
    of_level, before = brackets_of(rig, folder, level, references, symmetry_frames)
    parts = [*before.values(), of_level]
    if _stands(folder, level, of_level, before):
        _log.info("%s: all %d patterns are captured", of_level.name, of_level.count)
        return
    for part in parts:
        part.settle(when_patterns_change)
    if level == 0:
        take_shared(share, folder, before[REFERENCE], counts[0], batch_patterns)
    to_capture = sum(part.count_missing() for part in parts)
    if to_capture:
        camera = rig.sensor, tuple(rig.camera_shape), rig.channels
        merged = folder.store(level, "merge")  # of a capture before: replaced
        present = bytes_on_disk(merged) if merged.exists() else 0
        need = disk_bytes(*camera, to_capture, of_level.count)
        check_disk(of_level.name, need, folder.path, present)
        if 0 < 60 * warm_up_minutes < seconds_since_capture(folder.path):
            warm_up(rig, warm_up_minutes)
    # a sequence is stored when it is complete: long ones, as loading takes most of their time
    counted_before = _counted_by(rig)
    at_a_time = sequence_patterns(rig) or batch_patterns
    in_hand = _bytes_in_hand(rig) * (2 if sequence_patterns(rig) else 1)  # with complements
    batch = (resources or Resources()).fitting(in_hand, at_a_time)
    beside: dict[str, Any] = {} if level else write_sensor(folder, rig.sensor)
    for name, part in before.items():
        beside[name] = {**part.capture(batch), **facts[name]}
    watched = Watching(**(watching or {}))
    with _watches(of_level, folder, level, drift_patterns, watched) as watches:
        captured = of_level.capture(batch, Watches(watches))
        beside |= {watch.name: watch.entry() for watch in watches}
    is_counts = rig.sensor.frame_dtype == COUNTS
    write_manifest(
        folder.manifest(level, "capture"),
        {
            "stage": "capture",
            "level": level,
            "patterns": of_level.count,
            "units": COUNT_UNIT if is_counts else RADIANCE_UNIT,
            "exposures_s": list(rig.sensor.exposures),
            "rig": of_level.shown["rig"],
            **captured,
            **beside,
            "devices": _difference(_counted_by(rig), counted_before),
        },
    )


@contextmanager
def _watches(
    of_level: Brackets,
    folder: AcquisitionFolder,
    level: int,
    drift_patterns: int,
    watching: Watching,
) -> Iterator[list[LookWatch | MutualCapture]]:
    """Provide all that watches a level."""
    refuse = watching.mode == "refuse"
    is_coaxial = bool(folder.read_manifest(level, "schedule").get("coaxial"))
    with ExitStack() as stack:
        watches: list[LookWatch | MutualCapture | None] = [
            stack.enter_context(
                drift_watch(of_level, folder, level, drift_patterns if level else 0)
            )
        ]
        if watching.mode != "off":
            every = every_of(watching.looks, tells=is_coaxial)
            watches.append(
                stack.enter_context(move_watch(of_level, folder, level, every, refuse=refuse))
            )
        if watching.mode != "off" and is_coaxial and 0 < level < VERIFICATION:
            least = watching.mutual_error
            watches.append(mutual_watch(of_level, folder, level, least, refuse=refuse))
        yield [watch for watch in watches if watch]


def brackets_of(
    rig: Rig,
    folder: AcquisitionFolder,
    level: int,
    references: tuple[int, int],
    symmetry_frames: int = 0,
) -> tuple[Brackets, dict[str, Brackets]]:
    """Return a level's brackets, and those that are captured before them, by their stores' names.

    Parameters
    ----------
    rig : Rig
    folder : AcquisitionFolder
    level : int
    references, symmetry_frames
        As of `run`.
    """
    schedule = read_schedule(folder, level)
    described = frame_settings(rig)
    counts = _counts(rig, references)

    def of_references(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        return reference_patterns(rig.projector_shape, counts[0], first, last)

    def of_symmetry(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        return symmetry_patterns(rig.projector_shape, symmetry_frames, first, last)

    def of_schedule(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        return schedule.batch(first, last), [(level, index) for index in range(first, last)]

    shown = {"patterns": schedule.count, "shown": schedule.digest(), "rig": described}
    path = folder.store(level, "capture")
    of_level = Brackets(rig, path, name_of(level), schedule.count, shown, of_schedule)
    before: dict[str, Brackets] = {}
    if level == 0:
        of_rig = {"black_frames": counts[0], "floodlit_frames": counts[1], "rig": described}
        path = folder.store(level, REFERENCE)
        before[REFERENCE] = Brackets(
            rig, path, "reference brackets", sum(counts), of_rig, of_references
        )
    if level == 0 and symmetry_frames:
        of_rig = {"symmetry_frames": symmetry_frames, "rig": described}
        path = folder.store(level, SYMMETRY)
        before[SYMMETRY] = Brackets(
            rig, path, "brackets of random patterns", symmetry_frames, of_rig, of_symmetry
        )
    return of_level, before


def _counts(rig: Rig, references: tuple[int, int]) -> tuple[int, int]:
    """Return how many all-off and all-on brackets there are."""
    return (1, 1) if isinstance(rig.sensor, ExactSensor) else references


def _stands(
    folder: AcquisitionFolder, level: int, of_level: Brackets, before: dict[str, Brackets]
) -> bool:
    """Whether the level's manifest stands there and is about these brackets."""
    stated = standing(folder.manifest(level, "capture"), of_level.made_for)
    if stated is None or (SYMMETRY in stated) != (SYMMETRY in before):
        return False
    return all(
        stated.get(name, {}).get("fingerprint") == part.made_for for name, part in before.items()
    )


def frame_settings(rig: Rig) -> dict[str, Any]:
    """Return a rig's description without how long it takes, which shapes no frame."""
    return {name: value for name, value in rig.describe().items() if name != _TIME}


def _counted_by(rig: Rig) -> dict[str, int]:
    """Return what a rig's devices counted so far: failed and lost frames, and attempts anew."""
    counts: dict[str, dict[str, int]] = getattr(rig, "statistics", None) or {}
    return {
        f"{device} {what}": count for device, of in counts.items() for what, count in of.items()
    }


def _difference(after: dict[str, int], before: dict[str, int]) -> dict[str, int]:
    """Return what was counted between; devices that began anew since count from 0."""
    return {
        name: count - before.get(name, 0) if count >= before.get(name, 0) else count
        for name, count in after.items()
    }


def _bytes_in_hand(rig: Rig) -> int:
    """Memory that a pattern takes while it is shown and stored."""
    bracket = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
    # The pattern and its picture may pass through a float64 operator; a simulated sensor draws
    # the noise of an exposure from some float32 images.
    doubles = 2 * prod(rig.projector_shape) + 4 * prod(rig.camera_shape) * rig.channels
    return 2 * bracket * rig.sensor.frame_dtype.itemsize + 8 * doubles
