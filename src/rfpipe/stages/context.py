"""Inputs of the stages of an acquisition."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from rfpipe.jobs.workers import Resources
from rfpipe.photometry.sensor import Sensor
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import RigSource
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.storage.base import Storage


@dataclass(frozen=True)
class CaptureContext:
    """Inputs of the stages that don't depend on the method: capture and merge.

    Attributes
    ----------
    storage : Storage
        Results of the stages, read and written.
    settings : AcquisitionSettings
    resources : Resources
        Memory and threads; no result depends on them.
    rig_source : RigSource, optional
        Provides the rig; only captures need it.
    sensor : Sensor, optional
        Sensor of the frames; by default as its capture recorded it.
    """

    storage: Storage
    settings: AcquisitionSettings = field(default_factory=AcquisitionSettings)
    resources: Resources = field(default_factory=Resources)
    rig_source: RigSource | None = None
    sensor: Sensor | None = None


@dataclass(frozen=True)
class Acquisition(CaptureContext):
    """Inputs of all stages.

    Attributes
    ----------
    plan : Plan
    state : State, optional
        The method's state before the level; None if it is to be restored from the storage.
    """

    plan: Plan = field(kw_only=True)
    state: Any = None

    def state_before(self, level: int) -> Any:
        """Return the method's state before a level.

        A `state` that was passed on has to be the one before this level.
        """
        if self.state is not None:
            assert len(self.state.rows) == level
            return self.state
        return self.plan.restored_state(self.storage, level)

    def refined_digests(self, level: int) -> list[str]:
        """Digests of the states that all levels before a level added."""
        return [self.storage.read_manifest(k, "refine")["digest"] for k in range(level)]
