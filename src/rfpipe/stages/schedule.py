"""Stage: the patterns of a level, from what the levels above it found."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from rfpipe.patterns import Schedule
from rfpipe.provenance import fingerprint
from rfpipe.stages.plan import AcquisitionFolder, Plan, advice_on_damage, restore_state
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
    store, manifest = folder.store(level, "schedule"), folder.manifest(level, "schedule")
    made_from = fingerprint(
        {
            "plan": plan.describe(),
            "refine": folder.refined_above(level),
            "code": code,
        }
    )
    if accept_bundle(store, manifest, made_from, believing=folder.believing):
        return
    schedule = plan.method.schedule(restore_state(plan, folder, level))
    arrays: dict[str, NDArray[Any]] = {}
    if schedule.weights is not None:
        arrays["weights"] = schedule.weights
    if schedule.pattern_of_ray is not None:
        arrays["pattern_of_ray"] = schedule.pattern_of_ray
    facts = {
        "stage": "schedule",
        "level": level,
        "patterns": schedule.count,
        "complete": schedule.complete,
        "shown": schedule.digest(),
        "shape": list(schedule.shape),
        "units": _UNITS if schedule.weights is None else _WEIGHT_UNITS,
    }
    write_bundle(store, manifest, made_from, arrays, facts)


def read_schedule(folder: AcquisitionFolder, level: int) -> Schedule:
    """Read the schedule of a level.

    Raises
    ------
    StoreError, IntegrityError
        When it is missing or damaged.
    """
    bundle = folder.bundle(level, "schedule")
    with advice_on_damage(folder.manifest(level, "schedule")):
        arrays = {name: bundle.read(name) for name in bundle.names}
    facts = bundle.attributes["facts"]
    return Schedule(
        level, tuple(facts["shape"]), facts["patterns"], complete=facts["complete"], **arrays
    )
