"""Stage: what a level's images tell about the transport, and what is left to ask."""

from __future__ import annotations

from typing import Any

from rfpipe.provenance import fingerprint
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.progress import log_estimate
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.merge import MergedFrames
from rfpipe.stages.merging.images import NormalizedImages
from rfpipe.stages.normalize import read_normalization
from rfpipe.stages.plan import Plan
from rfpipe.stages.results import accept_bundle, write_bundle
from rfpipe.stages.schedule import read_schedule
from rfpipe.units import RADIANCE_UNIT

__all__ = ["run"]


def run(
    plan: Plan,
    folder: AcquisitionFolder,
    level: int,
    code: str,
    resources: Resources | None = None,
) -> Any:
    """Refine the method's state by a level's images; write what the level added.

    Parameters
    ----------
    plan : Plan
    folder : AcquisitionFolder
    level : int
    code : str
        Fingerprint of the code behind the stage.
    resources : Resources, optional
        What the stage may use; by default one thread and 4 GiB.

    Returns
    -------
    State or None
        The method's state after the level; None where what the level added stands there already.
    """
    manifest = folder.manifest(level, "refine")
    planned = folder.read_manifest(level, "schedule")
    made_from = fingerprint(
        {
            "plan": plan.describe(),
            "refine": folder.refined_above(level),
            "schedule": [planned["shown"], planned["complete"]],
            "merge": folder.read_manifest(level, "merge")["digest"],
            "normalize": folder.read_manifest(level, "normalize")["digest"],
            "code": code,
        }
    )
    if accept_bundle(manifest, made_from, believing=folder.believing):
        return None
    state = plan.state_before(folder, level)
    schedule, factors = read_schedule(folder, level), read_normalization(folder, level)
    with folder.frames(level, "merge") as merged:
        images = NormalizedImages(schedule, MergedFrames(merged), factors)
        state = plan.method.refine(state, images, (resources or Resources()).data_bytes)
    log_estimate(state.rows, plan.options)
    pack = plan.method.pack(state)
    facts = {
        "stage": "refine",
        "method": plan.name,
        "level": level,
        "patterns": planned["patterns"],
        "units": RADIANCE_UNIT,
    }
    write_bundle(manifest, made_from, pack.arrays, facts, state=dict(pack.attributes))
    return state
