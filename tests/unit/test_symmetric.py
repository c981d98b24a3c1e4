"""Symmetric photography [thesis ch. 5] of known matrices."""

from dataclasses import replace

import numpy as np
import pytest
from tests.rigs.known_matrix import acquire_matrix, dense, picture_error

import rfpipe
from rfpipe.errors import CaptureError
from rfpipe.methods.symmetric.method import Symmetric
from rfpipe.photometry import CameraModel
from rfpipe.scenes import reference_scene
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.stages.evaluate import relative_rms


def relative_error(transport, matrix):
    return relative_rms(dense(transport)[0], matrix)


def acquire(matrix, shape, tolerance=1e-3, noise=None, seed=0):
    rig = rfpipe.OperatorRig(matrix, shape, shape, noise, seed=seed)
    return rfpipe.acquire(rig, "symmetric", tolerance=tolerance, progress=False)


def involution(size, seed):
    """Return a permutation matrix that is its own transpose."""
    order = np.random.default_rng(seed).permutation(size)[: size // 2 * 2].reshape(-1, 2)
    matrix = np.zeros((size, size))
    matrix[order[:, 0], order[:, 1]] = matrix[order[:, 1], order[:, 0]] = 1
    return matrix


@pytest.mark.parametrize(
    ("shape", "tolerance", "patterns"),
    [
        ((16, 16), 1e-3, 341),  # as brute force
        ((16, 16), 1e-6, 341),
        ((1, 1), 1e-6, 1),
        ((1, 37), 1e-6, None),
        ((37, 1), 1e-6, None),
        ((13, 29), 1e-6, None),
        ((2, 3, 5), 1e-6, None),
    ],
)
def test_a_random_matrix_of_any_size_is_recovered(shape, tolerance, patterns, caplog):
    size = int(np.prod(shape))
    matrix = np.random.default_rng(3).random((size, size))
    matrix += matrix.T
    result = acquire(matrix, shape, tolerance)
    assert relative_error(result.transport, matrix) < 1e-6
    assert patterns in (None, result.patterns)
    warned = "where brute force takes" in caplog.text
    assert warned == (result.patterns > size)


def test_a_diffuse_cavity_is_known_after_the_first_subdivision():
    albedo = np.random.default_rng(1).uniform(0.1, 1, 256)
    result = acquire(np.outer(albedo, albedo), (16, 16))
    assert result.patterns == 5
    assert relative_error(result.transport, np.outer(albedo, albedo)) < 1e-6
    assert result.levels["rank1"].sum() == 1


@pytest.mark.parametrize("seed", [0, 1])
def test_grainy_transport_is_not_amplified(seed):
    """Its sums nearly cancel, and are divisors."""
    grain = 0.01 * np.random.default_rng(seed).standard_normal((256, 256))
    place = np.indices((16, 16)).reshape(2, -1) / 16
    squared = np.square(place[:, :, None] - place[:, None]).sum(axis=0)
    matrix = (1 + grain + grain.T) / (squared + 0.3)
    assert relative_error(acquire(matrix, (16, 16)).transport, matrix) < 0.02


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shape", [(16, 16), (1, 64), (13, 29)])
def test_a_permutation_is_recovered_although_coarse_blocks_have_rank_1(shape, seed):
    matrix = involution(shape[0] * shape[1], seed)
    result = acquire(matrix, shape)
    assert relative_error(result.transport, matrix) < 1e-6
    assert result.patterns < len(matrix)


def test_direct_light_100000_times_the_indirect_does_not_spoil_it():
    rng = np.random.default_rng(4)
    albedo = rng.uniform(0.2, 1, 256)
    indirect = np.outer(albedo, albedo)
    matrix = np.diag(1e5 * 256 * albedo) + indirect
    result = acquire(matrix, (16, 16), tolerance=1e-7)
    error = dense(result.transport)[0] - matrix
    np.fill_diagonal(error, 0)
    assert np.linalg.norm(error) < 0.05 * np.linalg.norm(indirect)


def test_camera_noise_is_not_subdivided():
    albedo = np.random.default_rng(6).uniform(0.1, 1, 32 * 32)
    result = acquire(np.diag(albedo), (32, 32), 1e-6, CameraModel())
    assert result.patterns < 60
    assert relative_error(result.transport, np.diag(albedo)) < 0.02


def test_a_dim_rig_loses_little_indirect_light():
    matrix, camera = reference_scene("III", (24, 24), channels=1).dense(0), CameraModel()
    dim = replace(camera, electrons_per_radiance=camera.electrons_per_radiance / 64)
    left_half = np.broadcast_to(np.arange(24) < 12, (24, 24)).astype(np.float32)
    dark = left_half == 0
    relit = acquire(matrix, (24, 24), 1e-4, dim).transport.relight(left_half)[dark].sum()
    assert relit == pytest.approx((matrix @ left_half.ravel())[dark.ravel()].sum(), rel=0.01)


def test_a_saturating_glint_affects_only_its_own_pixel():
    albedo = np.random.default_rng(8).uniform(0.1, 1, 32 * 32)
    albedo[500] = 50  # full scale is at 2
    result = acquire(np.diag(albedo), (32, 32), noise=CameraModel())
    assert result.saturated > 0
    estimate = np.diag(dense(result.transport)[0])
    assert 1.9 < estimate[500] < 2.1
    np.testing.assert_allclose(np.delete(estimate, 500), np.delete(albedo, 500), rtol=0.03)


def test_a_saturated_floodlit_image_stops_the_acquisition():
    with pytest.raises(CaptureError, match="saturated"):
        acquire(np.diag(np.full(64, 5.0)), (8, 8), noise=CameraModel())


def test_truncation_equals_the_transport_after_that_level():
    x = np.linspace(0, 1, 144)
    matrix = np.diag(np.full(144, 5.0)) + 0.05 / (0.01 + (x[:, None] - x[None]) ** 2)
    run = acquire_matrix(Symmetric(), matrix, (12, 12), (12, 12), tolerance=1e-6)
    ones = np.ones((12, 12))
    for level, state in enumerate(run.states[1:]):
        truncated = run.transport.truncate(level)
        assert truncated.levels["level"].max() == level
        stopped = dense(Symmetric().transport(state))
        assert np.allclose(dense(truncated), stopped, rtol=1e-3, atol=1e-4)
    assert np.allclose(run.transport.truncate(0).relight(ones), run.transport.relight(ones), 1e-5)


def grainy_light(side, seed):
    """Return direct light with a bright spot, and noisy indirect light of a sampled scene."""
    random = np.random.default_rng(seed)
    x = np.stack(np.mgrid[:side, :side], axis=-1).reshape(-1, 2) / side
    squared = ((x[:, None] - x[None]) ** 2).sum(axis=2)
    grain = random.gamma(2.0, 0.5, squared.shape)
    albedo = random.uniform(0.3, 1, side * side)
    matrix = 2e-4 * np.outer(albedo, albedo) / (0.02 + squared) * (grain + grain.T)
    direct = albedo.copy()
    direct[side * side // 3] = 4.0
    return matrix * np.logical_not(np.eye(side * side)) + np.diag(direct)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_errors_of_many_leaves_do_not_add_up_beyond_the_tolerance(seed):
    shape = (24, 24)
    matrix = grainy_light(24, seed)
    pictures = [*relighting_patterns(shape).values(), np.arange(24) < np.full((24, 1), 12)]
    patterns = np.stack(pictures)
    errors = []
    for tolerance in (1e-2, 3e-3, 1e-3, 3e-4, 1e-4):
        transport = acquire(matrix, shape, tolerance).transport
        errors.append(picture_error(transport, matrix, patterns))
        assert errors[-1] < 3 * tolerance
    assert errors == sorted(errors, reverse=True)
