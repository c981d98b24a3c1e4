"""Stage: the factors that make a level's images add up to the floodlit image [B.2]."""

from __future__ import annotations

import numpy as np

from rfpipe.photometry.normalize import Mode, Normalization
from rfpipe.provenance import fingerprint
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.merge import SUMS, read_level_sum
from rfpipe.stages.merging.images import known_light, normalize_level
from rfpipe.stages.merging.references import REFERENCES, read_floodlit
from rfpipe.stages.plan import Plan
from rfpipe.stages.results import standing, write_bundle
from rfpipe.stages.schedule import read_schedule

__all__ = ["read_normalization", "run"]


def run(plan: Plan, folder: AcquisitionFolder, level: int, *, mode: Mode, code: str) -> None:
    """Compare a level's images with the floodlit image; write the factors and their manifest.

    The images aren't read here, since the merge has added them up, nor written a second time: who
    reads them applies the factors on the way.

    Parameters
    ----------
    plan : Plan
    folder : AcquisitionFolder
    level : int
    mode : {"none", "per_channel", "total_energy"}
    code : str
        Digest of the code behind the stage.
    """
    plan.settle(folder, aloud=level == 0)
    manifest = folder.manifest(level, "normalize")
    planned = folder.read_manifest(level, "schedule")
    made_of = {
        "merge": folder.read_manifest(level, "merge")[SUMS]["digest"],
        "references": folder.read_manifest(0, "merge")[REFERENCES]["digest"],
        "schedule": [planned["shown"], planned["complete"]],
        "mode": mode,
        "noise_significance": plan.options.noise_significance,
        "code": code,
    }
    # What is known already counts only where the level leaves rays dark.
    if not planned["complete"] and mode != "none":
        made_of |= {"plan": plan.describe(), "refine": folder.refined_above(level)}
    made_from = fingerprint(made_of)
    if standing(manifest, made_from):
        return
    schedule = read_schedule(folder, level)
    known = None
    if "refine" in made_of:
        known = known_light(plan.method, plan.state_before(folder, level), schedule)
    found = normalize_level(
        schedule,
        read_level_sum(folder, level),
        read_floodlit(folder),
        known,
        mode,
        plan.options.noise_significance,
    )
    facts = {
        "stage": "normalize",
        "level": level,
        "mode": mode,
        "units": {"gain": "1", "covered": "whether scaled"},
        "covered_fraction": float(np.mean(found.covered)),
    }
    arrays = {"gain": found.gain, "covered": found.covered}
    write_bundle(manifest, made_from, arrays, facts)


def read_normalization(folder: AcquisitionFolder, level: int) -> Normalization:
    """Read the factors of a level.

    Raises
    ------
    StoreError, IntegrityError
        When they are missing or damaged.
    """
    arrays, attributes = folder.read(level, "normalize")
    return Normalization(arrays["gain"], arrays["covered"], attributes["facts"]["mode"])
