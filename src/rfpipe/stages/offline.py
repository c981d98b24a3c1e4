"""Acquisition with an offline rig, whose pictures are taken by hand, level by level.

The patterns of a level are written as a *sheet*; the pictures of them are imported later. The first
sheet also has the verification patterns, which then need no session of their own; motion between
two sessions shows in them as an error.
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
from rfpipe.rigs.offline_pictures import ValidPictures, validate_pictures
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
from rfpipe.storage.base import VERIFICATION, folder_name, scheduled_levels
from rfpipe.storage.files import FolderStorage
from rfpipe.store import StoreLock

if TYPE_CHECKING:
    from rfpipe.config import Config

KeyedPattern = tuple[tuple[int, ...], NDArray[np.float32]]
"""Key of a picture, see `rfpipe.units`, and its pattern."""


@dataclass(frozen=True)
class OfflineAcquisition:
    """Offline acquisition of a scene by a method.

    Attributes
    ----------
    settings : Config
        Their capture.rig is offline.
    scene, name : str
        Scene and section of the method.
    folder : Path
        ``results/{scene}/{method}``.
    """

    settings: Config
    scene: str
    name: str
    folder: Path

    def __post_init__(self) -> None:
        if self.settings.capture.rig != "offline":
            raise InputError(
                f"capture.rig is {self.settings.capture.rig}",
                remedy="set it to offline for pictures that are taken by hand",
            )

    @property
    def files(self) -> FolderStorage:
        """Storage of the acquisition."""
        return FolderStorage(self.folder)

    def rig(self) -> OfflineRig:
        """Return the rig of the settings, without pictures."""
        scene = self.settings.scenes[self.scene]
        rays = scene.camera_ray_shape, scene.ray_shape, scene.channels
        return offline_rig(self.settings.offline, self.settings.camera, *rays)

    def advance(self, rig: OfflineRig) -> int | None:
        """Run all stages for which a rig has pictures; errors as `acquire_transport`.

        Returns
        -------
        int or None
            Level whose pictures are missing next, VERIFICATION if only verification pictures are
            missing, None if none are.
        """
        acquisition = self._acquisition(rig)
        with StoreLock(self.folder):
            try:
                acquire_transport(acquisition)
            except PicturesNeeded:
                self._capture_verification(acquisition)
                return max(scheduled_levels(self.files))
            return None if self._capture_verification(acquisition) else VERIFICATION

    def write(
        self, rig: OfflineRig, level: int, folder: Path, settings_file: Path, results: Path
    ) -> Sheet:
        """Write the missing patterns of a level as a sheet, into a folder.

        Parameters
        ----------
        rig : OfflineRig
        level : int
            As `advance` returned it.
        folder : Path
            Folder of sheets.
        settings_file, results : Path
            Recorded in the sheet, for the import of its pictures.

        Raises
        ------
        InputError
            If the sheet's folder has pictures of other patterns.
        """
        sheet_folder = folder / f"{self.scene}_{self.name}_{folder_name(level)}"
        facts = {
            "settings": relative_to_sheet(settings_file, sheet_folder),
            "results": relative_to_sheet(results, sheet_folder),
            "scene": self.scene,
            "method": self.name,
            "level": level,
        }
        gamma = self.settings.offline.projector_gamma
        return write_sheet(rig, sheet_folder, self._missing_patterns(rig, level), facts, gamma)

    def read(self, sheet: Sheet, pictures: Path, *, anyway: bool = False) -> ValidPictures:
        """Check the pictures of a sheet; see `rfpipe.rigs.offline_pictures.validate_pictures`."""
        coaxial = self.settings.scenes[self.scene].is_coaxial
        return validate_pictures(self.rig(), sheet, pictures, coaxial=coaxial, anyway=anyway)

    def take_back(self, level: int) -> list[Path]:
        """Remove all results of the pictures of a level and of later ones; return their paths."""
        levels = sorted(self.folder.glob("L[0-9]*"))
        removed = [path for path in levels if int(path.name[1:]) >= level]
        removed += list(self.folder.glob("transport.*")) if removed else []
        if level in (0, VERIFICATION):
            removed += list(self.folder.glob("verification*"))
        with StoreLock(self.folder):
            for path in reversed(removed):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        return removed

    @property
    def _verification_pictures(self) -> int:
        return self.settings.of_scene(self.scene).verification_pictures

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
        """Capture the verification pictures; return True if all are captured."""
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

    def _missing_patterns(self, rig: OfflineRig, level: int) -> Iterator[KeyedPattern]:
        """Yield key and pattern of all pictures that a level lacks."""
        context: CaptureContext = self._acquisition(rig)
        if level == VERIFICATION:
            context = verification_context(context, self._verification_pictures)
        is_exact = isinstance(rig.sensor, ExactSensor)
        described = self.files.describe_rig(rig)
        for brackets in capture.bracket_sets(
            self.files, level, context.settings, described, is_exact=is_exact
        ):
            for first, last in brackets.missing(self.files, self.settings.capture.batch_patterns):
                patterns, keys = brackets.patterns(first, last)
                yield from zip(map(tuple, keys), patterns, strict=True)
        if level == 0 and self._verification_pictures:
            schedule = verification_schedule(rig.projector_shape, self._verification_pictures)
            assert schedule.weights is not None
            for index, pattern in enumerate(schedule.weights):
                yield (VERIFICATION, index), pattern
