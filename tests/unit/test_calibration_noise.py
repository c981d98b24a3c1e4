"""Calibration of noise and responses, against camera models whose numbers are known."""

from dataclasses import replace

import numpy as np
import pytest
from tests.benches import flat_frames, uneven
from tests.simulated_devices import SimulatedCamera, SimulatedProjector

from rfpipe.calibration.base import camera_model, take
from rfpipe.calibration.dark import Dark, dark_findings, measure_dark
from rfpipe.calibration.light import (
    LinearProjector,
    codes_of,
    light_findings,
    measure_light,
)
from rfpipe.calibration.linearity import LEVELS, linearity_findings, measure_linearity
from rfpipe.calibration.noise_fit import Bins, fit_noise, rounded_variance
from rfpipe.calibration.transfer import (
    Transfer,
    levels_of,
    measure_transfer,
    transfer_facts,
    transfer_verdict,
)
from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel, ExactSensor

CAMERA = CameraModel()


def dark_of(camera: CameraModel, count: int = 6, shape=(64, 64), seed: int = 0) -> Dark:
    frames = flat_frames(camera, np.zeros(shape), count, (1,), seed)
    return measure_dark(frames, camera.exposures)


def transfer_of(
    camera: CameraModel,
    light: np.ndarray,
    levels: int = 6,
    repeats: int = 2,
    seed: int = 0,
    response=None,
) -> Transfer:
    dark = dark_of(camera, shape=light.shape, seed=seed)
    frames = (
        flat_frames(camera, level * light, repeats, (2, index), seed)
        for index, level in enumerate(levels_of(levels))
    )
    return measure_transfer(frames, dark, camera.exposures, camera.white_level, response)


def test_dark_frames_tell_black_level_current_and_hot_pixels() -> None:
    camera = replace(CAMERA, dark_current_electrons=40.0)
    frames = flat_frames(camera, np.zeros((64, 64)), 8, (1,))
    frames[:, :, 5, 7] += 300
    dark = measure_dark(frames, camera.exposures)
    gain = camera.electrons_per_count
    assert dark.black_level_counts == pytest.approx(64, abs=5 * dark.black_level_error)
    assert dark.black_level_error < 0.02
    assert dark.current_counts_per_s * gain == pytest.approx(40, abs=5 * dark.current_error * gain)
    assert dark.hot.sum() == 1
    assert dark.hot[5, 7, 0]
    read = (CAMERA.read_noise_electrons / gain) ** 2 + 1 / 12
    assert dark.variance[0] == pytest.approx(read, rel=0.05)
    findings = dark_findings(dark, camera.exposures, camera.white_level)
    assert findings.verdict.standing == "good"
    assert findings.facts["hot_photosites"] == 1


def test_dark_frames_that_are_cut_off_hot_or_lit_are_said_to_be() -> None:
    low = replace(CAMERA, black_level_counts=1)
    findings = dark_findings(dark_of(low), low.exposures, low.white_level)
    assert findings.verdict.standing == "poor"
    assert "Raise the camera's black level" in findings.verdict.text
    lit = measure_dark(flat_frames(CAMERA, np.full((32, 32), 0.02), 4, (1,)), CAMERA.exposures)
    assert "stray light" in dark_findings(lit, CAMERA.exposures, 4095).verdict.text
    frames = flat_frames(CAMERA, np.zeros((32, 32)), 4, (1,))
    frames[:, :, :1, :20] += 500
    hot = dark_findings(measure_dark(frames, CAMERA.exposures), CAMERA.exposures, 4095)
    assert "are hot" in hot.verdict.text


def test_one_exposure_has_no_dark_current() -> None:
    camera = replace(CAMERA, exposures=(0.25,))
    assert dark_of(camera).current_counts_per_s == 0


def test_dark_frames_must_be_two() -> None:
    with pytest.raises(CaptureError, match="expected 2 or more"):
        dark_of(CAMERA, count=1)


@pytest.mark.parametrize("deviation", [0.02, 0.1, 0.3, 1.0, 4.0])
def test_variance_after_rounding(deviation: float) -> None:
    random = np.random.default_rng(0)
    mean = random.uniform(0, 1, 400_000)
    pair = np.rint(mean + deviation * random.standard_normal((2, mean.size)))
    measured = np.square(pair[1] - pair[0]).mean() / 2
    expected, slope = rounded_variance(np.array([deviation**2]), np.ones(1))
    assert measured == pytest.approx(expected[0], rel=0.02)
    ahead, _ = rounded_variance(np.array([deviation**2 * 1.001]), np.ones(1))
    assert slope[0] == pytest.approx((ahead - expected)[0] / (0.001 * deviation**2), rel=0.01)


def test_a_perfect_curve_gives_its_numbers_back() -> None:
    signal = np.geomspace(5, 3000, 40)
    pairs = np.full(40, 1e5)
    variance, _ = rounded_variance(1.2 + signal / 5, np.ones(40))
    bins = Bins(pairs, pairs * signal, pairs * variance, pairs * 3 * variance**2, np.ones(40))
    fit = fit_noise(bins)
    assert fit.gain == pytest.approx(5, rel=1e-6)
    assert fit.read_noise == pytest.approx(5 * 1.2**0.5, rel=1e-5)
    assert fit.misfit == 0


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
        transfer = transfer_of(camera, light * uneven(), seed=seed)
        fit = transfer.fit
        assert fit.gain == pytest.approx(camera.electrons_per_count, rel=within)
        assert fit.gain == pytest.approx(camera.electrons_per_count, abs=5 * fit.gain_error)
        assert fit.read_noise == pytest.approx(camera.read_noise_electrons, rel=within)
        assert transfer.full_well == pytest.approx(camera.full_well_electrons, rel=within)
        assert transfer_verdict(transfer).standing == "good"


def test_eight_bits_hide_the_read_noise_but_not_the_noise_of_darkness() -> None:
    camera = replace(CAMERA, bits=8)
    for seed in range(3):
        fit = transfer_of(camera, uneven((72, 80)), levels=8, seed=seed).fit
        assert fit.gain == pytest.approx(camera.electrons_per_count, rel=0.1)
        darkness, true = (
            noise**2 + camera.electrons_per_count**2 / 12
            for noise in (fit.read_noise, camera.read_noise_electrons)
        )
        assert darkness == pytest.approx(true, rel=0.1)


def test_few_pictures_are_said_to_be_few() -> None:
    transfer = transfer_of(CAMERA, uneven((12, 12)), levels=2)
    verdict = transfer_verdict(transfer)
    assert verdict.standing == "unknown"
    assert "Take more pictures" in verdict.text


def test_light_that_flickers_adds_no_noise() -> None:
    dark, light = dark_of(CAMERA), uneven()
    frames = [
        np.concatenate(
            [flat_frames(CAMERA, level * flicker * light, 1, (2, index, n))
             for n, flicker in enumerate((1.0, 1.03))]
        )
        for index, level in enumerate(levels_of(6))
    ]  # fmt: skip
    fit = measure_transfer(frames, dark, CAMERA.exposures, 4095).fit
    assert fit.gain == pytest.approx(CAMERA.electrons_per_count, rel=0.05)


def test_noise_that_is_not_of_photons_is_said() -> None:
    dark, light = dark_of(CAMERA), uneven()
    random = np.random.default_rng(0)
    frames = []
    for index, level in enumerate(levels_of(6)):
        speckle = [1 + 0.05 * random.standard_normal(light.shape) for _ in range(2)]
        frames.append(
            np.concatenate(
                [flat_frames(CAMERA, level * light * s.clip(0), 1, (2, index, n))
                 for n, s in enumerate(speckle)]
            )
        )  # fmt: skip
    verdict = transfer_verdict(measure_transfer(frames, dark, CAMERA.exposures, 4095))
    assert verdict.standing == "poor"
    assert "misses that of photons" in verdict.text


def test_saturation_below_full_scale_is_found() -> None:
    dark = dark_of(CAMERA)
    frames = (
        np.minimum(flat_frames(CAMERA, level * uneven(), 2, (2, index)), 3500)
        for index, level in enumerate(levels_of(6))
    )
    transfer = measure_transfer(frames, dark, CAMERA.exposures, 4095)
    assert transfer.saturated
    assert transfer.saturation == 3500
    assert transfer.fit.gain == pytest.approx(CAMERA.electrons_per_count, rel=0.05)
    facts = transfer_facts(transfer, dark).facts
    assert facts["saturation_counts"] == 3500


def test_pictures_without_light_or_pairs_are_refused() -> None:
    with pytest.raises(CaptureError, match="no light between darkness and saturation"):
        transfer_of(CAMERA, np.zeros((32, 32)))
    with pytest.raises(CaptureError, match="expected pairs"):
        transfer_of(CAMERA, uneven((16, 16)), repeats=1)


@pytest.mark.parametrize("bits", [8, 12])
def test_a_linear_camera_is_linear(bits: int) -> None:
    camera = replace(CAMERA, bits=bits)
    frames = [flat_frames(camera, level * uneven(), 1, (3, n))[0] for n, level in enumerate(LEVELS)]
    found = measure_linearity(frames, dark_of(camera), camera.exposures, camera.white_level, 0.01)
    assert found.response is None
    assert found.power_law is None
    findings = linearity_findings(found, 0.01)
    assert findings.verdict.standing == "good"
    assert findings.facts["response_gamma"] == 1


@pytest.mark.parametrize("gamma", [1.05, 2.2])
def test_a_power_law_is_found_and_its_noise_still_measured(gamma: float) -> None:
    camera = replace(CAMERA, response_gamma=gamma)
    frames = [flat_frames(camera, level * uneven(), 1, (3, n))[0] for n, level in enumerate(LEVELS)]
    found = measure_linearity(frames, dark_of(camera), camera.exposures, camera.white_level, 0.01)
    assert found.gamma == pytest.approx(gamma, rel=0.03)
    assert linearity_findings(found, 0.01).verdict.standing == "good"
    transfer = transfer_of(camera, uneven(), response=found.power_law)
    assert transfer.full_well == pytest.approx(camera.full_well_electrons, rel=0.1)


def test_a_response_that_is_no_power_law_is_said() -> None:
    frames = [flat_frames(CAMERA, level * uneven(), 1, (3, n))[0] for n, level in enumerate(LEVELS)]
    level = (np.stack(frames) - 64.0) / 4031
    bent = 64 + 4031 * np.clip(level, 0, 1) * (1 + 0.8 * np.clip(level, 0, 1) ** 3) / 1.8
    dark = dark_of(CAMERA)
    counts = np.rint(bent).astype(np.uint16)
    found = measure_linearity(list(counts), dark, CAMERA.exposures, 4095, 0.01)
    verdict = linearity_findings(found, 0.01).verdict
    assert verdict.standing == "poor"
    assert "switch the camera's gamma off" in verdict.text


def test_one_exposure_tells_nothing_of_linearity() -> None:
    camera = replace(CAMERA, exposures=(0.1,))
    frames = [flat_frames(camera, uneven(), 1, (3,))[0]]
    found = measure_linearity(frames, dark_of(camera), camera.exposures, 4095, 0.01)
    findings = linearity_findings(found, 0.01)
    assert findings.verdict.standing == "unknown"
    assert findings.facts["worst_deviation"] is None


def light_images(light: np.ndarray, drift: float = 0.0, noise: float = 0.002):
    codes = codes_of(33)
    scene = uneven((40, 40))[..., None]
    random = np.random.default_rng(0)
    for index, code in enumerate(codes):
        flicker = 1 + drift * index / (len(codes) - 1)
        image = scene * light[code] * flicker + noise * random.standard_normal(scene.shape)
        yield image.astype(np.float32), np.full(scene.shape, noise**2, np.float32)


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.4])
def test_the_projectors_response_is_found(gamma: float) -> None:
    true = np.linspace(0, 1, 256) ** gamma
    curve = measure_light(light_images(true), codes_of(33))
    assert np.abs(curve.light - true).max() < 2e-3
    assert (np.diff(curve.light) >= 0).all()
    assert (curve.light[0], curve.light[-1]) == (0, 1)
    findings = light_findings(curve, 0.01)
    assert findings.verdict.standing == "good"


def test_a_projector_that_drifts_falls_or_hardly_rises_is_said_to() -> None:
    true = np.linspace(0, 1, 256) ** 2.2
    drifting = light_findings(measure_light(light_images(true, 0.05), codes_of(33)), 0.01)
    assert "warm up" in drifting.verdict.text
    bent = true.copy()
    bent[200:] -= 0.2 * np.linspace(0, 1, 56)
    falling = light_findings(measure_light(light_images(np.clip(bent, 0, 1)), codes_of(33)), 0.01)
    assert falling.verdict.standing == "good"  # still rising
    dips = np.where(np.arange(256) == 128, 0.0, true)
    dipping = light_findings(measure_light(light_images(dips), codes_of(33)), 0.01)
    assert "Light falls at code 128" in dipping.verdict.text
    step = (np.arange(256) > 250).astype(float)
    stepping = light_findings(measure_light(light_images(step), codes_of(33)), 0.01)
    assert "codes differ" in stepping.verdict.text


def test_no_light_is_refused() -> None:
    with pytest.raises(CaptureError, match="no camera pixel is lit"):
        measure_light(light_images(np.zeros(256)), codes_of(33))


def test_a_linear_projector_shows_light() -> None:
    projector = SimulatedProjector((2, 4))
    light = np.linspace(0, 1, 256) ** 2.2
    linear = LinearProjector(projector, light)
    linear.show(np.array([[0, 0.1, 0.25, 0.5], [0.6, 0.75, 0.9, 1]], np.float32))
    shown = light[np.rint(projector.light * 255).astype(int)]
    wanted = np.array([[0, 0.1, 0.25, 0.5], [0.6, 0.75, 0.9, 1]])
    assert shown == pytest.approx(wanted, abs=0.005)
    assert linear.describe() == projector.describe()


def test_what_is_no_bracket_or_no_camera_is_refused() -> None:
    projector = SimulatedProjector((4, 4))
    camera = SimulatedCamera(lambda: np.zeros((5, 6, 1)), (6, 6), 1, CAMERA)
    with pytest.raises(CaptureError, match="calibration picture 0"):
        list(take(projector, camera, [np.zeros((4, 4), np.float32)]))
    camera.sensor = ExactSensor()  # type: ignore[assignment]
    with pytest.raises(CaptureError, match="no noise to calibrate"):
        camera_model(camera)
