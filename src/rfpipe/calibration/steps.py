"""Steps of a calibration, and their order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rfpipe.calibration.context import StepContext, camera_model
from rfpipe.calibration.correspondence import measure_correspondence
from rfpipe.calibration.dark import measure_dark
from rfpipe.calibration.latency import measure_latency
from rfpipe.calibration.mosaic import mosaic_facts
from rfpipe.calibration.rays import measure_rays
from rfpipe.calibration.responses import measure_light, measure_linearity, measure_transfer
from rfpipe.calibration.scene import measure_scene, scene_patterns
from rfpipe.calibration.steadiness import measure_steadiness
from rfpipe.calibration.symmetry import measure_rig
from rfpipe.calibration.verdicts import Findings
from rfpipe.config import CalibrationConfig, RigConfig


@dataclass(frozen=True)
class Step:
    """A step of a calibration.

    Attributes
    ----------
    name, title : str
    needs : tuple of str
        Steps whose findings this one uses.
    settings : tuple of str
        Settings of the calibration that affect the findings.
    measure : callable
        Measures, and returns the findings.
    is_coaxial : bool
        Whether the step is for coaxial rigs only.
    """

    name: str
    title: str
    needs: tuple[str, ...]
    settings: tuple[str, ...]
    measure: Callable[[StepContext], Findings]
    is_coaxial: bool = False


def _measure_scene(context: StepContext) -> Findings:
    """Measure the scene and, for a camera with a colour mosaic, the order of its colours."""
    model, period = camera_model(context.camera), context.settings.period_pixels
    patterns = scene_patterns(context.projector.shape, period)
    frames = list(context.brackets(patterns, len(patterns)))
    findings = measure_scene(frames, model.exposures, model.white_level, period)
    if model.bayer is None:
        return findings
    black, white = np.mean(frames[:2], axis=0), np.maximum(*frames[2:4])
    primaries = context.primary_brackets()
    facts = mosaic_facts(model.bayer, black, white, primaries, model.white_level)
    return Findings.of("scene", {**findings.facts, **facts}, findings.arrays)


_STEADY = ("steadiness",)
_LIT = (*_STEADY, "dark", "linearity", "light")

STEPS: dict[str, Step] = {
    step.name: step
    for step in (
        Step("latency", "Delay from display to camera", (), (), measure_latency),
        Step("steadiness", "Steadiness of the rig", (), ("period_pixels",), measure_steadiness),
        Step("scene", "Scene before the camera", _STEADY, ("period_pixels",), _measure_scene),
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
"""All steps by name, in the order of measurement."""


def steps_of(settings: CalibrationConfig) -> dict[str, Step]:
    """Steps of a rig by name."""
    return {name: step for name, step in STEPS.items() if settings.coaxial or not step.is_coaxial}


def settings_of_step(config: RigConfig, step: Step) -> dict[str, Any]:
    """Settings of a rig that affect a step, as plain data."""
    excluded = {"calibrate", "calibration", "seconds_per_pattern"}
    settings = config.model_dump(mode="json", exclude=excluded)
    return {**settings, "calibrate": calibrate_settings(config, step)}


def calibrate_settings(config: RigConfig, step: Step) -> dict[str, Any]:
    """Settings of the calibration that affect a step, as plain data."""
    return config.calibrate.model_dump(mode="json", include={"coaxial", *step.settings})
