"""A job of an acquisition: what its script works on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import Any

from rfpipe.errors import DamagedStageError
from rfpipe.stages.folder import AcquisitionFolder, clear
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.store import StoreLock


@dataclass(frozen=True)
class StageJob:
    """What a job of an acquisition works on.

    Attributes
    ----------
    folder : AcquisitionFolder
    level : int
        0 where the job is of no level.
    params : snakemake.io.Params
        The rule's.
    resources : Resources
    asked : snakemake.io.Resources
        All of the job's resources.
    """

    folder: AcquisitionFolder
    level: int
    params: Any
    resources: Resources
    asked: Any

    @cached_property
    def plan(self) -> Plan:
        """The plan of the rule's parameters."""
        return Plan(**self.params.plan)

    @cached_property
    def capture(self) -> Callable[..., None]:
        """The capture stage with its rig, which alone loads what rigs need."""
        from rfpipe.stages import captures

        return captures.of_job(self)

    def do(self, rule: str) -> None:
        """Do the stage of a rule; each loads what it needs alone."""
        if rule.startswith("capture"):
            stage: Callable[..., None] = partial(self.capture, resources=self.resources.here)
        else:
            stage = import_module(f"rfpipe.stages.{rule}").run
            if rule != "merge":
                stage = partial(stage, self.plan)
            if rule in ("merge", "refine"):
                stage = partial(stage, resources=self.resources)
        of_level = () if rule == "assemble" else (self.level,)
        stage(self.folder, *of_level, **self.params.settings)


@contextmanager
def stage_job(snakemake: Any) -> Iterator[StageJob]:
    """Begin a job of an acquisition, which no other process works on meanwhile.

    Parameters
    ----------
    snakemake : object
        As Snakemake gives it to the job's script.

    Raises
    ------
    LockedError
        When another process works on the same acquisition, such as a job that outlived a workflow
        that was killed.
    DamagedStageError
        When a stage before is damaged. Its manifest is removed, but a capture's, so that the next
        run makes it anew.
    """
    start(snakemake.log[0])
    wildcards = snakemake.wildcards
    folder = AcquisitionFolder(Path("results", wildcards.scene, wildcards.method))
    level = int(wildcards.get("level", 0))
    resources = Resources.of_job(snakemake)
    with StoreLock(folder.path):
        try:
            yield StageJob(folder, level, snakemake.params, resources, snakemake.resources)
        except DamagedStageError as error:
            if not clear(error):
                raise
            raise DamagedStageError(
                f"{str(error).partition('. To do so')[0]}. {error.manifest} is removed: the next "
                "run makes it anew",
                error.manifest,
            ) from error
