# The levels of an acquisition: how many have patterns to show turns out on the way.

from rfpipe.storage.files import STAGES_LOG
from rfpipe.store import read_manifest


def refined(wildcards, before=None):
    """The refinements of all levels of an acquisition, or of those before one."""
    found, level = [], 0
    while level is not None and level != before:
        number = {
            "scene": wildcards.scene,
            "method": wildcards.method,
            "level": f"{level:02d}",
        }
        found.append(checkpoints.refine.get(**number).output[0])
        level = read_manifest(Path(found[-1]))["next"]
    return found


def refined_before(wildcards):
    """The refinement that tells what a level has to show.

    Level 0 follows what one job has done of all stages, which left no records of their settings.
    """
    by_one_job = Path("results", wildcards.scene, wildcards.method, STAGES_LOG)
    if int(wildcards.level) == 0:
        return [str(by_one_job)] if by_one_job.exists() else []
    return refined(wildcards, before=int(wildcards.level))[-1:]


def scheduled(wildcards):
    """The patterns of a level: where they turn out the same, they aren't captured again."""
    return checkpoints.schedule.get(**wildcards).output[0]
