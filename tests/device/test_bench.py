"""The simulated optical bench: pictures by both drivers equal the simulation.

The contract of rigs also runs on it, as on any hardware.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rfpipe.config import RigConfig, parse_rig_config
from rfpipe.devices.optical_path import optical_path
from rfpipe.rigs import DeviceRig
from rfpipe.rigs.build import rig_from_config
from rfpipe.testing import ProjectorContract, RigContract
from rfpipe.units import BLACK_LEVEL_KEY

RAYS = (8, 10)


def settings(**changes: Any) -> RigConfig:
    scene = {"kind": "wedge", "surfaces": ["white", "texture"], "shape": RAYS, "channels": 1}
    bench = {
        "scene": scene,
        "display_shape": [60, 70],
        "camera_shape": [22, 28],
        **changes.pop("bench", {}),
    }
    plain = {
        "rays": RAYS,
        "projector": {"options": {"settle_seconds": 0}},
        "sensor": {"exposures": [1 / 64, 1 / 8]},
        "bench": bench,
        **changes,
    }
    return parse_rig_config(plain, "bench")


def bench(**changes: Any) -> DeviceRig:
    rig = rig_from_config(settings(**changes))
    assert isinstance(rig, DeviceRig)
    return rig


class TestBenchAsARig(RigContract):
    repeatable = False

    def make_rig(self) -> DeviceRig:
        return bench()


class TestBenchProjector(ProjectorContract):
    def make_projector(self):  # type: ignore[no-untyped-def]
        rig = bench()
        rig.camera.close()
        return rig.projector

    def read_back(self, projector):  # type: ignore[no-untyped-def]
        return projector.bench_scene.codes.astype(np.float32) / 255


def test_a_bracket_equals_the_simulation_within_noise() -> None:
    patterns = (np.random.default_rng(0).random((6, *RAYS)) < 0.5).astype(np.float32)
    with bench() as rig:
        dark = np.zeros((8, *RAYS), np.float32)
        black = rig.capture(dark, [(BLACK_LEVEL_KEY, index) for index in range(8)])
        frames = rig.capture(patterns, [(0, index) for index in range(6)])
        images = rig.sensor.merge(frames, black.mean(axis=0, dtype=float).astype(np.float32), 8)
    config = settings()
    assert config.bench is not None
    path = optical_path(config.bench)
    expected = np.stack([path.radiance(path.layout.picture(pattern)) for pattern in patterns])
    deviation = (images.radiance - expected) / np.sqrt(images.variance)
    assert images.saturated == 0
    assert abs(deviation.mean()) < 6 / np.sqrt(deviation.size / 9)  # eight black frames are shared
    assert np.square(deviation).mean() == pytest.approx(1, abs=0.1)
    assert np.abs(images.radiance - expected).mean() < 0.01 * expected.mean()


def test_temporary_files_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    rig = bench()
    assert list(tmp_path.iterdir())
    rig.close()
    assert not list(tmp_path.iterdir())


def test_a_knock_shifts_all_later_pictures() -> None:
    plain = settings(bench={"knock": [2, 0, 3]})  # after one bracket of two exposures
    with rig_from_config(plain) as rig:  # type: ignore[attr-defined]
        pattern = (np.random.default_rng(0).random((1, *RAYS)) < 0.5).astype(np.float32)
        before, after, still = (
            rig.capture(pattern, [(0, index)])[0, 1].astype(float) for index in range(3)
        )
    moved, noise = np.abs(after - before).mean(), np.abs(still - after).mean()
    assert moved > 5 * noise
