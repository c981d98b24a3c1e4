"""Collections acquired in this process, on files."""

from __future__ import annotations

from pathlib import Path

from rfpipe.config import Config
from rfpipe.jobs.workers import Resources
from rfpipe.stages import acquisition, captures
from rfpipe.stages.plan import Plan, rig_of, stages_of
from rfpipe.storage.files import AcquisitionFolder
from rfpipe.store import StoreLock

__all__ = ["acquire_item"]


def acquire_item(settings: Config, scene: str, method: str, results: Path) -> Path:
    """Acquire one scene by one method, as a job of the workflow does; return its folder."""
    folder = results / scene / method
    rig = captures.by_simulation(**rig_of(settings, scene)["rig"], threads=1)
    plan = Plan.of(**plan_settings(settings, scene, method))
    stages = stages_of(settings, scene, method)
    with StoreLock(folder):
        acquisition.run(plan, AcquisitionFolder(folder), rig, stages, Resources())
    return folder
