"""The steps of a calibration, each run once, and what the rig is built with."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rfpipe.calibration.bench import Bench, DeviceError, Progress, camera_model, camera_numbers
from rfpipe.calibration.black import measure_dark
from rfpipe.calibration.correspondence import measure_correspondence
from rfpipe.calibration.latency import measure_latency
from rfpipe.calibration.mosaic import mosaic_facts
from rfpipe.calibration.rays import measure_rays
from rfpipe.calibration.responses import measure_light, measure_linearity, measure_transfer
from rfpipe.calibration.sight import measure_sight, sight_pictures
from rfpipe.calibration.steadiness import measure_steadiness, with_check_pictures
from rfpipe.calibration.symmetry import measure_rig
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.config import CalibrationConfig, RigConfig
from rfpipe.errors import InputError, RfpipeError, StoreError
from rfpipe.output import storage_errors
from rfpipe.photometry import Resampling
from rfpipe.provenance import fingerprint, plain_data
from rfpipe.rigs.build import devices_from_config
from rfpipe.rigs.calibrated import Calibration, read_parts, write_calibration
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
from rfpipe.store import StoreLock, read_manifest, write_arrays, write_manifest

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Step:
    """A step of a calibration: the steps that it builds on, the settings that shape its findings.

    Coaxial ones are for rigs whose camera and projector share their rays.
    """

    name: str
    title: str
    needs: tuple[str, ...]
    settings: tuple[str, ...]
    measure: Callable[[Bench], Findings]
    is_coaxial: bool = False


def _scene(bench: Bench) -> Findings:
    model, period = camera_model(bench.camera), bench.settings.period_pixels
    frames = list(bench.take(sight_pictures(bench.projector.shape, period)))
    findings = measure_sight(frames, model.exposures, model.white_level, period)
    if model.bayer is None:
        return findings
    black, white = np.mean(frames[:2], axis=0), np.maximum(*frames[2:4])
    primaries = bench.take_primaries()
    of_mosaic = mosaic_facts(model.bayer, black, white, primaries, model.white_level)
    return Findings.of("scene", {**findings.facts, **of_mosaic}, findings.arrays)


_STEADY = ("steadiness",)
_LIT = (*_STEADY, "dark", "linearity", "light")

STEPS: dict[str, Step] = {
    step.name: step
    for step in (
        Step("latency", "Delay from display to camera", (), (), measure_latency),
        Step("steadiness", "Steadiness of the rig", (), ("period_pixels",), measure_steadiness),
        Step("scene", "What the camera sees", _STEADY, ("period_pixels",), _scene),
        Step("dark", "Black level and dark frames", _STEADY, ("dark_frames",), measure_dark),
        Step(
            "linearity", "Linearity of the camera", (*_STEADY, "dark"), ("tolerance",),
            measure_linearity,
        ),
        Step("light", "Response of the projector", _LIT[:3], ("codes", "tolerance"), measure_light),
        Step("transfer", "Photon-transfer curve", _LIT, ("levels",), measure_transfer),
        Step(
            "correspondence", "Correspondence of projector and camera",
            ("scene", *_LIT, "transfer"), ("period_pixels",), measure_correspondence,
        ),
        Step(
            "rays", "Rays of camera and projector", ("correspondence",),
            ("views", "corners", "tolerance"), measure_rays, is_coaxial=True,
        ),
        Step(
            "symmetry", "Symmetry", (*_LIT, "transfer", "rays"),
            ("dark_frames", "symmetry_patterns", "tolerance"), measure_rig, is_coaxial=True,
        ),
    )
}  # fmt: skip
"""The steps in their order."""


def steps_of(settings: CalibrationConfig) -> dict[str, Step]:
    """Return the steps of a rig by name."""
    return {name: step for name, step in STEPS.items() if settings.coaxial or not step.is_coaxial}


@dataclass(frozen=True)
class MadeFor:
    """The rig that a step is measured for; it is measured again where one part differs.

    Attributes
    ----------
    settings : dict
        Those of the rig's file that shape the step, by dotted name.
    devices : dict
        What projector, camera and sensor say of themselves, by dotted name.
    needs : dict
        Fingerprints of the steps that this one builds on.
    """

    settings: Flat
    devices: Flat
    needs: dict[str, str]

    def changes_since(self, before: MadeFor) -> list[str]:
        """Return a line for each setting that changed, or for what the devices say otherwise."""
        if not before.settings:
            return ["it was made by rfpipe's first version, which didn't record its settings"]
        return differences(before.settings, self.settings) or differences(
            before.devices, self.devices
        )


@dataclass(frozen=True)
class CalibrationFolder:
    """A calibration's folder: a manifest and a store for each step, and its result."""

    path: Path

    def manifest(self, step: str) -> Path:
        """Place of a step's manifest."""
        return self.path / "steps" / f"{step}.json"

    def store(self, step: str) -> Path:
        """Place of a step's arrays."""
        return self.path / "steps" / f"{step}.zarr"

    def is_done(self, step: str) -> bool:
        """Whether a step has left its manifest."""
        return self.manifest(step).is_file()

    def written_at(self) -> dict[str, int]:
        """Times, in ns, at which the manifests of the steps that are done were written."""
        return {
            name: self.manifest(name).stat().st_mtime_ns for name in STEPS if self.is_done(name)
        }

    def read(self, step: str) -> Findings:
        """Read the findings of a step.

        Raises
        ------
        StoreError
            When it isn't done.
        IntegrityError
            When it is damaged.
        """
        if not self.is_done(step):
            raise StoreError(
                f"{self.manifest(step)}: the step {step} isn't done; run `rfpipe calibrate` or "
                f"that step first"
            )
        manifest, arrays = read_parts(self.manifest(step), self.store(step))
        verdict = Verdict(manifest["standing"], manifest["verdict"])
        return Findings(verdict, manifest["facts"], arrays)

    def verdicts(self) -> dict[str, dict[str, str]]:
        """Return title, standing and verdict of the steps that are done."""
        done = {name: read_manifest(self.manifest(name)) for name in STEPS if self.is_done(name)}
        return {
            name: {"title": STEPS[name].title, **{k: str(one[k]) for k in ("standing", "verdict")}}
            for name, one in done.items()
        }

    def made_for(self, step: str) -> MadeFor | None:
        """Return the rig that a step was measured for, None where it isn't done."""
        if not self.is_done(step):
            return None
        manifest = read_manifest(self.manifest(step))
        # steps of rfpipe's first version name a fingerprint alone
        parts = {name: manifest.get(name, {}) for name in ("settings", "devices", "needs")}
        return MadeFor(**parts)

    def write(self, step: str, findings: Findings, made_for: MadeFor) -> None:
        """Write the findings of a step; its manifest last."""
        self.path.joinpath("steps").mkdir(parents=True, exist_ok=True)
        self.manifest(step).unlink(missing_ok=True)
        standing, text = findings.verdict
        digest = write_arrays(self.store(step), findings.arrays, {})
        about = {"step": step, **asdict(made_for), "standing": standing, "verdict": text}
        write_manifest(self.manifest(step), {**about, "facts": findings.facts, "arrays": digest})


def settings_of_step(config: RigConfig, step: Step) -> dict[str, Any]:
    """Return a rig's settings as plain data, with those of the calibration that shape a step."""
    elsewhere = {"calibrate", "calibration", "seconds_per_pattern"}
    shaping = _calibrate_settings(config, step)
    return {**config.model_dump(mode="json", exclude=elsewhere), "calibrate": shaping}


def _calibrate_settings(config: RigConfig, step: Step) -> dict[str, Any]:
    return config.calibrate.model_dump(mode="json", include={"coaxial", *step.settings})


def _made_for(
    config: RigConfig,
    step: Step,
    devices: tuple[Projector, Camera],
    folder: CalibrationFolder,
) -> MadeFor:
    """Return the rig that a step would be measured for now."""
    projector, camera = devices
    described = {
        "projector": projector.describe(),
        "camera": camera.describe(),
        "sensor": camera.sensor.describe(),
    }
    settings = shaping_settings(config) | flat({"calibrate": _calibrate_settings(config, step)})
    if not step.is_coaxial:
        del settings[RAYS]
    if step.name != "latency":
        settings.pop(SETTLE, None)
    needs = {name: fingerprint(read_manifest(folder.manifest(name))) for name in step.needs}
    return MadeFor(settings, flat(plain_data(described)), needs)


def calibrate_rig(
    config: RigConfig,
    folder: Path,
    only: Iterable[str] | None = None,
    progress: Progress | None = None,
    *,
    again: bool = False,
) -> None:
    """Open the devices of a rig, do the steps of its calibration, and give the devices back.

    Parameters as `calibrate`; raises ConfigError, too, where the rig has no devices.
    """
    projector, camera = devices_from_config(config.model_copy(update={"calibration": None}))
    with closing(projector), closing(camera):
        place = CalibrationFolder(folder)
        calibrate(projector, camera, place, config, only, progress, again=again)


def calibrate(
    projector: Projector,
    camera: Camera,
    folder: CalibrationFolder,
    config: RigConfig,
    only: Iterable[str] | None = None,
    progress: Progress | None = None,
    *,
    again: bool = False,
) -> None:
    """Do the steps that aren't done yet for these devices and settings.

    A step is done anew where a device, its settings or a step that it needs changed; its previous
    findings are replaced only when the new measurement is complete. Once all are done, and one is
    not good, all are done anew: who mends a fault moves the rig.

    A step that can't be measured, as there is no light, has failed, and so have those that need it:
    that is a finding. A device that fails raises.

    Parameters
    ----------
    projector, camera, folder
        The projector shows codes: weight times 255, without a response of its own.
    config : RigConfig
        The rig's settings: ray domain, settings of the calibration, and settings of the devices,
        which are recorded.
    only : iterable of str, optional
        Steps to do, and those that they need and that are not done yet; None for all, and then
        `finish`.
    progress : callable, optional
        ``progress(title, pictures)`` makes what counts a step's pictures.
    again : bool
        Whether to do steps anew that are done.

    Raises
    ------
    CaptureError
        When a device fails; steps that are done stay.
    InputError
        When a step is unknown, or not of this rig.
    LockedError
        When another process calibrates into this folder.
    """
    steps = steps_of(config.calibrate)
    wanted = set(steps if only is None else only)
    for name in wanted:
        if name not in steps:
            raise InputError(f"calibration step {name!r} is none of this rig's: {', '.join(steps)}")
    for name, step in reversed(steps.items()):  # a step needs earlier ones only
        if name in wanted:
            wanted |= {need for need in step.needs if not folder.is_done(need)}
    with storage_errors(folder.path, "making the folder"):
        folder.path.mkdir(parents=True, exist_ok=True)
    devices = projector, camera
    with StoreLock(folder.path / "steps"):
        if only is None and all(map(folder.is_done, steps)):
            standings = {folder.read(name).verdict.standing for name in steps}
            again = again or not standings <= {"good", "unknown"}
        logged: set[str] = set()
        for step in (step for name, step in steps.items() if name in wanted):
            made_for = _made_for(config, step, devices, folder)
            before = folder.made_for(step.name)
            if before == made_for and not again:
                _log.info("%s: done before", step.title)
                continue
            _check_needs(step, made_for, folder)
            changes = made_for.changes_since(before) if before else []
            for change in (change for change in changes if change not in logged):
                _log.warning("to be measured again: %s", change)
            logged.update(changes)
            _measure_step(step, config, devices, folder, made_for, progress)
        if only is None:
            finish(folder, config.calibrate)


def _check_needs(step: Step, made_for: MadeFor, folder: CalibrationFolder) -> None:
    """Raise InputError where a step that this one builds on was measured with other settings."""
    now = settings_of_all_steps(made_for.settings)
    for need in step.needs:
        before = folder.made_for(need)
        lines = differences(settings_of_all_steps(before.settings), now) if before else []
        if lines:
            raise InputError(
                f"calibration step {step.name} needs {need}, which was measured with other "
                f"settings: {'; '.join(lines)}. Calibrate without --step, or do that step first"
            )


def _measure_step(
    step: Step,
    config: RigConfig,
    devices: tuple[Projector, Camera],
    folder: CalibrationFolder,
    made_for: MadeFor,
    progress: Progress | None,
) -> None:
    """Measure a step, write its findings and log its verdict."""
    count = partial(progress, step.title) if progress else lambda _: nullcontext()
    needs = {name: folder.read(name) for name in step.needs}
    findings = _measured(step, Bench(*devices, config.calibrate, config.rays, needs, count))
    folder.write(step.name, findings, made_for)
    level = logging.INFO if findings.verdict.standing == "good" else logging.WARNING
    _log.log(level, "%s: %s", step.title, findings.verdict)


def finish(folder: CalibrationFolder, settings: CalibrationConfig) -> None:
    """Write the calibration that the steps make up; numbers of failed steps are missing.

    Raises
    ------
    StoreError
        When a step isn't done.
    """
    every, verdicts = {name: folder.read(name) for name in steps_of(settings)}, folder.verdicts()
    made_with, devices = Flat(), Flat()
    for made_for in filter(None, map(folder.made_for, every)):
        made_with |= made_for.settings
        devices |= made_for.devices
    found = {name: one for name, one in every.items() if one.verdict.standing != "failed"}
    rays = found["rays"].arrays if "rays" in found else None
    calibration = Calibration(
        None if rays is None else ProjectorLayout.from_arrays(rays),
        None if rays is None else Resampling.from_arrays(rays),
        camera_numbers(found),
        found["light"]["light"] if "light" in found else None,
        {name: {**verdicts[name], **findings.facts} for name, findings in every.items()},
        made_with,
        identities(devices),
    )
    write_calibration(folder.path, calibration)


def _measured(step: Step, bench: Bench) -> Findings:
    """Measure a step, with looks before and after it where it needs a steady rig.

    A step that can't be measured though the devices work has failed: that is the finding.
    """
    standings = {name: one.verdict.standing for name, one in bench.found.items()}
    bad = [name for name, standing in standings.items() if standing in ("poor", "failed")]
    mend = f"Mend {bad[0]} first. " if bad else ""
    if "failed" in standings.values():
        return Findings(Verdict("failed", f"{mend}There is nothing that this can build on."))

    def measure(bench: Bench) -> Findings:
        try:
            return step.measure(bench)
        except RfpipeError as error:
            return Findings(Verdict("failed", f"Could not be measured: {error}."))

    try:
        found = with_check_pictures(bench, measure)
    except DeviceError as failure:
        raise failure.args[0] from None
    return replace(found, verdict=found.verdict._replace(text=mend + found.verdict.text))
