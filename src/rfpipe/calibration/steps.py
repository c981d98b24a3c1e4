"""The steps of a calibration: what each shows and takes, given what the others found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.asymmetry import find_causes
from rfpipe.calibration.base import Findings, camera_model, take, uniform
from rfpipe.calibration.blur import fit_blur
from rfpipe.calibration.correspondence import (
    Correspondence,
    correspondence_findings,
    measure_correspondence,
    structured_light,
    take_radiance,
)
from rfpipe.calibration.dark import Dark, dark_findings, glow_of, measure_dark, take_dark
from rfpipe.calibration.latency import PICTURES as SWITCHES
from rfpipe.calibration.latency import latency_findings, measure_latency
from rfpipe.calibration.light import (
    LinearProjector,
    codes_of,
    light_findings,
    measure_light,
)
from rfpipe.calibration.linearity import (
    LEVELS,
    linearity_findings,
    measure_linearity,
    power_law,
)
from rfpipe.calibration.rays import fit_rays
from rfpipe.calibration.rays_verdict import rays_verdict
from rfpipe.calibration.sight import (
    PICTURES,
    Sight,
    measure_sight,
    sight_findings,
    sight_pictures,
)
from rfpipe.calibration.symmetry import symmetry_findings, symmetry_pictures, take_symmetry
from rfpipe.calibration.transfer import (
    levels_of,
    measure_transfer,
    take_levels,
    transfer_facts,
)
from rfpipe.calibration.views import find_views, layout_of_views, map_of_pixels, maps_of_views
from rfpipe.config import CalibrationConfig
from rfpipe.photometry import CameraModel, ResampledSensor, Resampling
from rfpipe.photometry.symmetry import measure_symmetry
from rfpipe.rigs.device_rig import DeviceRig
from rfpipe.rigs.devices import Camera, Projector
from rfpipe.rigs.layout import ProjectorLayout

__all__ = ["STEPS", "Bench", "Step", "camera_numbers", "steps_of"]

Float = NDArray[np.float32]


@dataclass(frozen=True)
class Bench:
    """What a step has at hand.

    Attributes
    ----------
    projector : Projector
        Shows codes: weight times 255.
    camera : Camera
    settings : CalibrationConfig
    rays : (int, int) or None
        Ray domain, or that of each view; None: each projector pixel is a ray.
    found : mapping of str to Findings
        Of the steps that this one needs.
    """

    projector: Projector
    camera: Camera
    settings: CalibrationConfig
    rays: tuple[int, int] | None
    found: Mapping[str, Findings]

    @property
    def sight(self) -> Sight:
        """What the camera sees."""
        return Sight.of(self.found["scene"])

    @property
    def dark(self) -> Dark:
        """What the dark step found."""
        return Dark.of(self.found["dark"])

    @property
    def model(self) -> CameraModel:
        """The camera with the numbers found so far."""
        return replace(camera_model(self.camera), **camera_numbers(self.found))

    @property
    def lit(self) -> Projector:
        """The projector in linear light."""
        return LinearProjector(self.projector, self.found["light"].arrays["light"])

    def radiance(
        self, projector: Projector, pictures: Iterable[Float]
    ) -> Iterator[tuple[Float, Float]]:
        """Show pictures; yield merged radiance and variance of each."""
        return take_radiance(projector, self.camera, self.model, self.dark, pictures)


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
    pictures : callable
        Counts the pictures that it shows, for its progress.
    """

    name: str
    title: str
    needs: tuple[str, ...]
    settings: tuple[str, ...]
    measure: Callable[[Bench], Findings]
    pictures: Callable[[Bench], int] = lambda _: 0


def camera_numbers(found: Mapping[str, Findings]) -> dict[str, Any]:
    """Return the parameters of `CameraModel` that were found."""
    numbers: dict[str, Any] = {}
    if "dark" in found:
        numbers["black_level_counts"] = max(0, round(found["dark"].facts["black_level_counts"]))
    if "linearity" in found:
        numbers["response_gamma"] = found["linearity"].facts["response_gamma"]
    if "transfer" in found:
        names = "full_well_electrons", "read_noise_electrons", "dark_current_electrons"
        numbers |= {name: found["transfer"].facts[name] for name in names}
    return numbers


def _scene(bench: Bench) -> Findings:
    exposures, white_level = bench.camera.sensor.exposures, camera_model(bench.camera).white_level
    period = bench.settings.period_pixels
    pictures = sight_pictures(bench.projector.shape, period)
    frames = list(take(bench.projector, bench.camera, pictures))
    sight = measure_sight(frames, exposures, white_level, period)
    return sight_findings(sight, exposures, white_level)


def _latency(bench: Bench) -> Findings:
    latency = measure_latency(bench.projector, bench.camera)
    return latency_findings(latency, sum(bench.camera.sensor.exposures))


def _dark(bench: Bench) -> Findings:
    model, exposures = camera_model(bench.camera), bench.camera.sensor.exposures
    frames = take_dark(bench.projector, bench.camera, bench.settings.dark_frames)
    dark = measure_dark(frames, exposures, model.white_level)
    glow = glow_of(dark, exposures, model.white_level, bench.sight, model.electrons_per_count)
    return dark_findings(dark, exposures, model.white_level, glow)


def _linearity(bench: Bench) -> Findings:
    pictures = (uniform(bench.projector, level) for level in LEVELS)
    frames = list(take(bench.projector, bench.camera, pictures))
    model, tolerance = bench.model, bench.settings.tolerance / 2
    found = measure_linearity(frames, bench.dark, model.exposures, model.white_level, tolerance)
    return linearity_findings(found, tolerance)


def _light(bench: Bench) -> Findings:
    codes = codes_of(bench.settings.codes)
    pictures = (uniform(bench.projector, code / 255) for code in codes)
    curve = measure_light(bench.radiance(bench.projector, pictures), codes)
    return light_findings(curve, bench.settings.tolerance / 2)


def _transfer(bench: Bench) -> Findings:
    settings, model, dark = bench.settings, bench.model, bench.dark
    frames = take_levels(bench.lit, bench.camera, levels_of(settings.levels), settings.repeats)
    gamma = model.response_gamma
    response = None if gamma == 1 else power_law(gamma)
    transfer = measure_transfer(frames, dark, model.exposures, model.white_level, response)
    return transfer_facts(transfer, dark)


def _correspondence(bench: Bench) -> Findings:
    shape, settings = bench.projector.shape, bench.settings
    code = settings.period_pixels, settings.phase_steps
    images = bench.radiance(bench.lit, structured_light(shape, *code))
    found = measure_correspondence(images, shape, *code)
    return correspondence_findings(found, bench.sight.lit)


def _rays(bench: Bench) -> Findings:
    settings, display = bench.settings, bench.projector.shape
    found = Correspondence.of(bench.found["correspondence"])
    corners = settings.corners
    if settings.views is not None and corners is None:
        corners = tuple(find_views(found, settings.views))  # type: ignore[arg-type]
    if corners is None:
        layout = ProjectorLayout.grid(display, bench.rays or display)
        maps = [map_of_pixels(found, found.valid)]
    else:
        layout = layout_of_views(corners, bench.rays or _rays_a_view(corners), display)
        maps = maps_of_views(found, corners)
    blur, blur_error = fit_blur(found, maps)
    fit = fit_rays(maps, layout, bench.camera.shape, blur)
    arrays = {
        **fit.layout.arrays(),
        **fit.resampling.arrays(),
        "leak": fit.leak.reshape(layout.shape),
        "noise": fit.noise.reshape(layout.shape),
        "pixels": fit.pixels.reshape(layout.shape),
    }
    facts = {
        "shape": list(layout.shape),
        "corners": None if corners is None else [list(map(list, quad)) for quad in corners],
        "blur_pixels": blur,
        "blur_error": blur_error,
        "unseen_rays": int((~fit.resampling.seen).sum()),
        "pixels_a_ray": float(np.median(fit.pixels[fit.resampling.seen.ravel()])),
        "mean_leak": float(fit.leak.mean()),
        "largest_leak": float(fit.leak.max()),
        "largest_noise": float(fit.noise.max()),
        "maps": [one.facts() for one in maps],
    }
    sharp = fit if not blur else fit_rays(maps, layout, bench.camera.shape)
    facts["leak_if_sharp"] = float(np.percentile(sharp.leak, 99))
    return Findings(rays_verdict(fit, maps, blur, settings.tolerance, sharp), facts, arrays)


def _symmetry(bench: Bench) -> Findings:
    arrays = bench.found["rays"].arrays
    layout, resampling = ProjectorLayout.from_arrays(arrays), Resampling.from_arrays(arrays)
    rig = DeviceRig(bench.lit, bench.camera, layout, resampling)
    rig.sensor = ResampledSensor(bench.model, resampling)
    taken = take_symmetry(rig, bench.settings.symmetry_patterns, bench.settings.dark_frames)
    causes = find_causes(*taken, resampling)
    return symmetry_findings(measure_symmetry(*taken), bench.settings.tolerance, causes)


def _structured(bench: Bench) -> int:
    settings = bench.settings
    code = settings.period_pixels, settings.phase_steps
    return sum(1 for _ in structured_light(bench.projector.shape, *code))


def _random(bench: Bench) -> int:
    rays = bench.found["rays"].arrays
    settings = bench.settings
    shape = ProjectorLayout.from_arrays(rays).shape
    return symmetry_pictures(shape, settings.symmetry_patterns, settings.dark_frames)


STEPS: dict[str, Step] = {
    step.name: step
    for step in (
        Step("latency", "Delay from display to camera", (), (), _latency, lambda _: SWITCHES),
        Step("scene", "What the camera sees", (), ("period_pixels",), _scene, lambda _: PICTURES),
        Step("dark", "Black level and dark frames", ("scene",), ("dark_frames",), _dark,
             lambda bench: bench.settings.dark_frames),
        Step("linearity", "Linearity of the camera", ("dark",), ("tolerance",), _linearity,
             lambda _: len(LEVELS)),
        Step(
            "light", "Response of the projector", ("dark", "linearity"), ("codes", "tolerance"),
            _light, lambda bench: len(codes_of(bench.settings.codes)),
        ),
        Step(
            "transfer", "Photon-transfer curve", ("dark", "linearity", "light"),
            ("levels", "repeats"), _transfer,
            lambda bench: len(levels_of(bench.settings.levels)) * bench.settings.repeats,
        ),
        Step(
            "correspondence", "Correspondence of projector and camera",
            ("scene", "dark", "linearity", "light", "transfer"),
            ("period_pixels", "phase_steps"),
            _correspondence, _structured,
        ),
        Step(
            "rays", "Rays of camera and projector", ("correspondence",),
            ("views", "corners", "tolerance"), _rays,
        ),
        Step(
            "symmetry", "Symmetry", ("dark", "linearity", "light", "transfer", "rays"),
            ("dark_frames", "symmetry_patterns", "tolerance"), _symmetry, _random,
        ),
    )
}  # fmt: skip
"""The steps in their order."""


def steps_of(settings: CalibrationConfig) -> list[Step]:
    """Return the steps of a rig: those of rays and symmetry are for coaxial ones."""
    coaxial = {"rays", "symmetry"}
    return [step for step in STEPS.values() if settings.coaxial or step.name not in coaxial]


def _rays_a_view(corners: Iterable[Any]) -> tuple[int, int]:
    """Return as many rays a view as the smallest view has projector pixels a side."""
    outlines = np.array(corners)
    # of each view the upper, right, lower and left side
    sides = np.linalg.norm(np.roll(outlines, -1, axis=1) - outlines, axis=-1)
    wide, tall = sides.reshape(-1, 2).min(axis=0)
    return max(1, int(tall)), max(1, int(wide))
