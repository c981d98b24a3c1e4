"""Calibrating the rig of a settings file: its devices are opened, driven and given back."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

from rfpipe.calibration.folder import CalibrationFolder, calibrate
from rfpipe.calibration.steps import Step
from rfpipe.calibration.watched import Progress
from rfpipe.config import RigConfig
from rfpipe.rigs.build import devices_from_config

__all__ = ["calibrate_rig", "settings_of_step", "uncalibrated"]


def uncalibrated(config: RigConfig) -> RigConfig:
    """Return the settings without what an earlier calibration, or a file, knows of the devices."""
    projector = config.projector
    if "response" in type(projector.options).model_fields:
        options = projector.options.model_copy(update={"response": None})
        projector = projector.model_copy(update={"options": options})
    return config.model_copy(update={"calibration": None, "projector": projector})


def settings_of_step(config: RigConfig, step: Step) -> dict[str, Any]:
    """Return a rig's settings as plain data, with those of the calibration that shape a step."""
    shaping = config.calibrate.model_dump(mode="json", include={"coaxial", *step.settings})
    elsewhere = {"calibrate", "calibration", "seconds_per_pattern"}
    return {**config.model_dump(mode="json", exclude=elsewhere), "calibrate": shaping}


def calibrate_rig(
    config: RigConfig,
    folder: Path,
    only: Iterable[str] | None = None,
    progress: Progress | None = None,
    *,
    again: bool = False,
) -> CalibrationFolder:
    """Do the steps of a rig's calibration that aren't done yet.

    Parameters
    ----------
    config : RigConfig
        Of a rig of devices.
    folder : Path
        Where the calibration is to lie.
    only : iterable of str, optional
        Steps to do; None for all, and then the calibration itself.
    progress : callable, optional
        As `rfpipe.calibration.folder.calibrate`.
    again : bool
        Whether to do steps anew that are done.

    Returns
    -------
    CalibrationFolder

    Raises
    ------
    ConfigError
        When the rig is a simulated one, which has no devices.
    CaptureError
        When a device fails; steps that are done stay.
    """
    place = CalibrationFolder(folder)
    projector, camera = devices_from_config(uncalibrated(config))
    with closing(projector), closing(camera):
        calibrate(
            projector, camera, place, config.calibrate, config.rays, only, progress, again=again
        )
    return place
