"""A recorded acquisition as a scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.workflow.stagewise import CAMERA, SHAPE, Acquisition, matrix_rig, symmetric_matrix

from rfpipe import acquire
from rfpipe.config import SceneSettings
from rfpipe.errors import InputError, StoreError
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config
from rfpipe.stages.replay import Recorded


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A brute-force recording by a noisy camera."""
    acquisition = Acquisition(tmp_path / "r", matrix_rig(noise=CAMERA), None, "brute_force")
    for level in acquisition.folder.levels():
        acquisition.level(level)
    return tmp_path / "r"


def test_another_method_replays_it_under_another_camera(recorded: Path) -> None:
    scene = scene_from_config(
        SceneSettings.of("recorded", folder=str(recorded), shape=SHAPE, channels=1, complete=True)
    )
    np.testing.assert_allclose(scene.dense(), symmetric_matrix(), atol=0.05 / 20)
    rig = SimulatedRig(scene, CAMERA)
    found = acquire(rig, "dual", progress=False, tolerance=1e-4).transport
    pattern = np.random.default_rng(0).random(SHAPE, np.float32)
    truth = (symmetric_matrix() @ pattern.ravel()).reshape(*SHAPE, 1)
    assert np.linalg.norm(found.relight(pattern) - truth) < 0.05 * np.linalg.norm(truth)


def test_patterns_that_were_not_recorded(tmp_path: Path, recorded: Path) -> None:
    acquisition = Acquisition(tmp_path / "s", matrix_rig())
    acquisition.level(0)
    scene = Recorded(tmp_path / "s")
    light = symmetric_matrix().sum(axis=1)
    half = np.full((1, 20), 0.5)
    np.testing.assert_allclose(scene.apply(half)[0, :, 0], light / 2, rtol=1e-5)
    with pytest.raises(InputError, match=r"recorded patterns don't span pattern 0"):
        scene.apply(np.eye(20)[:1])
    with pytest.raises(StoreError):
        Recorded(tmp_path / "none")
    with pytest.raises(InputError, match=r"recorded with channels 1.*say 3"):
        scene_from_config(SceneSettings.of("recorded", folder=str(recorded), shape=SHAPE))
