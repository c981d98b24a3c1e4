"""Stage: display the patterns of a level and store their brackets, pattern by pattern."""

from __future__ import annotations

import logging
import time
from functools import partial
from itertools import count
from math import prod

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.symmetry import random_signs
from rfpipe.errors import StoreError
from rfpipe.jobs.job import Progress
from rfpipe.photometry import ExactSensor, Sensor, sensor_from_description
from rfpipe.references.calibration_check import check_calibration
from rfpipe.rigs import Rig
from rfpipe.rigs.base import sequence_patterns
from rfpipe.stages.brackets import BracketSet, Keys, capture_brackets
from rfpipe.stages.capture_references import (
    capture_references,
    first_reference_set,
    reference_goal,
)
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.forecast import disk_bytes
from rfpipe.stages.schedule import read_schedule
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.stages.watch import watching_level
from rfpipe.steps import displayed_by
from rfpipe.storage.base import (
    REFERENCE_BRACKETS,
    SENSOR,
    SYMMETRY,
    VERIFICATION,
    Facts,
    Storage,
    level_name,
)
from rfpipe.text import counted
from rfpipe.units import (
    COUNT_UNIT,
    COUNTS,
    RADIANCE_UNIT,
    SYMMETRY_KEY,
    WARM_UP_KEY,
)

_SECONDS_BETWEEN_BRACKETS = 30.0  # of the all-on pattern, while the lamp warms up

_log = logging.getLogger(__name__)


def run(context: CaptureContext, level: int) -> None:
    """Capture the missing brackets of a level, and write its manifest.

    Raises
    ------
    StaleStoreError
        When patterns changed and `when_patterns_change` is "refuse"; says what differs.
    StoreError
        When the level doesn't fit on the disk, or another process writes it. No pattern is
        displayed then.
    CaptureError
        When the rig fails, returns invalid frames, or changed and `watch` is "refuse". What is
        captured stays.
    """
    source = context.rig_source
    assert source is not None
    if source.recorded_rig_suffices and _is_captured_by_recorded_rig(context, level):
        return
    with source.rig(context.storage, level) as rig:
        capture_level(rig, context, level)


def capture_level(rig: Rig, context: CaptureContext, level: int) -> None:
    """Capture the missing brackets of a level by a rig; see `run`."""
    storage, settings = context.storage, context.settings
    described = storage.describe_rig(rig)
    sets = bracket_sets(storage, level, settings, described, is_exact=_is_exact(rig.sensor))
    of_level, first_sets = sets[-1], sets[:-1]
    goal = _reference_goal(settings, level, rig.sensor)
    if _is_captured(storage, level, sets, goal):
        if of_level.count:
            _log.info("%s: complete, with %s", of_level.name, counted(of_level.count, "pattern"))
        return
    for brackets in sets:
        storage.make_room(
            level, brackets.part, brackets.fingerprint, brackets.settings,
            settings.when_patterns_change,
        )  # fmt: skip
    to_capture = sum(brackets.count_missing(storage) for brackets in sets)
    if to_capture:
        camera = rig.sensor, tuple(rig.camera_shape), rig.channels
        storage.check_space(level, disk_bytes(*camera, to_capture, of_level.count))
        _warm_up(rig, storage, 60 * settings.warm_up_minutes)
    batch = _batch_patterns(rig, context)
    parts: Facts = {} if level else _write_sensor(storage, rig.sensor)
    # a simulated scene may be recorded at its first picture
    with displayed_by(partial(Progress, unit="step", is_visible=settings.progress)):
        for brackets in first_sets:
            if brackets.part == REFERENCE_BRACKETS:
                parts |= capture_references(rig, context, brackets, batch)
                continue
            entry = capture_brackets(rig, storage, brackets, batch, progress=settings.progress)
            parts[brackets.part] = {**entry, "symmetry_brackets": brackets.count}
    captured = _capture_watched(rig, context, of_level, batch)
    manifest = {
        "stage": "capture",
        "level": level,
        "patterns": of_level.count,
        "units": COUNT_UNIT if rig.sensor.frame_dtype == COUNTS else RADIANCE_UNIT,
        "exposures_s": list(rig.sensor.exposures),
        "rig": described,
        **captured,
        **parts,
    }
    storage.write_manifest(level, "capture", manifest)


def _capture_watched(rig: Rig, context: CaptureContext, brackets: BracketSet, batch: int) -> Facts:
    """Capture a level's patterns with check pictures between them; return their entries."""
    storage, settings, level = context.storage, context.settings, brackets.level
    interval = settings.check_interval
    interval = max(interval, sequence_patterns(rig)) if interval else 0
    with watching_level(rig, storage, brackets, settings.watch, interval) as watcher:
        if watcher and watcher.references and level != VERIFICATION:
            # taken first, since unsteady gain or light looks like misalignment
            watcher.before(0)
            check_calibration(
                storage, level, watcher.references, brackets.settings["rig"],
                settings.accepted_asymmetry, refuse=watcher.is_refusing,
            )  # fmt: skip
        entry = capture_brackets(rig, storage, brackets, batch, watcher, progress=settings.progress)
        return {**entry, **(watcher.entries() if watcher else {})}


def bracket_sets(
    storage: Storage,
    level: int,
    settings: AcquisitionSettings,
    described: Facts,
    *,
    is_exact: bool,
) -> list[BracketSet]:
    """Return the sets of brackets of a level, in their order; its own patterns are the last.

    Parameters
    ----------
    described : dict
        Description of the rig.
    is_exact : bool
        Whether the sensor measures exact radiance, which takes one all-off and one all-on bracket.
    """
    schedule = read_schedule(storage, level)
    shape = schedule.shape

    def schedule_patterns(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
        keys: Keys = [(schedule.seed, index) for index in range(first, last)]
        return schedule.batch(first, last), keys

    sets = []
    if level == 0:
        sets.append(first_reference_set(shape, settings, described, is_exact=is_exact))
    if level == 0 and settings.symmetry_brackets:
        count = settings.symmetry_brackets
        patterns = partial(symmetry_patterns, shape, count)
        counts = {"symmetry_brackets": count, "rig": described}
        name = "brackets of random patterns"
        sets.append(BracketSet(level, SYMMETRY, name, count, counts, patterns))
    attributes = {
        "patterns": schedule.count, "pattern_digest": schedule.digest(), "rig": described,
    }  # fmt: skip
    name = level_name(level)
    return [
        *sets,
        BracketSet(level, "capture", name, schedule.count, attributes, schedule_patterns),
    ]


def symmetry_patterns(
    projector_shape: tuple[int, ...], count: int, first: int, last: int
) -> tuple[NDArray[np.float32], Keys]:
    """Return ``first:last`` of `count` random patterns that measure the symmetry, and keys."""
    lit = random_signs(projector_shape, count, seed=0)[first:last] > 0
    return lit.astype(np.float32), [(SYMMETRY_KEY, index) for index in range(first, last)]


def read_sensor(storage: Storage) -> Sensor:
    """Return the sensor that took the frames of an acquisition; errors as `Storage.read`."""
    captured = storage.read_manifest(0, "capture")
    arrays = dict(storage.read(0, "capture", SENSOR)[0]) if SENSOR in captured else None
    return sensor_from_description(captured["rig"]["sensor"], arrays)


def _write_sensor(storage: Storage, sensor: Sensor) -> Facts:
    """Write the arrays of a resampled sensor; return their entry for the manifest."""
    arrays = sensor.arrays()
    if not arrays:
        return {}
    return {SENSOR: storage.write_part(0, SENSOR, arrays, sensor=sensor.describe())}


def _is_exact(sensor: Sensor) -> bool:
    return isinstance(sensor, ExactSensor)


def _is_captured_by_recorded_rig(context: CaptureContext, level: int) -> bool:
    """Test whether a level is captured with these settings by the rig of its manifest."""
    storage = context.storage
    try:
        described, sensor = storage.read_manifest(level, "capture")["rig"], read_sensor(storage)
    except StoreError:
        return False
    sets = bracket_sets(storage, level, context.settings, described, is_exact=_is_exact(sensor))
    return _is_captured(storage, level, sets, _reference_goal(context.settings, level, sensor))


def _reference_goal(settings: AcquisitionSettings, level: int, sensor: Sensor) -> Facts:
    return {} if level else reference_goal(settings, is_exact=_is_exact(sensor))


def _is_captured(storage: Storage, level: int, sets: list[BracketSet], goal: Facts) -> bool:
    """Test whether the level's manifest is about these sets of brackets, and this goal."""
    *first_sets, of_level = sets
    facts = storage.current_manifest(level, "capture", of_level.fingerprint)
    parts = {brackets.part for brackets in first_sets}
    if facts is None or (SYMMETRY in facts) != (SYMMETRY in parts):
        return False
    if any(facts.get(name) != value for name, value in goal.items()):
        return False
    return all(
        facts.get(brackets.part, {}).get("fingerprint") == brackets.fingerprint
        for brackets in first_sets
    )


def _warm_up(rig: Rig, storage: Storage, seconds: float) -> None:
    """Display the all-on pattern for some seconds, unless brackets were taken that recently."""
    if not seconds or storage.seconds_since_capture() < seconds:
        return
    _log.info("the lamp warms up for %.3g minutes (capture.warm_up_minutes)", seconds / 60)
    end = time.monotonic() + seconds
    for index in count():
        # some devices display a pattern as long as its bracket takes
        rig.capture(np.ones((1, *rig.projector_shape), np.float32), [(WARM_UP_KEY, index)])
        remaining = end - time.monotonic()
        if remaining <= 0:
            return
        time.sleep(min(_SECONDS_BETWEEN_BRACKETS, remaining))


def _batch_patterns(rig: Rig, context: CaptureContext) -> int:
    """Number of patterns displayed, then stored, at a time.

    A sequence is stored when it is complete: sequences are long, as loading them takes most of the
    time. In memory each of their patterns has its complement.
    """
    in_sequences = sequence_patterns(rig)
    pattern_bytes = _bytes_per_pattern(rig) * (2 if in_sequences else 1)
    longest = in_sequences or context.settings.batch_patterns
    return context.resources.fitting_count(pattern_bytes, longest)


def _bytes_per_pattern(rig: Rig) -> int:
    """Memory that a pattern takes while it is displayed and stored."""
    bracket = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
    # The pattern and its picture may pass through a float64 operator; a simulated sensor draws
    # the noise of an exposure from some float32 images.
    doubles = 2 * prod(rig.projector_shape) + 4 * prod(rig.camera_shape) * rig.channels
    return 2 * bracket * rig.sensor.frame_dtype.itemsize + 8 * doubles
