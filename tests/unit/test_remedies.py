"""Remedies of too much and too little light, by the kind of rig that took the pictures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.workflow.stagewise import StagewiseAcquisition

import rfpipe
from rfpipe import CameraModel, OperatorRig
from rfpipe.config import CameraConfig, OfflineConfig, SceneSettings
from rfpipe.errors import CaptureError
from rfpipe.references.exposure_advice import REMEDIES, FloodlitFault, RigKind, kind_of_rig
from rfpipe.rigs import SimulatedRig
from rfpipe.rigs.offline import offline_rig
from rfpipe.scenes import MatrixScene, scene_from_config

SHAPE = (4, 5)
CAMERA = CameraModel()  # full scale is at radiance 2
BENCH = {"kind": "devices", "projector": {}, "camera": {}}

FAULTS = {  # radiance under floodlight: fraction in the message, word of the fault
    FloodlitFault.BRIGHT: (5.0, "saturated"),
    FloodlitFault.DARK: (1e-9, "all black"),
}
MEANS = {  # kind of rig: words of its remedies, and words of other remedies
    RigKind.MATRIX: (("brightest", "camera to null"), ("aperture", "projector")),
    RigKind.SCENE: (("camera.exposures", "camera to null"), ("aperture", "brightest")),
    RigKind.PYTHON: (("matrix", "noise=None"), ("aperture", "camera.exposures")),
}


def simulated(kind: RigKind, radiance: float) -> Any:
    if kind is RigKind.MATRIX:
        scene: Any = MatrixScene(radiance * np.eye(20, dtype=np.float32), SHAPE, SHAPE)
        return SimulatedRig(scene, CAMERA)
    if kind is RigKind.SCENE:
        wall = SceneSettings.of("plane", surfaces=["white"], shape=SHAPE)
        sensor = CameraModel(electrons_per_radiance=radiance * CAMERA.electrons_per_radiance)
        return SimulatedRig(scene_from_config(wall), sensor)
    return OperatorRig(radiance * np.eye(20, dtype=np.float32), SHAPE, SHAPE, CAMERA)


@pytest.mark.parametrize("kind", MEANS)
@pytest.mark.parametrize("fault", FAULTS)
def test_remedies_of_a_simulated_rig_name_its_settings(
    tmp_path: Path, fault: FloodlitFault, kind: RigKind
) -> None:
    radiance, word = FAULTS[fault]
    acquisition = StagewiseAcquisition(tmp_path, simulated(kind, radiance))
    acquisition.schedule(0)
    acquisition.capture(0)
    with pytest.raises(CaptureError, match=word) as caught:
        acquisition.merge(0)
    named, foreign = MEANS[kind]
    assert all(means in str(caught.value) for means in named)
    assert not any(means in str(caught.value) for means in foreign)


@pytest.mark.parametrize("kind", MEANS)
def test_remedies_in_memory_name_python_arguments(kind: RigKind) -> None:
    with pytest.raises(CaptureError, match="noise=None") as caught:
        rfpipe.acquire(simulated(kind, 5.0), "brute_force", progress=False)
    assert "aperture" not in str(caught.value)


def test_the_largest_radiance_of_the_camera_is_named() -> None:
    assert CAMERA.full_scale_radiance == 2
    with pytest.raises(CaptureError, match="radiance 2 is full scale"):
        rfpipe.acquire(simulated(RigKind.PYTHON, 5.0), "brute_force", progress=False)


def test_each_kind_of_rig_has_a_remedy_for_each_fault() -> None:
    for fault in FloodlitFault:
        assert set(REMEDIES[fault]) == set(RigKind)
    offline = offline_rig(OfflineConfig(), CameraConfig(), SHAPE, SHAPE, 1)
    described = {
        RigKind.OFFLINE: offline.describe(),
        RigKind.DEVICES: BENCH,
        **{kind: simulated(kind, 1.0).describe() for kind in MEANS},
    }
    assert {kind_of_rig(rig): kind for kind, rig in described.items()} == {
        kind: kind for kind in RigKind
    }
    assert "aperture" in REMEDIES[FloodlitFault.BRIGHT][RigKind.DEVICES]
    assert "again" in REMEDIES[FloodlitFault.BRIGHT][RigKind.OFFLINE]
