"""Collections of scenes acquired in the process of the tests."""

from __future__ import annotations

from pathlib import Path

from rfpipe.config import Config
from rfpipe.stages.acquisition import acquire_transport
from rfpipe.stages.context import Acquisition
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import rig_source
from rfpipe.stages.settings import (
    AcquisitionSettings,
    plan_settings,
    rig_source_settings,
    stage_settings,
)
from rfpipe.storage.files import FolderStorage
from rfpipe.store import StoreLock

__all__ = ["acquire_item"]


def acquire_item(settings: Config, scene: str, method: str, results: Path) -> Path:
    """Acquire one scene by one method, like a job of the workflow; return its folder."""
    folder = results / scene / method
    acquisition = Acquisition(
        FolderStorage(folder),
        AcquisitionSettings(**stage_settings(settings, scene, method)),
        rig_source=rig_source(**rig_source_settings(settings, scene)),
        plan=Plan.of(**plan_settings(settings, scene, method)),
    )
    with StoreLock(folder):
        acquire_transport(acquisition)
    return folder
