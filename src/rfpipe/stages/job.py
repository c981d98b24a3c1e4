"""A job of the workflow: one stage of a level, or all stages of an acquisition."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rfpipe.errors import DamagedStageError
from rfpipe.jobs.job import start
from rfpipe.jobs.workers import Resources
from rfpipe.stages import assemble
from rfpipe.stages.acquisition import LEVEL_STAGES
from rfpipe.stages.context import Acquisition, CaptureContext
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import RigSource, rig_source
from rfpipe.stages.settings import (
    OPERATING_SETTINGS,
    AcquisitionSettings,
    operating_settings_from_text,
)
from rfpipe.storage.damage import clear
from rfpipe.storage.files import FolderStorage
from rfpipe.store import StoreLock

_BEFORE_SYMMETRY = ("acquire", "schedule")
"""Rules that begin with the method that the shapes of the rays allow."""


@dataclass(frozen=True)
class StageJob:
    """A job of an acquisition.

    Attributes
    ----------
    snakemake : object
        Snakemake's description of the job: wildcards, params, resources and threads.
    level : int
        Number of the level; 0 for jobs of no level.
    storage : FolderStorage
    """

    snakemake: Any
    level: int
    storage: FolderStorage

    def run(self, rule: str) -> None:
        """Run the stage of a rule."""
        stage = "capture" if rule.startswith("capture") else rule
        if stage in ("capture", "merge"):
            LEVEL_STAGES[stage](self.capture_context(), self.level)
        elif stage == "assemble":
            assemble.run(self.acquisition(rule))
        else:
            LEVEL_STAGES[stage](self.acquisition(rule), self.level)

    def capture_context(self) -> CaptureContext:
        """Return the inputs of stages that don't depend on the method."""
        return CaptureContext(
            self.storage, self._settings(), Resources.of_job(self.snakemake), self._rig_source()
        )

    def acquisition(self, rule: str) -> Acquisition:
        """Return the inputs of stages; after level 0's merge, with the method for the rig."""
        plan = Plan.of(**self.snakemake.params.plan)
        if self.level > 0 or rule not in _BEFORE_SYMMETRY:
            is_logged = rule == "normalize" and self.level == 0
            plan = plan.for_measured_rig(self.storage, is_logged=is_logged)
        context = self.capture_context()
        return Acquisition(
            context.storage, context.settings, context.resources, context.rig_source, plan=plan
        )

    def _settings(self) -> AcquisitionSettings:
        """Settings from the rule's parameters, and from its resources, which change no result."""
        resources = self.snakemake.resources
        texts = {name: getattr(resources, name) for name in OPERATING_SETTINGS}
        return AcquisitionSettings(
            **self.snakemake.params.settings, **operating_settings_from_text(texts)
        )

    def _rig_source(self) -> RigSource | None:
        """Source of the rig of rules that capture, None for all others."""
        params, resources = self.snakemake.params, self.snakemake.resources
        if not hasattr(params, "rig"):
            return None
        access = {}
        if params.rig["kind"] == "remote":
            access = {
                "url": resources.rig_url,
                "token_file": resources.rig_token_file or None,
                "patience_seconds": float(resources.rig_patience_seconds or 0),
                "placing": resources.rig_placing,
            }
        return rig_source(**params.rig, threads=self.snakemake.threads, **access)


@contextmanager
def stage_job(snakemake: Any) -> Iterator[StageJob]:
    """Begin a job of an acquisition; no other process works on the acquisition meanwhile.

    Raises
    ------
    LockedError
        When another process does, such as a job that outlived a workflow that was killed.
    DamagedStageError
        When the result of an earlier stage is damaged. Its manifest is removed, except a
        capture's, so that the next run makes it again.
    """
    start(snakemake.log[0])
    wildcards = snakemake.wildcards
    storage = FolderStorage(Path("results", wildcards.scene, wildcards.method))
    level = int(wildcards.get("level", 0))
    with StoreLock(storage.path):
        try:
            yield StageJob(snakemake, level, storage)
        except DamagedStageError as error:
            if not clear(error):
                raise
            raise DamagedStageError(
                error.what,
                value=error.value,
                place=error.place,
                remedy=f"{error.manifest} is removed: the next run makes it anew",
                manifest=error.manifest,
            ) from error
