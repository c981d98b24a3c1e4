"""Stage: show the patterns of a level and keep their brackets, pattern by pattern."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from functools import partial
from itertools import count
from math import prod
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.symmetry import random_signs
from rfpipe.errors import CaptureError, StoreError
from rfpipe.jobs.job import Progress
from rfpipe.jobs.workers import Resources
from rfpipe.photometry import ExactSensor, Sensor, sensor_from_description
from rfpipe.references.calibration_check import check_calibration
from rfpipe.references.check_pictures import recovery_advice
from rfpipe.references.steadiness import (
    camera_model_of,
    faults_of_reference_brackets,
    sample_pixels,
)
from rfpipe.rigs import Rig
from rfpipe.rigs.base import is_simulated, sequence_patterns
from rfpipe.rigs.faults import CAPTURE
from rfpipe.stages.brackets import Brackets, Keys
from rfpipe.stages.forecast import check_disk, disk_bytes
from rfpipe.stages.schedule import read_schedule
from rfpipe.stages.watch import watching_level
from rfpipe.steps import displayed_by
from rfpipe.storage.files import (
    REFERENCE_BRACKETS,
    SENSOR,
    SYMMETRY,
    VERIFICATION,
    AcquisitionFolder,
    name_of,
)
from rfpipe.store import bytes_on_disk
from rfpipe.text import counted
from rfpipe.units import (
    BLACK_LEVEL_KEY,
    COUNT_UNIT,
    COUNTS,
    FLOODLIT_KEY,
    RADIANCE_UNIT,
    SYMMETRY_KEY,
    WARM_UP_KEY,
)

_SECONDS_BETWEEN_BRACKETS = 30.0  # of white, while the lamp warms up

_log = logging.getLogger(__name__)


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
    watching: Mapping[str, Any] | None = None,
    progress: bool = True,
    resources: Resources | None = None,
) -> None:
    """Capture what isn't captured yet of a level, and write its manifest.

    Parameters
    ----------
    references : (int, int)
        All-off and all-on brackets with which level 0 begins; exact radiance takes one of each.
    symmetry_frames : int
        Brackets of random patterns that follow them, for `rfpipe.references.symmetry`.
    batch_patterns : int
        Patterns shown, then stored, at a time; fewer where memory is short, or a sequence's.
    when_patterns_change : {"recapture", "refuse"}
        What to do when pictures of other patterns, or of another rig, stand there.
    warm_up_minutes : float
        Minutes that the lamp warms up, where no bracket was taken in the last so many minutes.
    watching : mapping, optional
        "mode", "off", "warn" or "refuse": what to do where pictures show that the rig or its light
        changed; "check_interval": patterns from one look to the next, 0 for none, see
        `rfpipe.stages.watch`; "asymmetry": what is accepted, see
        `rfpipe.references.calibration_check`.

    Raises
    ------
    StaleStoreError
        When patterns changed and `when_patterns_change` is "refuse"; says what differs.
    StoreError
        When the level doesn't fit on the disk, or another process writes it; nothing is shown then.
    CaptureError
        When the rig fails, returns what is no bracket, or isn't what it was where `watching`
        refuses that; what is captured stays.
    """
    watching = {"mode": "off", "check_interval": 0, "asymmetry": 1.0, **(watching or {})}
    of_level, before = brackets_of(rig, folder, level, references, symmetry_frames)
    if _stands(folder, level, of_level, before):
        if of_level.count:
            _log.info("%s: complete, with %s", of_level.name, counted(of_level.count, "pattern"))
        return
    parts = (*before.values(), of_level)
    for part in parts:
        part.settle(when_patterns_change)
    to_capture = sum(part.count_missing() for part in parts)
    if to_capture and folder.is_kept:
        _check_disk(rig, folder, level, of_level, to_capture)
        _warm_up(rig, folder, 60 * warm_up_minutes)
    # A sequence is stored when it is complete: long ones, as loading takes most of their time;
    # in hand they have complements.
    in_sequences = sequence_patterns(rig)
    in_hand = _bytes_in_hand(rig) * (2 if in_sequences else 1)
    batch = (resources or Resources()).fitting_count(in_hand, in_sequences or batch_patterns)
    beside: dict[str, Any] = {} if level else _write_sensor(folder, rig.sensor)
    # a simulated scene may be recorded at its first picture
    with displayed_by(partial(Progress, unit="step", shown=progress)):
        for name, part in before.items():
            counts = {name: it for name, it in part.shown.items() if name != "rig"}
            beside[name] = {**part.capture(batch, progress=progress), **counts}
            if name == REFERENCE_BRACKETS and watching["mode"] != "off":
                _check_references(folder, rig.sensor, part.shown, watching["mode"])
    looks = max(watching["check_interval"], in_sequences) if watching["check_interval"] else 0
    with watching_level(of_level, level, watching["mode"], looks) as watch:
        if watch and watch.references and level != VERIFICATION:
            watch.before(0)  # says first what changes from picture to picture
            check_calibration(
                folder, level, watch.references, of_level.shown["rig"], watching["asymmetry"],
                refuse=watch.is_refusing,
            )  # fmt: skip
        captured = of_level.capture(batch, watch, progress=progress)
        beside |= watch.entries() if watch else {}
    manifest = {
        "stage": "capture",
        "level": level,
        "patterns": of_level.count,
        "units": COUNT_UNIT if rig.sensor.frame_dtype == COUNTS else RADIANCE_UNIT,
        "exposures_s": list(rig.sensor.exposures),
        "rig": of_level.shown["rig"],
        **captured,
        **beside,
    }
    folder.write_manifest(level, "capture", manifest)


def brackets_of(
    rig: Rig,
    folder: AcquisitionFolder,
    level: int,
    references: tuple[int, int],
    symmetry_frames: int = 0,
) -> tuple[Brackets, dict[str, Brackets]]:
    """Return a level's brackets, and those captured before them, by their stores' names."""
    schedule = read_schedule(folder, level)
    described = frame_settings(rig) if folder.is_kept or not is_simulated(rig) else {}
    off, on = _counts(rig, references)
    shape = tuple(rig.projector_shape)

    def of_schedule(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        return schedule.batch(first, last), [(level, index) for index in range(first, last)]

    def brackets(store: str, name: str, count: int, patterns: Any, shown: Any) -> Brackets:
        path = folder.store(level, store)
        return Brackets(rig, folder, path, name, count, {**shown, "rig": described}, patterns)

    before: dict[str, Brackets] = {}
    if level == 0:
        patterns = partial(reference_patterns, shape, off)
        shown: dict[str, Any] = {"black_frames": off, "floodlit_frames": on}
        before[REFERENCE_BRACKETS] = brackets(
            REFERENCE_BRACKETS, "reference brackets", off + on, patterns, shown
        )
    if level == 0 and symmetry_frames:
        patterns = partial(symmetry_patterns, shape, symmetry_frames)
        shown, name = {"symmetry_frames": symmetry_frames}, "brackets of random patterns"
        before[SYMMETRY] = brackets(SYMMETRY, name, symmetry_frames, patterns, shown)
    shown = {"patterns": schedule.count, "shown": schedule.digest()}
    return brackets("capture", name_of(level), schedule.count, of_schedule, shown), before


def reference_patterns(
    projector_shape: tuple[int, ...], black_frames: int, first: int, last: int
) -> tuple[NDArray[np.float32], Keys]:
    """Return some of the reference patterns, first those all off, and their keys."""
    indices = range(first, last)
    patterns = np.zeros((len(indices), *projector_shape), np.float32)
    patterns[max(0, black_frames - first) :] = 1
    keys: Keys = [
        (BLACK_LEVEL_KEY, index) if index < black_frames else (FLOODLIT_KEY, index - black_frames)
        for index in indices
    ]
    return patterns, keys


def symmetry_patterns(
    projector_shape: tuple[int, ...], count: int, first: int, last: int
) -> tuple[NDArray[np.float32], Keys]:
    """Return some of the `count` random patterns that tell whether a rig is coaxial, and keys."""
    lit = random_signs(projector_shape, count, seed=0)[first:last] > 0
    return lit.astype(np.float32), [(SYMMETRY_KEY, index) for index in range(first, last)]


def frame_settings(rig: Rig) -> dict[str, Any]:
    """Return a rig's description without how long it takes, which shapes no frame."""
    return {name: it for name, it in rig.describe().items() if name != "seconds_per_pattern"}


def read_sensor(folder: AcquisitionFolder) -> Sensor:
    """Return the sensor that took the frames of an acquisition; errors as of its folder."""
    captured = folder.read_manifest(0, "capture")
    arrays = dict(folder.read(0, "capture", SENSOR)[0]) if SENSOR in captured else None
    return sensor_from_description(captured["rig"]["sensor"], arrays)


def _write_sensor(folder: AcquisitionFolder, sensor: Sensor) -> dict[str, Any]:
    """Write the arrays of a resampled sensor; return their entry for the manifest."""
    arrays = getattr(sensor, "arrays", None)
    if arrays is None:
        return {}
    return {SENSOR: folder.write_part(0, SENSOR, arrays(), sensor=sensor.describe())}


def _counts(rig: Rig, references: tuple[int, int]) -> tuple[int, int]:
    """Return how many all-off and all-on brackets there are."""
    return (1, 1) if isinstance(rig.sensor, ExactSensor) else references


def stands_already(folder: AcquisitionFolder, level: int, options: Mapping[str, Any]) -> bool:
    """Whether a level's manifest is about all that `run` is to capture with these `options`."""
    try:
        rig, sensor = folder.read_manifest(level, "capture")["rig"], read_sensor(folder)
    except StoreError:
        return False
    known: Any = SimpleNamespace(describe=lambda: rig, sensor=sensor, projector_shape=())
    counts = options["references"], options.get("symmetry_frames", 0)
    return _stands(folder, level, *brackets_of(known, folder, level, *counts))


def _stands(
    folder: AcquisitionFolder, level: int, of_level: Brackets, before: dict[str, Brackets]
) -> bool:
    """Whether the level's manifest stands there and is about these brackets."""
    stated = folder.standing(level, "capture", of_level.made_for)
    if stated is None or (SYMMETRY in stated) != (SYMMETRY in before):
        return False
    return all(
        stated.get(name, {}).get("fingerprint") == part.made_for for name, part in before.items()
    )


def _check_disk(
    rig: Rig, folder: AcquisitionFolder, level: int, of_level: Brackets, to_capture: int
) -> None:
    """Raise StoreError where a level's brackets, and what is made of them, don't fit."""
    merged = folder.store(level, "merge")  # of a capture before: replaced
    camera = rig.sensor, tuple(rig.camera_shape), rig.channels
    need = disk_bytes(*camera, to_capture, of_level.count)
    present = bytes_on_disk(merged) if merged.exists() else 0
    check_disk(of_level.name, need, folder.path, present)


def _check_references(
    folder: AcquisitionFolder, sensor: Sensor, shown: Mapping[str, Any], mode: str
) -> None:
    """Log what changed among the reference brackets; raise CaptureError where that is refused."""
    camera, off = camera_model_of(sensor), shown["black_frames"]
    if camera is None:
        return
    with folder.open_frames(0, REFERENCE_BRACKETS) as frames:
        count = frames.shape[0]
        samples = np.stack([sample_pixels(frames.read(n, n + 1)[0], count) for n in range(count)])
    for fault in faults_of_reference_brackets(samples[:off], samples[off:], camera):
        if mode == "refuse" and fault.exceeds(CAPTURE):
            raise CaptureError(
                f"black and white pictures show that {fault.text}. The capture ends here; "
                f"{recovery_advice(folder, 0, shown['rig'].get('kind', ''))}"
            )
        _log.warning("black and white pictures show that %s", fault.text)


def _warm_up(rig: Rig, folder: AcquisitionFolder, seconds: float) -> None:
    """Show the all-on pattern for some seconds, unless brackets were taken that recently."""
    journals = [journal.stat().st_mtime for journal in folder.path.glob("L*/*.zarr/journal.jsonl")]
    if not seconds or (journals and time.time() - max(journals) < seconds):
        return
    _log.info("the lamp warms up for %.3g minutes (capture.warm_up_minutes)", seconds / 60)
    end = time.monotonic() + seconds
    for index in count():
        # some devices show a pattern as long as its bracket takes
        rig.capture(np.ones((1, *rig.projector_shape), np.float32), [(WARM_UP_KEY, index)])
        rest = end - time.monotonic()
        if rest <= 0:
            return
        time.sleep(min(_SECONDS_BETWEEN_BRACKETS, rest))


def _bytes_in_hand(rig: Rig) -> int:
    """Memory that a pattern takes while it is shown and stored."""
    bracket = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
    # The pattern and its picture may pass through a float64 operator; a simulated sensor draws
    # the noise of an exposure from some float32 images.
    doubles = 2 * prod(rig.projector_shape) + 4 * prod(rig.camera_shape) * rig.channels
    return 2 * bracket * rig.sensor.frame_dtype.itemsize + 8 * doubles
