"""A job of an acquisition: what its script works on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rfpipe.errors import DamagedStageError
from rfpipe.stages.folder import AcquisitionFolder, clear
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.store import StoreLock

__all__ = ["StageJob", "stage_job"]


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

    @property
    def settings(self) -> Any:
        """The settings of the job's stage, or stages."""
        return self.params.settings

    @cached_property
    def plan(self) -> Plan:
        """The plan of the rule's parameters."""
        return Plan(**self.params.plan)


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
    from rfpipe.stages.folder import AcquisitionFolder
    from rfpipe.stages.jobs.workers import Resources

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
