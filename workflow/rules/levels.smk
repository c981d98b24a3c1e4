# Levels of an acquisition. The schedule of a level has no patterns if the acquisition is complete.

from itertools import count

from rfpipe.storage.files import STAGES_LOG
from rfpipe.store import read_manifest


def refined(wildcards):
    """The refinements of all levels of an acquisition; each schedule shows if there is a next.

    Level 0 always has patterns; naming it first lets dry runs list its jobs.
    """
    folder = f"results/{wildcards.scene}/{wildcards.method}"
    refinements = [f"{folder}/L00/refine.json"]
    for level in count(1):
        scheduled = checkpoints.schedule.get(
            scene=wildcards.scene, method=wildcards.method, level=f"{level:02d}"
        )
        if not read_manifest(Path(scheduled.output[0]))["patterns"]:
            return refinements
        refinements.append(f"{folder}/L{level:02d}/refine.json")


def refined_before(wildcards):
    """The refinement of the level before a level.

    Level 0 follows the log of a job that ran all stages, since Snakemake has no records of their
    settings.
    """
    folder, level = f"results/{wildcards.scene}/{wildcards.method}", int(
        wildcards.level
    )
    if level > 0:
        return [f"{folder}/L{level - 1:02d}/refine.json"]
    log = Path(folder, STAGES_LOG)
    return [str(log)] if log.exists() else []


def scheduled(wildcards):
    """The patterns of a level: where they turn out the same, they aren't captured again."""
    return checkpoints.schedule.get(**wildcards).output[0]
