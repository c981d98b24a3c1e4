"""Calibration of a rig: measurement of all steps, and the result for the rig."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

from rfpipe.calibration.context import DeviceError, ProgressBar, StepContext, camera_numbers
from rfpipe.calibration.folder import CalibrationFolder, StepConditions
from rfpipe.calibration.steadiness import with_check_pictures
from rfpipe.calibration.steps import Step, calibrate_settings, steps_of
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.config import CalibrationConfig, RigConfig
from rfpipe.errors import InputError, RfpipeError
from rfpipe.installation import needing
from rfpipe.output import storage_errors
from rfpipe.photometry import Resampling
from rfpipe.provenance import fingerprint, plain_data
from rfpipe.rigs.build import devices_from_config
from rfpipe.rigs.calibrated import Calibration, write_calibration
from rfpipe.rigs.devices import Camera, Projector
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.rigs.settings import (
    RAYS,
    SETTLE,
    Flat,
    differences,
    flat,
    identities,
    settings_of_all_steps,
    shaping_settings,
)
from rfpipe.store import StoreLock, read_manifest

_log = logging.getLogger(__name__)


def _conditions(
    config: RigConfig,
    step: Step,
    devices: tuple[Projector, Camera],
    folder: CalibrationFolder,
) -> StepConditions:
    """Current conditions of a step's measurement."""
    projector, camera = devices
    descriptions = {
        "projector": projector.describe(),
        "camera": camera.describe(),
        "sensor": camera.sensor.describe(),
    }
    settings = shaping_settings(config) | flat({"calibrate": calibrate_settings(config, step)})
    if not step.is_coaxial:
        del settings[RAYS]
    if step.name != "latency":
        settings.pop(SETTLE, None)
    needs = {name: fingerprint(read_manifest(folder.manifest(name))) for name in step.needs}
    return StepConditions(settings, flat(plain_data(descriptions)), needs)


def calibrate_rig(
    config: RigConfig,
    folder: Path,
    only: Iterable[str] | None = None,
    progress: ProgressBar | None = None,
    *,
    repeat: bool = False,
) -> None:
    """Open the devices of a rig, calibrate, and close them.

    Parameters and errors as `calibrate`; ConfigError also where the rig has no devices,
    InputError where OpenCV isn't installed.
    """
    with needing("rig", "a calibration"):
        import_module("cv2")
    projector, camera = devices_from_config(config.model_copy(update={"calibration": None}))
    with closing(projector), closing(camera):
        place = CalibrationFolder(folder)
        calibrate(projector, camera, place, config, only, progress, repeat=repeat)


def calibrate(
    projector: Projector,
    camera: Camera,
    folder: CalibrationFolder,
    config: RigConfig,
    only: Iterable[str] | None = None,
    progress: ProgressBar | None = None,
    *,
    repeat: bool = False,
) -> None:
    """Measure the steps that are incomplete, or whose devices or settings changed.

    A step is also repeated after a step that it needs; its previous findings are replaced when the
    new measurement is complete. If all steps are complete and one isn't good, all are repeated,
    since mending a fault may move the rig.

    A step that can't be measured, for lack of light for example, has the standing "failed", and so
    have the steps that need it. An error of a device is raised.

    Parameters
    ----------
    projector : Projector
        Shows codes: weight times 255, no response is applied.
    camera : Camera
    folder : CalibrationFolder
    config : RigConfig
        Ray domain, settings of the calibration, and settings of the devices, which are recorded.
    only : iterable of str, optional
        Steps to measure, together with incomplete steps that they need; None for all steps, after
        which the result is written by `finish`.
    progress : callable, optional
        ``progress(title, count)`` returns a progress bar of a step's pictures.
    repeat : bool
        Whether to repeat complete steps.

    Raises
    ------
    CaptureError
        When a device fails; complete steps are kept.
    InputError
        When the rig has no step of a name in `only`.
    LockedError
        When another process calibrates into this folder.
    """
    steps = _selected_steps(config.calibrate, only, folder)
    with storage_errors(folder.path, "making the folder"):
        folder.path.mkdir(parents=True, exist_ok=True)
    with StoreLock(folder.path / "steps"):
        repeat = repeat or (only is None and _is_complete_but_bad(config.calibrate, folder))
        logged: set[str] = set()
        for step in steps:
            conditions = _conditions(config, step, (projector, camera), folder)
            previous = folder.conditions(step.name)
            if previous == conditions and not repeat:
                _log.info("%s: already complete", step.title)
                continue
            _check_needs(step, conditions, folder)
            changes = conditions.changes_since(previous) if previous else []
            for change in (change for change in changes if change not in logged):
                _log.warning("to be measured again: %s", change)
            logged.update(changes)
            _measure_step(step, config, (projector, camera), folder, conditions, progress)
        if only is None:
            finish(folder, config.calibrate)


def _selected_steps(
    settings: CalibrationConfig, only: Iterable[str] | None, folder: CalibrationFolder
) -> list[Step]:
    """Return the steps of the given names, with incomplete ones that they need, in order."""
    steps = steps_of(settings)
    names = set(steps if only is None else only)
    for name in names:
        if name not in steps:
            raise InputError(
                f"calibration step {name!r} is unknown for this rig; expected one of "
                f"{', '.join(steps)}"
            )
    for name, step in reversed(steps.items()):  # a step needs earlier ones only
        if name in names:
            names |= {need for need in step.needs if not folder.is_done(need)}
    return [step for name, step in steps.items() if name in names]


def _is_complete_but_bad(settings: CalibrationConfig, folder: CalibrationFolder) -> bool:
    """Test whether all steps are complete and one is poor or failed."""
    names = steps_of(settings)
    if not all(map(folder.is_done, names)):
        return False
    return any(folder.read(name).verdict.standing in ("poor", "failed") for name in names)


def _check_needs(step: Step, conditions: StepConditions, folder: CalibrationFolder) -> None:
    """Raise InputError where a needed step was measured with other settings."""
    current = settings_of_all_steps(conditions.settings)
    for need in step.needs:
        previous = folder.conditions(need)
        lines = differences(settings_of_all_steps(previous.settings), current) if previous else []
        if lines:
            raise InputError(
                f"calibration step {step.name} needs {need}, which was measured with other "
                f"settings: {'; '.join(lines)}",
                remedy="Calibrate without --step, or repeat that step first",
            )


def _measure_step(
    step: Step,
    config: RigConfig,
    devices: tuple[Projector, Camera],
    folder: CalibrationFolder,
    conditions: StepConditions,
    progress: ProgressBar | None,
) -> None:
    """Measure a step, write its findings and log its verdict."""
    bar = partial(progress, step.title) if progress else lambda _: nullcontext()
    needs = {name: folder.read(name) for name in step.needs}
    findings = _measured(step, StepContext(*devices, config.calibrate, config.rays, needs, bar))
    folder.write(step.name, findings, conditions)
    level = logging.INFO if findings.verdict.standing == "good" else logging.WARNING
    _log.log(level, "%s: %s", step.title, findings.verdict)


def finish(folder: CalibrationFolder, settings: CalibrationConfig) -> None:
    """Write the calibration from the findings of all steps; failed steps contribute no numbers.

    Raises
    ------
    StoreError
        When a step isn't complete.
    """
    findings = {name: folder.read(name) for name in steps_of(settings)}
    verdicts = folder.verdicts()
    all_settings, devices = Flat(), Flat()
    for conditions in filter(None, map(folder.conditions, findings)):
        all_settings |= conditions.settings
        devices |= conditions.devices
    measured = {name: step for name, step in findings.items() if step.verdict.standing != "failed"}
    rays = measured["rays"].arrays if "rays" in measured else None
    calibration = Calibration(
        None if rays is None else ProjectorLayout.from_arrays(rays),
        None if rays is None else Resampling.from_arrays(rays),
        camera_numbers(measured),
        measured["light"]["light"] if "light" in measured else None,
        {name: {**verdicts[name], **step.facts} for name, step in findings.items()},
        all_settings,
        identities(devices),
    )
    write_calibration(folder.path, calibration)


def _measured(step: Step, context: StepContext) -> Findings:
    """Measure a step, enclosed by check pictures where it needs a steady rig.

    The step has failed if it can't be measured although the devices work.
    """
    standings = {name: needed.verdict.standing for name, needed in context.findings.items()}
    bad = [name for name, standing in standings.items() if standing in ("poor", "failed")]
    remedy = f"Mend {bad[0]} first. " if bad else ""
    if "failed" in standings.values():
        text = f"{remedy}Not measured, since a step that it needs has failed."
        return Findings(Verdict("failed", text))

    def measure(context: StepContext) -> Findings:
        try:
            return step.measure(context)
        except RfpipeError as error:
            return Findings(Verdict("failed", f"Could not be measured: {error}."))

    try:
        findings = with_check_pictures(context, measure)
    except DeviceError as failure:
        raise failure.args[0] from None
    return replace(findings, verdict=findings.verdict._replace(text=remedy + findings.verdict.text))
