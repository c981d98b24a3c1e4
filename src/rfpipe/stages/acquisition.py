"""The stages of an acquisition: one as a job of the workflow, or all of them in one process.

What stands on files already, made from the same things, is left as it is: an acquisition that was
stopped goes on where it stopped, also where jobs of single stages have begun it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.errors import DamagedStageError
from rfpipe.jobs.job import start
from rfpipe.jobs.workers import Resources
from rfpipe.storage.files import STAGES, AcquisitionFolder, clear
from rfpipe.store import StoreLock

if TYPE_CHECKING:
    from rfpipe.stages.plan import Plan

Settings = Mapping[str, Mapping[str, Any]]

_log = logging.getLogger(__name__)


def run(
    plan: Plan,
    folder: AcquisitionFolder,
    capture: Callable[..., None],
    stages: Settings,
    resources: Resources,
) -> None:
    """Acquire a scene by a method, or what is missing of it; ``transport.json`` comes last.

    The caller locks the folder. Where a stage finds an earlier one damaged, that one is made anew,
    once, unless it is a capture. Other errors are those of the stages; what is done is kept.

    Parameters
    ----------
    capture : callable
        See `rfpipe.stages.captures`.
    stages : mapping
        Keyword arguments of each stage by its name, as plain data.
    """
    cleared: set[Path] = set()
    while True:
        try:
            run_levels(plan, folder, capture, stages, resources)
            _function("assemble", plan, resources)(folder, **stages["assemble"])
        except DamagedStageError as error:
            if error.manifest in cleared or not clear(error):
                raise
            cleared.add(error.manifest)
            _log.warning("%s: made anew. %s", error.manifest, error.problem)
        else:
            return


def run_levels(
    plan: Plan,
    folder: AcquisitionFolder,
    capture: Callable[..., None],
    stages: Settings,
    resources: Resources,
) -> None:
    """Take an acquisition through all stages of all levels, whatever stands there; see `run`."""
    work = {
        name: partial(capture, resources=resources.local)
        if name == "capture"
        else _function(name, plan, resources)
        for name in STAGES
    }
    for level in folder.levels():
        for name, stage in work.items():
            with folder.doing(level, name):
                stage(folder, level, **stages[name])


def _function(name: str, plan: Plan | None, resources: Resources) -> Callable[..., None]:
    """Return the function of a stage but the capture, which loads what it needs alone."""
    stage: Callable[..., None] = import_module(f"rfpipe.stages.{name}").run
    stage = partial(stage, plan) if plan and name != "merge" else stage
    return partial(stage, resources=resources) if name in ("merge", "refine") else stage


@dataclass(frozen=True)
class StageJob:
    """What a job of an acquisition works on; level 0 where it is of no level."""

    folder: AcquisitionFolder
    level: int
    params: Any
    resources: Resources
    asked: Any

    @cached_property
    def plan(self) -> Plan:
        """The plan of the rule's parameters."""
        from rfpipe.stages.plan import Plan

        return Plan(**self.params.plan)

    @cached_property
    def capture(self) -> Callable[..., None]:
        """The capture stage with its rig, which alone loads what rigs need."""
        from rfpipe.stages import captures

        return captures.of_job(self)

    @property
    def stages(self) -> dict[str, dict[str, Any]]:
        """Keyword arguments of each stage, where the rule's parameters have several."""
        return self._in_manner(self.params.settings)

    def do(self, rule: str) -> None:
        """Do the stage of a rule."""
        name = "capture" if rule.startswith("capture") else rule
        if name == "capture":
            stage: Callable[..., None] = partial(self.capture, resources=self.resources.local)
        else:
            stage = _function(rule, None if rule == "merge" else self.plan, self.resources)
        of_level = () if rule == "assemble" else (self.level,)
        stage(self.folder, *of_level, **self._in_manner({name: self.params.settings})[name])

    def _in_manner(self, stages: Settings) -> dict[str, dict[str, Any]]:
        from rfpipe.stages.plan import MANNER, in_manner

        if not {"capture", "merge"} & set(stages):
            return {stage: dict(settings) for stage, settings in stages.items()}
        return in_manner(stages, {name: getattr(self.asked, name) for name in MANNER})


@contextmanager
def stage_job(snakemake: Any) -> Iterator[StageJob]:
    """Begin a job of an acquisition, which no other process works on meanwhile.

    Raises
    ------
    LockedError
        When another process does, such as a job that outlived a workflow that was killed.
    DamagedStageError
        When a stage before is damaged. Its manifest is removed, but a capture's, so that the next
        run makes it anew.
    """
    start(snakemake.log[0])
    wildcards = snakemake.wildcards
    folder = AcquisitionFolder(Path("results", wildcards.scene, wildcards.method))
    resources = Resources.of_job(snakemake)
    level = int(wildcards.get("level", 0))
    with StoreLock(folder.path):
        try:
            yield StageJob(folder, level, snakemake.params, resources, snakemake.resources)
        except DamagedStageError as error:
            if not clear(error):
                raise
            raise DamagedStageError(
                error.what,
                value=error.value,
                place=error.place,
                remedy=f"{error.manifest} was removed: run again, and the stage repeats its work",
                manifest=error.manifest,
            ) from error
