"""Faults of a rig: text, limits, flicker against gain, and noise by the settings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rfpipe.photometry import CameraModel
from rfpipe.rigs import faults
from rfpipe.rigs.faults import CALIBRATION, CAPTURE, NOTED, OFFLINE, Fault
from rfpipe.rigs.flicker import exposure_ratios, flicker_of, gain_or_flicker
from rfpipe.rigs.late import is_of_previous, is_out_of_order
from rfpipe.rigs.noise import UNSURE, CountNoise

EXPOSURES = (1 / 64, 1 / 16, 1 / 4)
SHORT = EXPOSURES[:1]
WHOLE = (0.05,)

FAULTS: dict[str, tuple[Fault, str]] = {
    "late": (faults.late_fault(1.0, "a longer exposure is darker"), "queue"),
    "room": (faults.room_fault(0.06, "in 20 s"), "darken the room"),
    "moved": (faults.moved_fault(0.06), "cable"),
    "gain": (faults.gain_fault(0.06), "automatic gain"),
    "flicker": (faults.flicker_fault(0.06, EXPOSURES), "whole periods"),
    "unsteady": (faults.unsteady_fault(0.06), "two exposures"),
    "drift": (faults.drift_fault(-0.06, "20 s"), "warm up"),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_has_a_kind_a_size_and_a_remedy(kind: str) -> None:
    fault, remedy = FAULTS[kind]
    assert fault.kind == kind
    assert remedy in fault.remedy
    assert fault.text == f"{fault.change}: {fault.remedy}"
    assert fault.sentence[0].isupper()
    assert fault.sentence.endswith(".")
    assert not fault.sentence.endswith("..")
    if kind != "late":
        assert "6.0" in fault.change
    assert all(fault.exceeds(limits) for limits in (CALIBRATION, CAPTURE, OFFLINE, NOTED))


def test_the_limit_for_room_light_is_lower_than_for_the_lamp() -> None:
    for limits in (CALIBRATION, CAPTURE, OFFLINE):
        size = (limits.room + limits.light) / 2
        assert faults.room_fault(size, "in 20 s").exceeds(limits)
        assert not faults.gain_fault(size).exceeds(limits)


RATIOS: dict[str, tuple[Any, tuple[float, ...], str]] = {
    "steady ratios": ([[1.0, 1.0], [1.0, 1.0]], EXPOSURES, "gain"),
    "a short exposure flickers": ([[1.0, 1.0], [1.1, 1.0]], EXPOSURES, "flicker"),
    "long exposures change as well": (
        [[1.0, 1.0, 1.0], [1.1, 1.0, 1.1]], (*EXPOSURES, 1.0), "gain"
    ),
    "flicker far below the gain's change": ([[1.0, 1.0], [1.01, 1.0]], EXPOSURES, "gain"),
    "unknown ratios": ([[np.nan, np.nan], [1.1, np.nan]], EXPOSURES, "unsteady"),
    "one exposure": (np.empty((2, 0)), SHORT, "unsteady"),
    "one exposure of whole periods": (np.empty((2, 0)), WHOLE, "gain"),
}  # fmt: skip


@pytest.mark.parametrize("name", RATIOS)
def test_exposures_of_a_bracket_distinguish_flicker_from_gain(name: str) -> None:
    ratio, exposures, kind = RATIOS[name]
    ratio = np.asarray(ratio)
    flicker = flicker_of(ratio, np.full(ratio.shape, 1e-3), exposures, np.ptp, 6.0)
    assert gain_or_flicker(0.1, flicker, exposures).kind == kind


def test_ratios_of_exposures_are_1_for_a_steady_lamp_and_any_gain() -> None:
    camera = replace(CameraModel(), exposures=EXPOSURES)
    black = np.full((3, 900), float(camera.black_level_counts))
    for gain in (1.0, 0.5):
        radiance = np.full((30, 30, 1), 0.05 * gain, np.float32)
        frames = camera.expose(radiance, 1, (0,)).reshape(3, -1).astype(np.float64)
        ratio, error = exposure_ratios(frames, black, EXPOSURES, 0.9 * camera.white_level)
        assert (np.abs(ratio - 1) < 5 * error).all()
        assert error.max() < 0.05


@pytest.mark.parametrize("radiance", [0.0, 0.01, 0.05])
def test_noise_predicted_from_settings_equals_that_of_frames(radiance: float) -> None:
    camera = replace(CameraModel(), exposures=EXPOSURES, dark_current_electrons=50.0)
    image = np.full((100, 100, 1), radiance, np.float32)
    frames = camera.expose(image, 1, (0,)).reshape(3, -1).astype(np.float64)
    glow = camera.dark_current_electrons * np.array(EXPOSURES) / camera.electrons_per_count
    light = frames.mean(axis=1) - camera.black_level_counts - glow
    expected = CountNoise.of(camera).variance(light[:, None])[:, 0] / UNSURE
    np.testing.assert_allclose(frames.var(axis=1), expected, rtol=0.1)


def test_a_frame_of_the_previous_picture_is_recognised_in_either_exposure() -> None:
    random = np.random.default_rng(0)
    previous, expected = random.uniform(100, 1000, (2, 3, 200))
    noise = random.normal(0, 5, (3, 200))
    assert not is_of_previous(expected + noise, previous, expected)
    for late in range(3):
        frames = expected + noise
        frames[late] = previous[2] + noise[late]
        assert is_of_previous(frames, previous, expected)


@pytest.mark.parametrize(
    ("light", "is_late"),
    [([1, 4, 16], False), ([16, 4, 1], True), ([1, 0.9, 4], False), ([0.01, 0, 4], False)],
)
def test_a_longer_exposure_is_not_darker(light: list[float], is_late: bool) -> None:
    assert is_out_of_order(light, 0.8, least=0.1) is is_late
