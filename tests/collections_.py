"""Collections acquired in this process, on files."""

from __future__ import annotations

from pathlib import Path

from rfpipe.config import Config
from rfpipe.stages import captures, levels
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.settings import stages_of
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan, plan_of

__all__ = ["acquire_item"]


def acquire_item(settings: Config, scene: str, method: str, results: Path) -> Path:
    """Acquire one scene by one method, as a job of the workflow does; return its folder."""
    folder = results / scene / method
    own = settings.of_scene(scene)
    other = {"methods", "sweep", "rig", "settings", "about"}
    levels.run(
        Plan(**plan_of(settings, scene, method)),
        AcquisitionFolder(folder),
        scene,
        captures.by_simulation(
            settings.scenes[scene].model_dump(mode="json", exclude=other),
            own.camera and own.camera.model_dump(mode="json"),
            1,
            seed=own.seed,
            seconds_per_pattern=own.capture.seconds_per_pattern,
        ),
        **stages_of(settings, scene, method),
        resources=Resources(),
    )
    return folder
