"""Acquisitions whose pictures are taken elsewhere: a level at a time, between two sessions.

The first level's sheet also has the pictures that verify the transport: they need no session of
their own, and what moves between two sessions shows in them as an error.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, PicturesNeeded
from rfpipe.jobs.workers import Resources
from rfpipe.photometry import ExactSensor
from rfpipe.rigs.offline import OfflineRig, Sheet, offline_rig, relative_to_sheet, write_sheet
from rfpipe.rigs.offline_pictures import Checked, check_pictures
from rfpipe.stages import capture
from rfpipe.stages.acquisition import acquire_transport
from rfpipe.stages.context import Acquisition, CaptureContext
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import GivenRig
from rfpipe.stages.settings import (
    AcquisitionSettings,
    operating_settings,
    plan_settings,
    stage_settings,
)
from rfpipe.stages.verification import (
    schedule_pictures,
    verification_context,
    verification_schedule,
)
from rfpipe.storage.base import VERIFICATION, folder_name
from rfpipe.storage.files import AcquisitionFolder
from rfpipe.store import StoreLock

if TYPE_CHECKING:
    from rfpipe.config import Config

Asked = Iterator[tuple[tuple[int, ...], NDArray[np.float32]]]


@dataclass
class OfflineAcquisition:
    """One scene's acquisition by one method's section, on the way from sheet to sheet.

    The settings have capture.rig offline; the folder is ``results/{scene}/{method}``.
    """

    settings: Config
    scene: str
    name: str
    folder: Path

    def __post_init__(self) -> None:
        if self.settings.capture.rig != "offline":
            raise InputError(
                f"capture.rig is {self.settings.capture.rig}; set it to offline for pictures that "
                "are taken elsewhere"
            )
        self._level = 0

    def advance(self, rig: OfflineRig) -> int | None:
        """Run all stages that a rig's pictures allow; errors as `acquire_transport`.

        Returns the level whose pictures are to be taken next, VERIFICATION for those that verify
        the transport alone, and None where no pictures are missing.
        """
        acquisition = self._acquisition(rig)
        with StoreLock(self.folder):
            try:
                acquire_transport(acquisition)
            except PicturesNeeded:
                self._capture_verification(acquisition)
                self._level = max(self.files.levels())
                return self._level
            if self._capture_verification(acquisition):
                return None
        self._level = VERIFICATION
        return VERIFICATION

    def _acquisition(self, rig: OfflineRig) -> Acquisition:
        """Return the inputs of the stages, with a rig."""
        settings = AcquisitionSettings(
            **stage_settings(self.settings, self.scene, self.name),
            **operating_settings(self.settings, self.scene),
        )
        return Acquisition(
            self.files,
            settings,
            Resources(self.settings.resources.memory_gib),
            GivenRig(rig),
            plan=Plan.of(**plan_settings(self.settings, self.scene, self.name)),
        )

    def _capture_verification(self, acquisition: Acquisition) -> bool:
        """Capture the pictures that verify the transport; return True if all are captured."""
        count, files = self._verification_pictures, self.files
        if not count:
            return True
        if not files.exists(0, "merge"):
            return False
        schedule_pictures(files, count)
        try:
            capture.run(verification_context(acquisition, count), VERIFICATION)
        except PicturesNeeded:
            return False
        return True

    @property
    def _verification_pictures(self) -> int:
        return self.settings.of_scene(self.scene).verification_pictures

    def rig(self) -> OfflineRig:
        """Return the rig of the settings, without pictures."""
        settings, about = self.settings, self.settings.scenes[self.scene]
        rays = about.camera_ray_shape, about.ray_shape, about.channels
        return offline_rig(settings.offline, settings.camera, *rays)

    def write(self, rig: OfflineRig, folder: Path, settings_file: Path, results: Path) -> Sheet:
        """Write what is to be shown at the level that `advance` came to, as a sheet in a folder.

        The sheet names settings and results for whoever imports its pictures. Raises InputError
        when its folder holds pictures of other patterns already.
        """
        own = folder / f"{self.scene}_{self.name}_{folder_name(self._level)}"
        about = {
            "settings": relative_to_sheet(settings_file, own),
            "results": relative_to_sheet(results, own),
            "scene": self.scene,
            "method": self.name,
            "level": self._level,
        }
        gamma = self.settings.offline.projector_gamma
        return write_sheet(rig, own, self._asked(rig), about, gamma)

    def read(self, sheet: Sheet, pictures: Path, *, anyway: bool = False) -> Checked:
        """Check the pictures of a sheet; see `rfpipe.rigs.offline_pictures.check_pictures`."""
        coaxial = self.settings.scenes[self.scene].is_coaxial
        return check_pictures(self.rig(), sheet, pictures, coaxial=coaxial, anyway=anyway)

    def take_back(self, level: int) -> list[Path]:
        """Remove what was made of the pictures of a level and of the later ones; return what."""
        levels = sorted(self.folder.glob("L[0-9]*"))
        gone = [path for path in levels if int(path.name[1:]) >= level]
        gone += list(self.folder.glob("transport.*")) if gone else []
        if level in (0, VERIFICATION):
            gone += list(self.folder.glob("verification*"))
        with StoreLock(self.folder):
            for path in reversed(gone):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        return gone

    @property
    def files(self) -> AcquisitionFolder:
        """What its stages leave."""
        return AcquisitionFolder(self.folder)

    def _asked(self, rig: OfflineRig) -> Asked:
        """Yield key and pattern of all brackets that the level lacks."""
        context: CaptureContext = self._acquisition(rig)
        if self._level == VERIFICATION:
            context = verification_context(context, self._verification_pictures)
        is_exact = isinstance(rig.sensor, ExactSensor)
        described = self.files.describe_rig(rig)
        for brackets in capture.bracket_sets(
            self.files, self._level, context.settings, described, is_exact=is_exact
        ):
            for first, last in brackets.missing(self.files, self.settings.capture.batch_patterns):
                patterns, keys = brackets.patterns(first, last)
                yield from zip(map(tuple, keys), patterns, strict=True)
        if self._level == 0 and self._verification_pictures:
            weights = verification_schedule(
                rig.projector_shape, self._verification_pictures
            ).weights
            assert weights is not None
            yield from (((VERIFICATION, index), each) for index, each in enumerate(weights))
