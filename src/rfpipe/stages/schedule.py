"""Stage: the patterns of a level, from what the levels above it found."""

from __future__ import annotations

from typing import Any

from rfpipe.patterns import Schedule
from rfpipe.provenance import fingerprint
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.plan import Plan
from rfpipe.stages.results import accept_bundle, write_bundle

__all__ = ["read_schedule", "run"]


_UNITS = "number of the pattern that lights a ray, -1 for none"
_WEIGHT_UNITS = "fraction of full light"


def run(plan: Plan, folder: AcquisitionFolder, level: int, code: str) -> None:
    """Make the schedule of a level and write it with its manifest.

    Parameters
    ----------
    plan : Plan
    folder : AcquisitionFolder
    level : int
    code : str
        Fingerprint of the code behind the stage.
    """
    manifest = folder.manifest(level, "schedule")
    made_from = fingerprint(
        {"plan": plan.describe(), "refine": folder.refined_above(level), "code": code}
    )
    if accept_bundle(manifest, made_from, believing=folder.believing):
        return
    schedule = plan.method.schedule(plan.state_before(folder, level))
    held = {"weights": schedule.weights, "pattern_of_ray": schedule.pattern_of_ray}
    arrays = {name: array for name, array in held.items() if array is not None}
    facts = {
        "stage": "schedule",
        "level": level,
        "patterns": schedule.count,
        "complete": schedule.complete,
        "shown": schedule.digest(),
        "shape": list(schedule.shape),
        "units": _UNITS if schedule.weights is None else _WEIGHT_UNITS,
    }
    write_bundle(manifest, made_from, arrays, facts)


def read_schedule(folder: AcquisitionFolder, level: int) -> Schedule:
    """Read the schedule of a level.

    Raises
    ------
    StoreError, IntegrityError
        When it is missing or damaged.
    """
    arrays: dict[str, Any]
    arrays, attributes = folder.read(level, "schedule")
    facts = attributes["facts"]
    return Schedule(
        level, tuple(facts["shape"]), facts["patterns"], complete=facts["complete"], **arrays
    )
