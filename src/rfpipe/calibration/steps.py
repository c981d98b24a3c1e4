"""The steps of a calibration: what each needs, what it shows, and what it measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rfpipe.calibration.bench import Bench, camera_model, uniform
from rfpipe.calibration.black import measure_dark
from rfpipe.calibration.correspondence import measure_correspondence, structured_light
from rfpipe.calibration.latency import PICTURES, measure_latency
from rfpipe.calibration.rays import measure_rays
from rfpipe.calibration.response import LEVELS, codes_of, measure_light, measure_linearity
from rfpipe.calibration.sight import measure_sight, sight_pictures
from rfpipe.calibration.symmetry import merged_pictures, symmetry_findings, symmetry_patterns
from rfpipe.calibration.transfer import levels_of, measure_transfer
from rfpipe.calibration.verdicts import Findings
from rfpipe.config import CalibrationConfig
from rfpipe.photometry import ResampledSensor, Resampling
from rfpipe.rigs.layout import ProjectorLayout


@dataclass(frozen=True)
class Step:
    """A step of a calibration.

    Attributes
    ----------
    name, title : str
    needs : tuple of str
        Steps whose findings it builds on.
    settings : tuple of str
        Settings that shape its findings.
    measure : callable
        Drives the devices and returns the findings.
    is_coaxial : bool
        Whether it is for rigs whose camera and projector share their rays.
    """

    name: str
    title: str
    needs: tuple[str, ...]
    settings: tuple[str, ...]
    measure: Callable[[Bench], Findings]
    is_coaxial: bool = False


def _latency(bench: Bench) -> Findings:
    with bench.progress(PICTURES) as counts:
        advance = counts.advance if counts is not None else lambda _: None
        return measure_latency(bench.projector, bench.camera, advance)


def _scene(bench: Bench) -> Findings:
    model, period = camera_model(bench.camera), bench.settings.period_pixels
    frames = list(bench.take(sight_pictures(bench.projector.shape, period)))
    return measure_sight(frames, model.exposures, model.white_level, period)


def _dark(bench: Bench) -> Findings:
    model = camera_model(bench.camera)
    frames = bench.take([uniform(bench.projector, 0)] * bench.settings.dark_frames)
    levels = model.exposures, model.white_level
    return measure_dark(frames, *levels, bench.found["scene"], model.electrons_per_count)


def _linearity(bench: Bench) -> Findings:
    model, dark = bench.model, bench.found["dark"]
    frames = bench.take([uniform(bench.projector, level) for level in LEVELS for _ in range(2)])
    tolerance = bench.settings.tolerance / 2
    return measure_linearity(frames, dark, model.exposures, model.white_level, tolerance)


def _light(bench: Bench) -> Findings:
    codes = codes_of(bench.settings.codes)
    images = bench.radiance([uniform(bench.projector, code / 255) for code in codes])
    return measure_light(images, codes, bench.settings.tolerance / 2)


def _transfer(bench: Bench) -> Findings:
    model, repeats = bench.model, bench.settings.repeats
    levels = levels_of(bench.settings.levels)
    pictures = [uniform(bench.projector, level) for level in levels for _ in range(repeats)]
    frames = bench.take(pictures, linear=True)
    groups = (np.stack([next(frames) for _ in range(repeats)]) for _ in levels)
    dark, gamma = bench.found["dark"], model.response_gamma
    return measure_transfer(groups, dark, model.exposures, model.white_level, gamma)


def _correspondence(bench: Bench) -> Findings:
    shape, settings = bench.projector.shape, bench.settings
    code = settings.period_pixels, settings.phase_steps
    images = bench.radiance(structured_light(shape, *code), linear=True)
    return measure_correspondence(images, shape, *code, bench.found["scene"]["lit"])


def _rays(bench: Bench) -> Findings:
    found, display = bench.found["correspondence"], bench.projector.shape
    return measure_rays(found, bench.settings, display, bench.rays)


def _symmetry(bench: Bench) -> Findings:
    arrays, settings = bench.found["rays"].arrays, bench.settings
    layout, resampling = ProjectorLayout.from_arrays(arrays), Resampling.from_arrays(arrays)
    shown = settings.symmetry_patterns, settings.dark_frames
    patterns = list(symmetry_patterns(layout.shape, *shown))
    pictures = (layout.picture(signs > 0) for _, group in patterns for signs in group)
    brackets = bench.take(pictures, sum(len(group) for _, group in patterns), linear=True)
    sensor = ResampledSensor(bench.model, resampling)
    taken = merged_pictures(brackets, sensor, patterns)
    return symmetry_findings(taken, settings.tolerance, resampling)


_LIT = ("dark", "linearity", "light")

STEPS: dict[str, Step] = {
    step.name: step
    for step in (
        Step("latency", "Delay from display to camera", (), (), _latency),
        Step("scene", "What the camera sees", (), ("period_pixels",), _scene),
        Step("dark", "Black level and dark frames", ("scene",), ("dark_frames",), _dark),
        Step("linearity", "Linearity of the camera", ("dark",), ("tolerance",), _linearity),
        Step("light", "Response of the projector", _LIT[:2], ("codes", "tolerance"), _light),
        Step("transfer", "Photon-transfer curve", _LIT, ("levels", "repeats"), _transfer),
        Step(
            "correspondence", "Correspondence of projector and camera",
            ("scene", *_LIT, "transfer"), ("period_pixels", "phase_steps"), _correspondence,
        ),
        Step(
            "rays", "Rays of camera and projector", ("correspondence",),
            ("views", "corners", "tolerance"), _rays, is_coaxial=True,
        ),
        Step(
            "symmetry", "Symmetry", (*_LIT, "transfer", "rays"),
            ("dark_frames", "symmetry_patterns", "tolerance"), _symmetry, is_coaxial=True,
        ),
    )
}  # fmt: skip
"""The steps in their order."""


def steps_of(settings: CalibrationConfig) -> list[Step]:
    """Return the steps of a rig."""
    return [step for step in STEPS.values() if settings.coaxial or not step.is_coaxial]
