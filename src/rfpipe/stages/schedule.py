"""Stage: the patterns of a level, chosen by the method's state."""

from __future__ import annotations

import logging
from typing import Any

from rfpipe.errors import InputError
from rfpipe.patterns import Schedule
from rfpipe.provenance import fingerprint, versions
from rfpipe.stages.context import Acquisition
from rfpipe.storage.base import Storage

_log = logging.getLogger(__name__)

_UNITS = "number of the pattern that lights a ray, -1 for none"
_WEIGHT_UNITS = "fraction of full light"


def run(acquisition: Acquisition, level: int) -> None:
    """Write the schedule of a level and its manifest.

    The manifest of a complete acquisition has 0 patterns.
    """
    plan, storage = acquisition.plan, acquisition.storage
    inputs_fingerprint = fingerprint(
        {
            "plan": plan.describe(),
            "refine": acquisition.refined_digests(level),
            "code": acquisition.settings.code,
        }
    )
    if storage.current_manifest(level, "schedule", inputs_fingerprint):
        return
    schedule = plan.method.next_schedule(acquisition.state_before(level))
    if schedule is None:
        facts = {"stage": "schedule", "level": level, "patterns": 0}
        storage.write_part(level, "schedule", {}, facts=facts, fingerprint=inputs_fingerprint)
        storage.write_manifest(level, "schedule", facts)
        return
    if not schedule.count:
        raise InputError(
            f"{plan.method.name} scheduled level {level} without patterns",
            remedy="return None from next_schedule when the method is done",
        )
    _warn_of_many_patterns(acquisition, level, schedule.count)
    write_schedule(
        storage, level, inputs_fingerprint, schedule, coaxial=plan.method.needs_coaxial_rig
    )


def _warn_of_many_patterns(acquisition: Acquisition, level: int, patterns: int) -> None:
    """Warn where a method that adapts takes more patterns than brute force would."""
    plan, storage = acquisition.plan, acquisition.storage
    earlier = sum(storage.read_manifest(k, "schedule")["patterns"] for k in range(level))
    if plan.method.trades and earlier + patterns > plan.projector.size:
        _log.warning(
            "level %d makes it %d patterns, where brute force takes %d: the target may be "
            "unreachable at this light level",
            level, earlier + patterns, plan.projector.size,
        )  # fmt: skip


def write_schedule(
    storage: Storage, level: int, inputs_fingerprint: str, schedule: Schedule, **facts: Any
) -> None:
    """Write a schedule, and a manifest that depends on its patterns alone.

    The manifest of equal patterns is equal, so that Snakemake doesn't capture them again when
    their inputs changed.
    """
    optional = {"weights": schedule.weights, "pattern_of_ray": schedule.pattern_of_ray}
    arrays = {name: array for name, array in optional.items() if array is not None}
    manifest = {
        "stage": "schedule",
        "level": level,
        "patterns": schedule.count,
        "complete": schedule.complete,
        "pattern_digest": schedule.digest(),
        "seed": schedule.seed,
        "shape": list(schedule.shape),
        "units": _UNITS if schedule.weights is None else _WEIGHT_UNITS,
        **facts,
    }
    stamp = {"fingerprint": inputs_fingerprint, "versions": versions()}
    storage.write_part(level, "schedule", arrays, facts=manifest, **stamp)
    storage.write_manifest(level, "schedule", manifest)


def read_schedule(storage: Storage, level: int) -> Schedule:
    """Read the schedule of a level; errors as `Storage.read`."""
    arrays, attributes = storage.read(level, "schedule")
    facts = attributes["facts"]
    return Schedule(
        facts["seed"],
        tuple(facts["shape"]),
        facts["patterns"],
        complete=facts["complete"],
        **arrays,
    )
