"""Stage: the patterns of a level, from what the levels above it found."""

from __future__ import annotations

import logging
from typing import Any

from rfpipe.errors import InputError
from rfpipe.patterns import Schedule
from rfpipe.provenance import fingerprint, versions
from rfpipe.stages.plan import Plan
from rfpipe.storage.files import AcquisitionFolder

_log = logging.getLogger(__name__)

_UNITS = "number of the pattern that lights a ray, -1 for none"
_WEIGHT_UNITS = "fraction of full light"


def run(plan: Plan, folder: AcquisitionFolder, level: int, code: str) -> None:
    """Write the schedule of a level and its manifest; InputError when it has no patterns."""
    if level:
        plan.settle(folder)
    method = plan.method if level else plan.named
    made_from = fingerprint(
        {"plan": plan.describe(method), "refine": folder.refined_above(level), "code": code}
    )
    if folder.standing(level, "schedule", made_from):
        return
    schedule = method.schedule(plan.state_before(folder, level))
    if level and not schedule.count:
        raise InputError(f"{folder.path}: level {level} has no patterns to show")
    _warn_of_many(plan, folder, schedule)
    write_schedule(folder, made_from, schedule, coaxial=method.needs_coaxial_rig)


def _warn_of_many(plan: Plan, folder: AcquisitionFolder, schedule: Schedule) -> None:
    """Say beforehand where a method that adapts takes more patterns than brute force would."""
    above = folder.levels_above(schedule.level)
    total = schedule.count + sum(folder.read_manifest(k, "schedule")["patterns"] for k in above)
    if plan.method.trades and total > plan.projector.size:
        _log.warning(
            "level %d makes it %d patterns, where brute force takes %d: more may be asked for than "
            "the scene's light allows",
            schedule.level, total, plan.projector.size,
        )  # fmt: skip


def write_schedule(
    folder: AcquisitionFolder, made_from: str, schedule: Schedule, **facts: Any
) -> None:
    """Write a schedule, and a manifest that says nothing but what is to be shown.

    The manifest of the same patterns stays the same, whatever they follow from: by that Snakemake
    knows that they needn't be captured again.
    """
    held = {"weights": schedule.weights, "pattern_of_ray": schedule.pattern_of_ray}
    arrays = {name: array for name, array in held.items() if array is not None}
    stated = {
        "stage": "schedule",
        "level": schedule.level,
        "patterns": schedule.count,
        "complete": schedule.complete,
        "shown": schedule.digest(),
        "shape": list(schedule.shape),
        "units": _UNITS if schedule.weights is None else _WEIGHT_UNITS,
        **facts,
    }
    made = {"fingerprint": made_from, "versions": versions()}
    folder.write_part(schedule.level, "schedule", arrays, facts=stated, **made)
    folder.write_manifest(schedule.level, "schedule", stated)


def read_schedule(folder: AcquisitionFolder, level: int) -> Schedule:
    """Read the schedule of a level; errors as `AcquisitionFolder.read`."""
    arrays, attributes = folder.read(level, "schedule")
    facts = attributes["facts"]
    return Schedule(
        level, tuple(facts["shape"]), facts["patterns"], complete=facts["complete"], **arrays
    )
