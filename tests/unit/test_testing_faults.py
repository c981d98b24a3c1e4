"""Faulty devices: size and beginning of each fault."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from tests.rigs.simulated_devices import SimulatedCamera, SimulatedProjector

from rfpipe.errors import InputError
from rfpipe.photometry import CameraModel
from rfpipe.testing import faults

QUIET = CameraModel(
    exposures=(0.01, 0.013), read_noise_electrons=0, full_well_electrons=1e9,
    electrons_per_radiance=1e10, bits=16, black_level_counts=1000,
)  # fmt: skip
SHAPE = (6, 8)


def devices(sensor: CameraModel = QUIET) -> tuple[SimulatedProjector, SimulatedCamera]:
    projector = SimulatedProjector(SHAPE)
    channels = 1 if sensor.bayer is None else 3
    camera = SimulatedCamera(
        lambda: np.repeat(projector.light[..., None], channels, axis=2), SHAPE, channels, sensor
    )
    return projector, camera


def pictures(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.2, 0.8, (count, *SHAPE)).astype(np.float32)


def taken(projector: Any, camera: Any, shown: np.ndarray) -> np.ndarray:
    """Return the light of each exposure, (K, E, H, W), relative to full scale of the first."""
    frames = []
    for picture in shown:
        projector.show(picture)
        frames.append(np.asarray(camera.expose(), float)[..., 0] - 1000)
    light = np.stack(frames) / (QUIET.white_level - 1000) / 0.1
    return light / np.reshape(QUIET.exposures, (-1, 1, 1)) * QUIET.exposures[0]


CAMERA_FAULTS: dict[str, Callable[..., Any]] = {
    "late": faults.LateCamera,
    "gain": faults.jittering_gain,
    "flicker": faults.flickering_lamp,
    "drift": faults.drifting_lamp,
    "room": partial(faults.changing_room_light, light=0.1, seconds=0.5),
    "moved": faults.moved_camera,
}


@pytest.mark.parametrize("name", CAMERA_FAULTS)
def test_a_camera_is_clean_until_its_fault_begins(name: str) -> None:
    shown = pictures(6)
    clean = taken(*devices(), shown)
    projector, camera = devices()
    faulty = CAMERA_FAULTS[name](camera, after=3)
    light = taken(projector, faulty, shown)
    assert np.array_equal(light[:3], clean[:3])
    assert not np.allclose(light[4:], clean[4:], rtol=1e-3)
    assert faulty.describe() == camera.describe()
    assert faulty.count == 6


@pytest.mark.parametrize("fault", [faults.mirrored, faults.half_dark])
def test_a_projector_is_clean_until_its_fault_begins(fault: Callable[..., Any]) -> None:
    shown = pictures(4)
    projector, camera = devices()
    light = taken(fault(projector, after=2), camera, shown)
    expected = shown[:, :, ::-1] if fault is faults.mirrored else shown * (np.arange(8) < 4)
    np.testing.assert_allclose(light[:2, 0], shown[:2], atol=1e-3)
    np.testing.assert_allclose(light[2:, 0], expected[2:], atol=1e-3)


def test_late_frames_equal_the_previous_ones() -> None:
    shown = pictures(4)
    projector, camera = devices()
    of_bracket = taken(projector, faults.LateCamera(camera), shown)
    np.testing.assert_allclose(of_bracket[1:, 0], shown[:-1], atol=1e-3)
    projector, camera = devices()
    of_frame = taken(projector, faults.LateCamera(camera, frames=1), shown)
    ratio = QUIET.exposures[1] / QUIET.exposures[0]
    np.testing.assert_allclose(of_frame[1:, 0], ratio * shown[:-1], atol=1e-3)
    np.testing.assert_allclose(ratio * of_frame[:, 1], shown, atol=1e-3)


def test_every_second_bracket_is_a_repetition() -> None:
    projector, camera = devices()
    light = taken(projector, faults.RepeatingCamera(camera, every=2), pictures(6))
    assert [bool((light[i] == light[i - 1]).all()) for i in range(1, 6)] == [False, True] * 2 + [
        False
    ]


def test_gain_is_one_factor_per_bracket_and_flicker_cancels_over_whole_periods() -> None:
    shown = pictures(40)
    projector, camera = devices()
    gain = taken(projector, faults.jittering_gain(camera, deviation=0.1), shown) / shown[:, None]
    assert gain.std(axis=(1, 2, 3)).max() < 1e-3
    assert 0.07 < np.log(gain.mean(axis=(1, 2, 3))).std() < 0.13
    projector, camera = devices()
    light = taken(projector, faults.flickering_lamp(camera), shown) / shown[:, None]
    deviation = light.mean(axis=(2, 3)).std(axis=0)
    assert deviation[0] < 1e-3
    assert deviation[1] > 0.02


def test_drift_room_light_and_motion_have_the_requested_size() -> None:
    shown = pictures(60)
    projector, camera = devices()
    drift = taken(projector, faults.drifting_lamp(camera, change=-0.06, brackets=50), shown)
    np.testing.assert_allclose((drift / shown[:, None])[[0, 25, 59]].mean(axis=(1, 2, 3)),
                               [1, 0.97, 0.94], atol=1e-3)  # fmt: skip
    projector, camera = devices()
    room = taken(projector, faults.changing_room_light(camera, light=0.05, seconds=2), shown)
    added = room[:, 0] - shown
    assert np.ptp(added, axis=(1, 2)).max() < 2e-3
    assert added.max() == pytest.approx(0.05, abs=2e-3)
    projector, camera = devices()
    moved = taken(projector, faults.moved_camera(camera, pixels=(-1, 2)), shown)[:, 0]
    np.testing.assert_allclose(moved[:, :-1, 2:], shown[:, 1:, :-2], atol=1e-3)


def test_a_mosaic_has_another_order_than_its_sensor_says() -> None:
    _, camera = devices(CameraModel(bayer="RGGB"))
    wrong = faults.MisreadMosaic(camera, "GRBG")
    assert (wrong.sensor.bayer, camera.sensor.bayer) == ("GRBG", "RGGB")
    assert wrong.expose().shape == (4, *SHAPE)
    with pytest.raises(InputError, match="even"):
        faults.moved_camera(camera, pixels=(0, 1))
    with pytest.raises(InputError, match="1 to 2"):
        faults.LateCamera(devices()[1], frames=3)
