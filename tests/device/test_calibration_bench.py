"""Calibration of the optical bench in software: a real window, a real camera driver."""

from pathlib import Path

import numpy as np
import pytest

from rfpipe.calibration import load
from rfpipe.calibration.job import calibrate_rig
from rfpipe.config import RigConfig, parse_rig_config
from rfpipe.photometry import MergeOptions
from rfpipe.rigs.bench import optical_path
from rfpipe.rigs.build import rig_from_config
from rfpipe.scenes import scene_from_config
from rfpipe.scenes.relighting import relighting_patterns

pytestmark = pytest.mark.slow

RAYS = (16, 16)
SETTINGS = {
    "rays": list(RAYS),
    "projector": {"options": {"settle_seconds": 0.0}},
    "bench": {
        "scene": {
            "kind": "wedge", "surfaces": ["white", "texture"], "shape": list(RAYS),
            "channels": 1,
        },
        "display_shape": [144, 160],
        "camera_shape": [48, 52],
        "camera": {"read_noise_electrons": 9.0, "full_well_electrons": 15_000.0},
    },
    "calibrate": {"dark_frames": 4, "levels": 6, "codes": 17, "symmetry_patterns": 6},
}  # fmt: skip


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[RigConfig, Path]:
    """The bench's settings with its calibration, and the folder of that."""
    folder = tmp_path_factory.mktemp("bench") / "calibration"
    calibrate_rig(parse_rig_config(SETTINGS, "rig.yaml"), folder)
    return parse_rig_config({**SETTINGS, "calibration": str(folder)}, "rig.yaml"), folder


def test_the_true_numbers_are_found(calibrated: tuple[RigConfig, Path]) -> None:
    config, folder = calibrated
    found = load(folder)
    # those of the bench, not of the settings' sensor
    assert found.camera["full_well_electrons"] == pytest.approx(15_000, rel=0.1)
    assert found.camera["read_noise_electrons"] == pytest.approx(9, rel=0.1)
    light = np.linspace(0, 1, 256) ** config.bench.projector_gamma
    assert np.abs(found.projector_response - light).max() < 5e-3
    path = optical_path(config.bench, (144, 160))
    assert np.array_equal(found.layout.ray_of_pixel, path.layout.ray_of_pixel)
    homography = np.array(found.facts["rays"]["maps"][0]["homography"])
    points = np.stack(np.meshgrid(np.arange(8, 44, 4), np.arange(8, 40, 4)), -1) + 0.5
    x, y, w = np.moveaxis(points @ homography[:, :2].T + homography[:, 2], -1, 0)
    error = np.hypot(
        *np.moveaxis(np.stack([x / w, y / w], -1) - path.projector_points(points), -1, 0)
    )
    assert error.mean() < 0.1


def test_pictures_are_those_of_the_scene(calibrated: tuple[RigConfig, Path]) -> None:
    config, _ = calibrated
    scene = scene_from_config(config.bench.scene)
    with rig_from_config(config) as rig:
        off = rig.capture(np.zeros((6, *RAYS), np.float32), [(9, i) for i in range(6)])
        named = relighting_patterns(RAYS)
        patterns = np.stack(list(named.values()))
        frames = rig.capture(patterns, [(1, i) for i in range(len(patterns))])
        merged = rig.sensor.merge(frames, off.mean(axis=0), MergeOptions(6)).radiance
    true = scene.apply(patterns.reshape(len(patterns), -1)).reshape(merged.shape)
    for name, image, light in zip(named, merged, true, strict=True):
        assert np.linalg.norm(image - light) / np.linalg.norm(light) < 0.02, name
