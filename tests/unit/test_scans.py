"""Scans: brute force, and Hadamard multiplexing with half of the projector lit."""

import numpy as np
import pytest
from tests.rigs.known_matrix import acquire_matrix, dense

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods import options_of
from rfpipe.methods.brute_force import BruteForce
from rfpipe.methods.hadamard import Hadamard, s_matrix_order


def matrix_error(run, matrix: np.ndarray) -> float:
    return float(np.sqrt(np.mean((dense(run.transport) - matrix) ** 2)))


@pytest.mark.parametrize("projector", [(6, 7), (2, 3, 7)])
def test_brute_force_lights_ray_by_ray(projector: tuple[int, ...]) -> None:
    matrix = np.random.default_rng(0).random((3, 20, 42))
    matrix[:, 3] = 0
    run = acquire_matrix(BruteForce(), matrix, (4, 5), projector)
    assert run.patterns == [42]
    assert run.schedules[0].complete
    np.testing.assert_array_equal(run.schedules[0].batch(0, 42).reshape(42, 42), np.eye(42))
    np.testing.assert_allclose(dense(run.transport), matrix, rtol=1e-6)
    [row] = run.transport.level_rows
    assert (row["nodes"], row["empty"], row["scalar"]) == (840, 42, 798)


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 1), (1, 37), (6, 7), (2, 3, 7)])
def test_half_of_the_rays_are_lit_and_the_matrix_is_recovered(shape: tuple[int, ...]) -> None:
    rays = RayDomain(shape).size
    order = s_matrix_order(rays)
    matrix = np.random.default_rng(1).random((3, 6, rays))
    run = acquire_matrix(Hadamard(), matrix, (2, 3), shape)
    np.testing.assert_allclose(dense(run.transport), matrix, atol=3e-6)
    assert run.patterns == [order]
    assert not run.schedules[0].complete
    shown = run.schedules[0].batch(0, order)
    assert set(np.unique(shown)) <= {0, 1}
    assert abs(shown.mean() - 0.5) <= 0.5 / np.sqrt(order)


def test_signal_independent_noise_decreases_as_predicted() -> None:
    matrix = np.random.default_rng(2).random((1, 400, 103))
    scan = acquire_matrix(BruteForce(), matrix, (20, 20), (1, 103), sigma=0.1)
    multiplexed = acquire_matrix(Hadamard(), matrix, (20, 20), (1, 103), sigma=0.1)
    gain = matrix_error(scan, matrix) / matrix_error(multiplexed, matrix)
    assert gain == pytest.approx((103 + 1) / (2 * np.sqrt(103)), rel=0.02)


@pytest.mark.parametrize("method", [BruteForce(), Hadamard()])
def test_a_scan_too_large_to_hold_is_refused(method: BruteForce) -> None:
    domain = RayDomain((310, 350))
    with pytest.raises(InputError, match=r"131\.6 GiB, more than 8; use dual or symmetric"):
        method.start(domain, domain, 3, options_of(method))
