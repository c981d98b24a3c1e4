"""Methods of other authors in the benchmark: compressive sensing and optical low rank."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.rivals.compressive import Compressive
from benchmarks.rivals.low_rank import LowRank
from tests.rigs.known_matrix import acquire_matrix, dense

from rfpipe import OperatorRig, acquire
from rfpipe.config import CameraConfig
from rfpipe.methods import Method
from rfpipe.scenes import reference_scene
from rfpipe.testing import MethodContract

COMPRESSIVE = "benchmarks.rivals.compressive:Compressive"
LOW_RANK = "benchmarks.rivals.low_rank:LowRank"


class TestLowRank(MethodContract):
    options = {"target_error": 1e-4}  # noqa: RUF012

    def make_method(self) -> Method:
        return LowRank()


class TestCompressive(MethodContract):
    options = {"patterns": 30}  # noqa: RUF012

    def make_method(self) -> Method:
        return Compressive()


def of_rank(rank: int, rays: int = 256, seed: int = 0) -> np.ndarray:
    factors = np.random.default_rng(seed).random((rank, rays))
    return factors.T @ factors / rays


def relative(estimate: np.ndarray, matrix: np.ndarray) -> float:
    return float(np.linalg.norm(estimate - matrix) / np.linalg.norm(matrix))


@pytest.mark.parametrize("method", [COMPRESSIVE, LOW_RANK])
def test_a_noisy_scene_is_relit_better_than_by_direct_light_alone(method: str) -> None:
    scene = reference_scene("II", (16, 16), channels=1).dense(0)
    rig = OperatorRig(scene, (16, 16), (16, 16), CameraConfig())
    result = acquire(rig, method, progress=False, patterns=64)
    pattern = np.zeros((16, 16))
    pattern[:, 3:5] = 1
    truth = scene @ pattern.ravel()
    direct = np.diag(scene) * pattern.ravel()
    relit = result.transport.relight(pattern).ravel()
    assert np.linalg.norm(relit - truth) < 0.7 * np.linalg.norm(direct - truth)


@pytest.mark.parametrize("diagonal", [0.0, 1.0])
def test_rank_5_and_a_diagonal_are_recovered_exactly(diagonal: float) -> None:
    matrix = of_rank(5) + diagonal * np.diag(np.random.default_rng(1).random(256))
    run = acquire_matrix(LowRank(), matrix, (16, 16), (16, 16))
    assert sum(run.patterns) <= 65
    assert relative(dense(run.transport)[0], matrix) < 1e-5
    assert run.patterns[:3] == [1, 16, 16]
