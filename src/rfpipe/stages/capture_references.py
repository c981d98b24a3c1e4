"""Capture of the reference brackets: a first set, then as many more as the target error needs."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry import ExactSensor, Sensor
from rfpipe.references.check_pictures import recovery_advice
from rfpipe.references.reference_brackets import (
    FIRST_ALL_OFF,
    FIRST_ALL_ON,
    REFERENCE_PARTS,
    ReferenceCounts,
    ReferenceNoise,
    counts_of_set,
)
from rfpipe.references.steadiness import (
    camera_model_of,
    faults_of_reference_brackets,
    sample_pixels,
)
from rfpipe.rigs import Rig
from rfpipe.rigs.faults import CAPTURE
from rfpipe.stages.brackets import BracketSet, Keys, capture_brackets
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.storage.base import (
    MORE_REFERENCE_BRACKETS,
    REFERENCE_BRACKETS,
    REFERENCE_GOAL,
    Facts,
    Storage,
)
from rfpipe.units import BLACK_LEVEL_KEY, FLOODLIT_KEY

_NONE = ReferenceCounts(0, 0)

_log = logging.getLogger(__name__)


def first_reference_set(
    shape: tuple[int, ...], settings: AcquisitionSettings, described: Facts, *, is_exact: bool
) -> BracketSet:
    """Return the reference brackets with which level 0 begins; see `bracket_sets`."""
    return _reference_set(REFERENCE_BRACKETS, shape, described, _first_counts(settings, is_exact))


def reference_goal(settings: AcquisitionSettings, *, is_exact: bool) -> Facts:
    """Return the target from which the number of brackets follows; empty for a given number."""
    if is_exact or (settings.all_off_brackets and settings.all_on_brackets):
        return {}
    goal = {
        "target_error": settings.target_error,
        "expected_patterns": settings.expected_patterns,
    }
    return {REFERENCE_GOAL: goal}


def capture_references(
    rig: Rig, context: CaptureContext, first_set: BracketSet, batch: int
) -> Facts:
    """Capture the reference brackets, and check them; return their entries for the manifest.

    Raises
    ------
    CaptureError
        As `capture_brackets`; and if the rig or its light changed between the brackets and `watch`
        is "refuse".
    """
    storage, settings = context.storage, context.settings
    is_exact = isinstance(rig.sensor, ExactSensor)
    facts = reference_goal(settings, is_exact=is_exact)
    facts |= _captured(rig, context, first_set, batch)
    if facts.get(REFERENCE_GOAL):
        before = _first_counts(settings, is_exact)
        more = _further_counts(rig.sensor, storage, settings, before)
        described, shape = first_set.settings["rig"], tuple(rig.projector_shape)
        if sum(more):
            _log.info(
                "%d more all-off and %d more all-on brackets: the target error needs them", *more
            )
            brackets = _reference_set(MORE_REFERENCE_BRACKETS, shape, described, more, before)
            storage.make_room(
                0, brackets.part, brackets.fingerprint, brackets.settings,
                settings.when_patterns_change,
            )  # fmt: skip
            facts |= _captured(rig, context, brackets, batch)
    if settings.watch != "off":
        rig_kind = first_set.settings["rig"].get("kind", "")
        _check_references(context, rig.sensor, facts, rig_kind)
    return facts


def reference_patterns(
    projector_shape: tuple[int, ...],
    counts: ReferenceCounts,
    before: ReferenceCounts,
    first: int,
    last: int,
) -> tuple[NDArray[np.float32], Keys]:
    """Return patterns ``first:last`` of a set, all-off or all-on, and their keys.

    The numbers in the keys continue after the reference brackets `before` the set.
    """
    is_off = counts.is_off
    number = np.where(is_off, np.cumsum(is_off), np.cumsum(~is_off)) - 1
    patterns = np.zeros((last - first, *projector_shape), np.float32)
    patterns[~is_off[first:last]] = 1
    keys: Keys = [
        (BLACK_LEVEL_KEY, before.all_off + int(number[index]))
        if is_off[index]
        else (FLOODLIT_KEY, before.all_on + int(number[index]))
        for index in range(first, last)
    ]
    return patterns, keys


def _first_counts(settings: AcquisitionSettings, is_exact: bool) -> ReferenceCounts:
    if is_exact:
        return ReferenceCounts(1, 1)
    return ReferenceCounts(
        settings.all_off_brackets or FIRST_ALL_OFF, settings.all_on_brackets or FIRST_ALL_ON
    )


def _reference_set(
    part: str,
    shape: tuple[int, ...],
    described: Facts,
    counts: ReferenceCounts,
    before: ReferenceCounts = _NONE,
) -> BracketSet:
    facts = {"all_off_brackets": counts.all_off, "all_on_brackets": counts.all_on, "rig": described}
    patterns = partial(reference_patterns, shape, counts, before)
    return BracketSet(0, part, part.replace("_", " "), sum(counts), facts, patterns)


def _captured(rig: Rig, context: CaptureContext, brackets: BracketSet, batch: int) -> Facts:
    """Capture a set of reference brackets; return its entry for the manifest."""
    entry = capture_brackets(
        rig, context.storage, brackets, batch, progress=context.settings.progress
    )
    counts = {key: value for key, value in brackets.settings.items() if key != "rig"}
    return {brackets.part: {**entry, **counts}}


def _further_counts(
    sensor: Sensor, storage: Storage, settings: AcquisitionSettings, before: ReferenceCounts
) -> ReferenceCounts:
    """Compute the numbers of further brackets from the noise of those `before` them."""
    with storage.partial_brackets(0, REFERENCE_BRACKETS) as store:
        brackets, is_off = store.read(0, sum(before)), before.is_off
    noise = ReferenceNoise.of(sensor, brackets[is_off], brackets[~is_off])
    needed = noise.needed(settings.target_error, settings.expected_patterns)
    return ReferenceCounts(
        0 if settings.all_off_brackets else max(0, needed.all_off - before.all_off),
        0 if settings.all_on_brackets else max(0, needed.all_on - before.all_on),
    )


def _check_references(context: CaptureContext, sensor: Sensor, facts: Facts, rig_kind: str) -> None:
    """Log what changed among the reference brackets; raise CaptureError where that is refused."""
    storage, camera = context.storage, camera_model_of(sensor)
    if camera is None:
        return
    all_off: list[NDArray[Any]] = []
    all_on: list[NDArray[Any]] = []
    parts = [part for part in REFERENCE_PARTS if part in facts]
    total = sum(facts[part]["shape"][0] for part in parts)
    for part in parts:
        with storage.partial_brackets(0, part) as store:
            for index, is_off in enumerate(counts_of_set(facts[part]).is_off):
                samples = sample_pixels(store.read(index, index + 1)[0], total)
                (all_off if is_off else all_on).append(samples)
    for fault in faults_of_reference_brackets(np.stack(all_off), np.stack(all_on), camera):
        if context.settings.watch == "refuse" and fault.exceeds(CAPTURE):
            raise CaptureError(
                f"all-off and all-on pictures show that {fault.text}. The capture ends here",
                remedy=recovery_advice(storage, 0, rig_kind),
            )
        _log.warning("all-off and all-on pictures show that %s", fault.text)
