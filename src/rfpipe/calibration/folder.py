"""Running the steps of a calibration, each once, and writing what the rig is built with."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Verdict
from rfpipe.calibration.steps import STEPS, Bench, Step, camera_numbers, steps_of
from rfpipe.calibration.watched import Progress, WatchedCamera, WatchedProjector
from rfpipe.config import CalibrationConfig
from rfpipe.errors import InputError, IntegrityError, RfpipeError, StoreError
from rfpipe.photometry import Resampling
from rfpipe.provenance import fingerprint
from rfpipe.rigs.calibrated import Calibration, write_calibration
from rfpipe.rigs.devices import Camera, Projector
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.store import StoreLock, open_arrays, read_manifest, write_arrays, write_manifest

__all__ = ["CalibrationFolder", "calibrate", "finish"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class CalibrationFolder:
    """Where a calibration lies: a manifest and a store for each step, and its result.

    Parameters
    ----------
    path : Path
    """

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

    def read(self, step: str) -> Findings:
        """Read what a step found.

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
        manifest = read_manifest(self.manifest(step))
        bundle = open_arrays(self.store(step))
        if bundle.digest != manifest["arrays"]:
            raise IntegrityError(
                f"{self.store(step)}: is not the store that {step}.json tells of; remove both and "
                "run the step again"
            )
        arrays = {name: bundle.read(name) for name in bundle.names}
        verdict = Verdict(manifest["standing"], manifest["verdict"])
        return Findings(verdict, manifest["facts"], arrays)

    def is_all(self, settings: CalibrationConfig, standings: Iterable[str]) -> bool:
        """Whether all steps of a rig are done, and what each found stands so."""
        names = [step.name for step in steps_of(settings)]
        return all(map(self.is_done, names)) and {
            self.read(name).verdict.standing for name in names
        } <= set(standings)

    def verdicts(self) -> dict[str, dict[str, str]]:
        """Return title, standing and verdict of the steps that are done."""
        found = {name: read_manifest(self.manifest(name)) for name in STEPS if self.is_done(name)}
        return {
            name: {
                "title": STEPS[name].title,
                "standing": str(manifest["standing"]),
                "verdict": str(manifest["verdict"]),
            }
            for name, manifest in found.items()
        }

    def made_for(self, step: str) -> str | None:
        """Return the fingerprint that a step was measured for, None where it isn't done."""
        return str(read_manifest(self.manifest(step))["made_for"]) if self.is_done(step) else None

    def write(self, step: str, findings: Findings, made_for: str) -> None:
        """Write what a step found; its manifest last."""
        self.path.joinpath("steps").mkdir(parents=True, exist_ok=True)
        self.manifest(step).unlink(missing_ok=True)
        digest = write_arrays(self.store(step), findings.arrays, {})
        write_manifest(
            self.manifest(step),
            {
                "step": step,
                "made_for": made_for,
                "standing": findings.verdict.standing,
                "verdict": findings.verdict.text,
                "facts": findings.facts,
                "arrays": digest,
            },
        )


def calibrate(
    projector: Projector,
    camera: Camera,
    folder: CalibrationFolder,
    settings: CalibrationConfig,
    rays: tuple[int, int] | None = None,
    only: Iterable[str] | None = None,
    progress: Progress | None = None,
    *,
    again: bool = False,
) -> None:
    """Do the steps that aren't done yet for these devices and settings.

    A step is done anew where a device, its settings or a step that it needs changed; what it found
    before is replaced only when the new measurement is complete. Once all are done, and one found
    a fault, all are done anew: who mends a fault moves the rig.

    A step that can't be measured, as there is no light, has failed, and so have those that need it:
    that is what they found. A device that fails raises.

    Parameters
    ----------
    projector : Projector
        Shows codes: weight times 255, without a response of its own.
    camera : Camera
    folder : CalibrationFolder
    settings : CalibrationConfig
    rays : (int, int), optional
        Ray domain, or that of each view; None: each projector pixel is a ray.
    only : iterable of str, optional
        Steps to do, those that they need being done; None for all, and then `finish`.
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
    steps = {step.name: step for step in steps_of(settings)}
    wanted = list(steps if only is None else only)
    unknown = [name for name in wanted if name not in steps]
    if unknown:
        raise InputError(
            f"calibration step {unknown[0]!r} is none of this rig's: {', '.join(steps)}"
        )
    folder.path.mkdir(parents=True, exist_ok=True)
    devices = {"projector": projector.describe(), "camera": camera.describe()}
    bench = Bench(projector, camera, settings, rays, {})
    with StoreLock(folder.path / "steps"):
        if only is None and folder.is_all(settings, ("good", "unknown", "poor", "failed")):
            again = again or not folder.is_all(settings, ("good", "unknown"))
        for name, step in steps.items():
            if name in wanted:
                _do(step, bench, folder, devices, progress, again=again)
        if only is None:
            finish(folder, settings)


def finish(folder: CalibrationFolder, settings: CalibrationConfig) -> Calibration:
    """Write the calibration that the steps make up; what failed steps would tell is missing.

    Raises
    ------
    StoreError
        When a step isn't done.
    """
    every = {step.name: folder.read(step.name) for step in steps_of(settings)}
    found = {name: one for name, one in every.items() if one.verdict.standing != "failed"}
    rays = found["rays"].arrays if "rays" in found else None

    def array(step: str, name: str) -> NDArray[Any] | None:
        return found[step].arrays[name] if step in found else None

    calibration = Calibration(
        None if rays is None else ProjectorLayout.from_arrays(rays),
        None if rays is None else Resampling.from_arrays(rays),
        camera_numbers(found),
        array("light", "light"),
        array("dark", "black"),
        array("dark", "hot"),
        {
            name: {
                "title": STEPS[name].title,
                "standing": findings.verdict.standing,
                "verdict": findings.verdict.text,
                **findings.facts,
            }
            for name, findings in every.items()
        },
    )
    write_calibration(folder.path, calibration)
    return calibration


def _do(
    step: Step,
    bench: Bench,
    folder: CalibrationFolder,
    devices: Mapping[str, Any],
    progress: Progress | None,
    *,
    again: bool,
) -> None:
    needs = {name: folder.read(name) for name in step.needs}
    failed = [name for name, found in needs.items() if found.verdict.standing == "failed"]
    made_for = fingerprint(
        {
            "devices": devices,
            "settings": bench.settings.model_dump(mode="json", include=set(step.settings)),
            "rays": bench.rays if step.name in ("rays", "symmetry") else None,
            "needs": {name: fingerprint(read_manifest(folder.manifest(name))) for name in needs},
        }
    )
    if folder.made_for(step.name) == made_for and not again:
        _log.info("%s: done before", step.title)
        return
    if folder.is_done(step.name):
        _log.info("%s: measured anew", step.title)
    if failed:
        findings = Findings(
            Verdict("failed", f"Not measured, as this failed: {STEPS[failed[0]].title.lower()}.")
        )
    else:
        findings = _measured(step, replace(bench, found=needs), folder, progress)
    folder.write(step.name, findings, made_for)
    level = logging.INFO if findings.verdict.standing == "good" else logging.WARNING
    _log.log(level, "%s: %s. %s", step.title, findings.verdict.standing, findings.verdict.text)


def _measured(
    step: Step, bench: Bench, folder: CalibrationFolder, progress: Progress | None
) -> Findings:
    """Measure a step; where that can't be done though the devices work, that is what is found."""
    with (
        nullcontext() if progress is None else progress(step.title, step.pictures(bench)) as counts
    ):
        projector = WatchedProjector(bench.projector, counts)
        camera = WatchedCamera(bench.camera)
        try:
            found = step.measure(replace(bench, projector=projector, camera=camera))
        except RfpipeError as error:
            if projector.failed or camera.failed:
                raise
            return Findings(Verdict("failed", f"Could not be measured: {error}.{_why(folder)}"))
    below = _below(step) if step.name != "dark" else set()  # which names its own cause
    first = next((n for n in ("scene", "rays") if n in below and _is_poor(folder, n)), None)
    if first is not None and found.verdict.standing != "good":
        text = (
            f"{found.verdict.text} This may follow from another step that is not good: "
            f"{STEPS[first].title.lower()}; mend that first."
        )
        found = replace(found, verdict=Verdict(found.verdict.standing, text))
    return found


def _below(step: Step) -> set[str]:
    """Return the steps that one builds on, those that they build on among them."""
    return {*step.needs, *(name for need in step.needs for name in _below(STEPS[need]))}


def _is_poor(folder: CalibrationFolder, step: str) -> bool:
    return folder.is_done(step) and folder.read(step).verdict.standing == "poor"


def _why(folder: CalibrationFolder) -> str:
    """Say what earlier steps found that keeps later ones from being measured."""
    for name in ("scene", "dark"):
        if _is_poor(folder, name):
            return f" {STEPS[name].title} tells why: {folder.read(name).verdict.text}"
    return ""
