"""Calibration of noise and responses, for known camera models."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.rigs.calibration_bench import flat_frames, uneven

from rfpipe.calibration.dark import measure_dark
from rfpipe.calibration.responses import (
    measure_light,
    measure_linearity,
    measure_transfer,
)
from rfpipe.calibration.verdicts import Findings, with_error
from rfpipe.config import CalibrationConfig
from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel

CAMERA = CameraModel()
SCENE = uneven()


class FlatBench:
    """A bench whose pictures are flat: `scene_of` makes a radiance image of a picture's number and
    weight; `bend` makes other counts of counts.
    """

    def __init__(
        self,
        camera: CameraModel,
        scene_of: Callable[[int, float], np.ndarray],
        bend: Callable[[np.ndarray], np.ndarray] = np.asarray,
        seed: int = 0,
        noise: float = 0.0,
        **settings: Any,
    ) -> None:
        self.model, self.findings = camera, dict[str, Findings]()
        self.scene_of, self.bend, self.seed, self.noise = scene_of, bend, seed, noise
        self.settings = CalibrationConfig(**{"dark_frames": 6, "levels": 6, **settings})

    @staticmethod
    def flat_picture(weight: float) -> float:
        return weight

    def brackets(self, weights: list[float], count: int, **_: bool) -> Iterator[np.ndarray]:
        for index, weight in enumerate(weights):
            image, key = self.scene_of(index, weight), (count, index)
            yield self.bend(flat_frames(self.model, image, 1, key, self.seed)[0])

    def radiance(self, weights: list[float]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        random = np.random.default_rng(0)
        for index, weight in enumerate(weights):
            image = self.scene_of(index, weight)
            noise = self.noise * random.standard_normal(image.shape)
            yield image + noise, np.full(image.shape, self.noise**2)


def dark_of(camera: CameraModel, light: float = 0.0, shape=(64, 64), **more: Any) -> Findings:
    return measure_dark(FlatBench(camera, lambda *_: np.full(shape, light), **more))  # type: ignore[arg-type]


def measured(
    measure: Callable[[Any], Findings], camera: CameraModel, light: np.ndarray, **more: Any
) -> Findings:
    scene_of = more.pop("scene_of", lambda _, weight: weight * light)
    bench = FlatBench(camera, scene_of, **more)
    bench.findings["dark"] = dark_of(camera, shape=light.shape, seed=bench.seed, bend=bench.bend)
    return measure(bench)


def transfer_of(camera: CameraModel, light: np.ndarray = SCENE, **more: Any) -> Findings:
    return measured(measure_transfer, camera, light, **more)


def linearity_of(camera: CameraModel, light: np.ndarray = SCENE, **more: Any) -> Findings:
    return measured(measure_linearity, camera, light, **more)


def hot(counts: int, *where: Any) -> Callable[[np.ndarray], np.ndarray]:
    def bend(frames: np.ndarray) -> np.ndarray:
        frames[:, *where] += counts
        return frames

    return bend


def test_dark_frames_give_black_level_current_and_hot_pixels() -> None:
    camera = replace(CAMERA, dark_current_electrons=40.0)
    dark = dark_of(camera, dark_frames=8, bend=hot(300, 5, 7))
    gain = camera.electrons_per_count
    assert dark["black_level_counts"] == pytest.approx(64, abs=5 * dark["black_level_error"])
    assert dark["black_level_error"] < 0.02
    current, error = gain * dark["current_counts_per_s"], gain * dark["current_error"]
    assert current == pytest.approx(40, abs=5 * error)
    assert np.argwhere(dark["hot"]).tolist() == [[5, 7, 0]]
    read = (CAMERA.read_noise_electrons / gain) ** 2 + 1 / 12
    assert dark["variance_counts2"][0] == pytest.approx(read, rel=0.05)
    assert dark.verdict.standing == "good"


def test_verdicts_on_clipped_hot_and_lit_dark_frames() -> None:
    assert "Raise the camera's black" in dark_of(replace(CAMERA, black_level_counts=1)).verdict.text
    assert "isn't dark" in dark_of(CAMERA, 0.02).verdict.text
    every_third = slice(None, None, 3)
    assert "are hot" in dark_of(CAMERA, bend=hot(500, every_third, every_third)).verdict.text
    assert dark_of(replace(CAMERA, exposures=(0.25,)))["current_counts_per_s"] == 0


def test_changing_room_light_is_named_and_not_counted_as_noise() -> None:
    def scene_of(index: int, _: float) -> np.ndarray:
        return np.full((64, 64), 0.0005 * (index % 4))

    dark = measure_dark(FlatBench(CAMERA, scene_of))  # type: ignore[arg-type]
    assert dark.verdict.standing == "poor"
    assert "room's light changes by" in dark.verdict.text
    assert "black level" not in dark.verdict.text
    photons = np.mean([0.0005 * (index % 4) for index in range(6)]) * CAMERA.electrons_per_radiance
    electrons = np.sqrt(photons + CAMERA.read_noise_electrons**2)
    assert dark["variance_counts2"][-1] == pytest.approx(
        (electrons / CAMERA.electrons_per_count) ** 2, rel=0.1
    )


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (5.25, 0.5, "5.25 +- 0.5 electrons"),
        (0.0, 0.7, "at most 1.4 electrons"),
        (1e9, 8.8e17, "at most 1.76e+18 electrons"),
    ],
)
def test_no_number_has_an_error_larger_than_itself(value: float, error: float, text: str) -> None:
    assert with_error(value, error, "{:.3g}") + " electrons" == text


def test_an_unknown_gain_is_not_printed() -> None:
    random = np.random.default_rng(0)

    def scene_of(_: int, weight: float) -> np.ndarray:
        return weight * SCENE + 0.5 * random.random()

    text = transfer_of(CAMERA, scene_of=scene_of, levels=2).verdict.text
    pairs = re.findall(r"([\d.e+-]+) \+- ([\d.e+-]+)", text)
    assert all(float(error) < float(value) for value, error in pairs), text


@pytest.mark.parametrize(
    ("changes", "light", "within"),
    [
        ({}, 1.0, 0.05),
        ({"bits": 16, "black_level_counts": 400}, 1.0, 0.05),
        ({"read_noise_electrons": 12.0}, 1.0, 0.05),
        ({"exposures": (1 / 64,)}, 1.0, 0.1),
        ({}, 0.01, 0.1),
    ],
    ids=["default", "16 bits", "noisy", "one exposure", "little light"],
)
def test_gain_and_read_noise_are_found(changes: dict, light: float, within: float) -> None:
    camera = replace(CAMERA, **changes)
    for seed in range(3):
        findings = transfer_of(camera, light * SCENE, seed=seed)
        gain, error = findings["electrons_per_count"], findings["electrons_per_count_error"]
        assert gain == pytest.approx(camera.electrons_per_count, rel=within)
        assert gain == pytest.approx(camera.electrons_per_count, abs=5 * error)
        assert findings["read_noise_electrons"] == pytest.approx(
            camera.read_noise_electrons, rel=within
        )
        assert findings["full_well_electrons"] == pytest.approx(20_000, rel=within)
        assert findings.verdict.standing == "good"


def test_eight_bits_hide_the_read_noise_but_not_the_noise_of_darkness() -> None:
    camera = replace(CAMERA, bits=8)
    for seed in range(3):
        findings = transfer_of(camera, uneven((72, 80)), levels=8, seed=seed)
        assert findings["electrons_per_count"] == pytest.approx(
            camera.electrons_per_count, rel=0.05
        )
        darkness, true = (
            noise**2 + camera.electrons_per_count**2 / 12
            for noise in (findings["read_noise_electrons"], camera.read_noise_electrons)
        )
        assert darkness == pytest.approx(true, rel=0.25)


def test_the_verdict_on_few_pictures_is_unknown() -> None:
    verdict = transfer_of(CAMERA, uneven((12, 12)), levels=2).verdict
    assert verdict.standing == "unknown"
    assert "Take more levels" in verdict.text


def test_flicker_adds_no_noise_but_speckle_does() -> None:
    random = np.random.default_rng(0)

    def flickers(index: int, weight: float) -> np.ndarray:
        return weight * (1 + 0.03 * (index % 2)) * SCENE

    def speckles(_: int, weight: float) -> np.ndarray:
        return weight * SCENE * (1 + 0.05 * random.standard_normal(SCENE.shape)).clip(0)

    findings = transfer_of(CAMERA, scene_of=flickers)
    assert findings["electrons_per_count"] == pytest.approx(CAMERA.electrons_per_count, rel=0.05)
    verdict = transfer_of(CAMERA, scene_of=speckles).verdict
    assert verdict.standing == "poor"
    assert "deviates from photon noise" in verdict.text


def test_saturation_below_full_scale_is_found() -> None:
    findings = transfer_of(CAMERA, bend=lambda frames: np.minimum(frames, 3500))
    assert findings["electrons_per_count"] == pytest.approx(CAMERA.electrons_per_count, rel=0.05)


def test_pictures_without_light_are_refused() -> None:
    with pytest.raises(CaptureError, match="no light between darkness and saturation"):
        transfer_of(CAMERA, np.zeros((32, 32)))


# too little noise to dither the rounding
QUIET = CameraModel(read_noise_electrons=0, full_well_electrons=1e9, electrons_per_radiance=3e10)
TONES = [(1.0,), (0.3, 1.0), (0.2, 0.7), (0.2, 0.5), (0.2, 0.5, 0.8)]
SCENES = [SCENE, *(np.resize(np.repeat(of, 22), SCENE.shape) for of in TONES)]


@pytest.mark.parametrize("camera", [replace(CAMERA, bits=8), CAMERA, replace(QUIET, bits=10)])
@pytest.mark.parametrize("scene", SCENES)
def test_a_linear_camera_is_linear(camera: CameraModel, scene: np.ndarray) -> None:
    offsets = np.random.default_rng(0).poisson(2**camera.bits / 800, (64, 64, 1)).astype(np.uint16)
    for scale, more in ((1.0, 0), (0.83, 0), (0.61, 0), (1.0, offsets), (0.5, offsets)):
        findings = linearity_of(camera, scale * scene, bend=lambda frames, more=more: frames + more)
        assert findings.verdict.standing in ("good", *["unknown"] * (camera.bits < 12))
        assert findings["response_gamma"] == 1


@pytest.mark.parametrize("gamma", [0.8, 1.05, 1.1, 1.25, 2.2])
def test_a_power_law_is_found_and_its_noise_still_measured(gamma: float) -> None:
    camera = replace(CAMERA, response_gamma=gamma)
    for scene in SCENES:
        findings = linearity_of(camera, scene)
        assert findings["response_gamma"] == pytest.approx(gamma, rel=0.03)
        assert findings.verdict.standing == "good"
    assert transfer_of(camera)["full_well_electrons"] == pytest.approx(20_000, rel=0.1)


def test_a_response_other_than_a_power_law_is_not_linear() -> None:
    def bend(frames: np.ndarray) -> np.ndarray:
        level = np.clip((frames - 64.0) / 4031, 0, 1)
        return np.rint(64 + 4031 * level * (1 + 0.8 * level**3) / 1.8).astype(np.uint16)

    findings = linearity_of(CAMERA, bend=bend)
    assert findings.verdict.standing == "poor"
    assert "a power law doesn't describe" in findings.verdict.text
    assert findings["response_gamma"] == 1


def test_linearity_is_unknown_for_one_exposure() -> None:
    findings = linearity_of(replace(CAMERA, exposures=(0.1,)))
    assert findings.verdict.standing == "unknown"
    assert "worst_deviation" not in findings.facts


def light_of(light: np.ndarray, drift: float = 0.0) -> Findings:
    scene = uneven((40, 40))

    def scene_of(index: int, weight: float) -> np.ndarray:
        return scene * light[round(255 * weight)] * (1 + drift * index / 33)

    return measure_light(FlatBench(CAMERA, scene_of, noise=0.002, codes=33))  # type: ignore[arg-type]


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.4])
def test_the_projectors_response_is_found(gamma: float) -> None:
    true = np.linspace(0, 1, 256) ** gamma
    findings = light_of(true)
    light = findings["light"]
    assert np.abs(light - true).max() < 2e-3
    assert (np.diff(light) >= 0).all()
    assert (light[0], light[-1]) == (0, 1)
    assert findings.verdict.standing == "good"


def test_verdicts_on_projectors_whose_light_drifts_falls_or_hardly_rises() -> None:
    every, true = np.arange(256), np.linspace(0, 1, 256) ** 2.2
    assert "warm up" in light_of(true, drift=0.05).verdict.text
    assert "light falls at code 128" in light_of(np.where(every == 128, 0, true)).verdict.text
    assert "codes differ" in light_of((every > 250).astype(float)).verdict.text
    with pytest.raises(CaptureError, match="no camera pixel is lit"):
        light_of(np.zeros(256))
