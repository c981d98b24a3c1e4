"""The symmetry check: its predicted error against the true error of an asymmetric rig."""

from dataclasses import replace

import numpy as np
import pytest

from rfpipe.calibration.symmetry import (
    measure_symmetry,
    merged_pictures,
    random_signs,
    symmetry_findings,
    symmetry_test_patterns,
)
from rfpipe.config import SceneSettings
from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig
from rfpipe.scenes import scene_from_config

SHAPE = (16, 16)
RAYS = 256


def wedge() -> np.ndarray:
    config = SceneSettings.of("wedge", surfaces=("white", "texture"), shape=SHAPE, channels=1)
    scene = scene_from_config(config)
    return scene.apply(np.eye(RAYS, dtype=np.float32))[:, :, 0].T.astype(float)


def shifted(share: float) -> np.ndarray:
    """Return the matrix of a camera that receives a part of the next ray to the right."""
    matrix = (1 - share) * np.eye(RAYS)
    for ray in range(RAYS):
        matrix[ray, ray if ray % 16 == 15 else ray + 1] += share
    return matrix @ wedge()


def pictures_of(
    matrix: np.ndarray, noise: CameraModel | None = None, count: int = 12, drift: float = 0.0
):
    """Return pictures of a rig whose lamp dims by the fraction `drift` until the last one."""
    rig = OperatorRig(matrix, SHAPE, SHAPE, noise=noise)
    signs = random_signs(SHAPE, count, 0)
    lit = symmetry_test_patterns(signs, 4).astype(np.float32)
    lamp = np.linspace(1, 1 - drift, len(lit), dtype=np.float32)
    lit *= (lamp / lamp.max())[:, None, None]
    frames = rig.capture(lit, [(0, index) for index in range(len(lit))])
    return merged_pictures(frames, rig.sensor, signs, 4)


def true_error(matrix: np.ndarray) -> float:
    """Return the relative RMS error of pictures by ``(T + T^T) / 2``."""
    patterns = (random_signs(SHAPE, 200, 99) > 0).reshape(200, -1).T
    off = (matrix - matrix.T) @ patterns / 2
    return float(np.linalg.norm(off) / np.linalg.norm(matrix @ patterns))


@pytest.mark.parametrize(
    ("matrix", "count"),
    [
        *((shifted(share), 12) for share in (0.02, 0.1, 0.5)),
        (np.linspace(0.5, 1.5, RAYS)[:, None] * wedge(), 24),
        (0.9 * wedge() + 0.1 * wedge().mean(axis=0), 24),
    ],
    ids=["a little", "misaligned", "half a pixel", "unequal gains", "flare"],
)
def test_the_error_of_asymmetry_is_predicted(matrix: np.ndarray, count: int) -> None:
    measured = measure_symmetry(*pictures_of(matrix, count=count)[0])
    assert measured[0] == pytest.approx(true_error(matrix), rel=0.35)


def test_a_symmetric_rig_is_good_and_half_a_pixel_is_not() -> None:
    camera = CameraModel()
    good = symmetry_findings(*pictures_of(wedge(), camera, 16), tolerance=0.02)
    assert good.verdict.standing == "good"
    poor = symmetry_findings(*pictures_of(shifted(0.5), camera), tolerance=0.02)
    assert poor.verdict.standing == "poor"
    assert "dual photography" in poor.verdict.text


def test_noise_proves_neither_asymmetry_nor_symmetry() -> None:
    dim = replace(CameraModel(), electrons_per_radiance=300.0)
    findings = symmetry_findings(*pictures_of(wedge(), dim), tolerance=0.005)
    assert findings.verdict.standing == "unknown"
    assert "noise is too large" in findings.verdict.text


@pytest.mark.parametrize("drift", [0.06, -0.06, 0.3])
@pytest.mark.parametrize("camera", [None, CameraModel()])
def test_drift_of_the_lamp_causes_no_asymmetry(drift: float, camera: CameraModel | None) -> None:
    steady, change = pictures_of(wedge(), camera, 16, drift=drift)
    findings = symmetry_findings(steady, change, tolerance=0.02)
    assert findings.verdict.standing == "good"
    assert findings["error"] < 0.005
    assert change == pytest.approx(abs(drift), rel=0.25)
    assert "lamp's light changed by" in findings.verdict.text


def test_asymmetry_is_found_beside_a_drift() -> None:
    measured = measure_symmetry(*pictures_of(shifted(0.1), count=12, drift=0.06)[0])
    assert measured[0] == pytest.approx(true_error(shifted(0.1)), rel=0.35)


def test_an_error_above_the_number_gives_a_bound() -> None:
    dim = replace(CameraModel(), electrons_per_radiance=300.0)
    text = symmetry_findings(*pictures_of(wedge(), dim), tolerance=0.005).verdict.text
    assert "errors of at most" in text
    assert "+-" not in text
