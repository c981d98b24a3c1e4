"""Brute force: the yardstick."""

import numpy as np
import pytest
from tests.helpers import acquire_matrix, dense

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods import options_of
from rfpipe.methods.brute_force import BruteForce


@pytest.fixture
def matrix() -> np.ndarray:
    return np.random.default_rng(0).random((3, 20, 42)).astype(np.float32)


@pytest.mark.parametrize("projector", [(6, 7), (2, 3, 7)])
def test_a_scan_recovers_the_matrix(matrix: np.ndarray, projector: tuple[int, ...]) -> None:
    run = acquire_matrix(BruteForce(), matrix, (4, 5), projector)
    assert run.patterns == [42]
    assert run.schedules[0].complete
    np.testing.assert_array_equal(run.schedules[0].batch(0, 42).reshape(42, 42), np.eye(42))
    np.testing.assert_allclose(dense(run.transport), matrix, rtol=1e-6)
    assert run.transport.nbytes == matrix.nbytes


def test_the_table_has_one_level(matrix: np.ndarray) -> None:
    matrix[:, 3] = 0
    run = acquire_matrix(BruteForce(), matrix, (4, 5), (6, 7))
    assert run.transport.level_rows == [
        {
            "level": 0,
            "patterns": 42,
            "nodes": 840,
            "empty": 42,
            "rank1": 0,
            "scalar": 798,
            "subdivided": 0,
        }
    ]


def test_relighting_and_its_transpose(matrix: np.ndarray) -> None:
    transport = acquire_matrix(BruteForce(), matrix, (4, 5), (6, 7)).transport
    random = np.random.default_rng(1)
    pattern, image = random.random((6, 7, 3)), random.random((4, 5, 3))
    forward = np.einsum("cmn,nc->mc", matrix, pattern.reshape(42, 3))
    back = np.einsum("cmn,mc->nc", matrix, image.reshape(20, 3))
    np.testing.assert_allclose(transport.relight(pattern).reshape(20, 3), forward, rtol=1e-5)
    np.testing.assert_allclose(transport.T.relight(image).reshape(42, 3), back, rtol=1e-5)
    for channel in range(3):
        operator = transport.channel(channel)
        np.testing.assert_allclose(operator @ np.eye(42), matrix[channel], rtol=1e-6)
        np.testing.assert_allclose(operator.T @ np.eye(20), matrix[channel].T, rtol=1e-6)


def test_nothing_is_known_before_the_scan() -> None:
    method = BruteForce()
    state = method.start(RayDomain((2, 2)), RayDomain((1, 3)), 1, options_of(method))
    assert not method.transport(state).relight(np.ones((1, 3))).any()
    assert method.transport(state).level_rows == []


def test_a_scan_too_large_to_hold_is_refused() -> None:
    domain = RayDomain((310, 350))
    with pytest.raises(InputError, match=r"131\.6 GiB, more than 8; use dual or symmetric"):
        BruteForce().start(domain, domain, 3, options_of(BruteForce()))
