"""Acquisitions of scenes I to IV of [thesis Fig. 2.1]: patterns and errors."""

from functools import cache

import numpy as np
import pytest

import rfpipe
from rfpipe.blocks import RayDomain
from rfpipe.methods import get_method, options_of
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns

pytestmark = pytest.mark.slow

SHAPE = (64, 64)
HARD_PATTERNS = ("vertical_bar", "horizontal_bar", "binary")


@cache
def scene(which, seed):
    return reference_scene(which, SHAPE, channels=1, seed=seed)


@cache
def acquire(which, method="symmetric", tolerance=1e-3, noisy=False, seed=0):
    rig = SimulatedRig(scene(which, seed), CameraModel() if noisy else None, seed=1)
    return rfpipe.acquire(rig, method, tolerance=tolerance, progress=False)


def truth_of(which, pattern, seed=0):
    return scene(which, seed).apply(pattern.reshape(1, -1)).reshape(*SHAPE, 1)


@cache
def errors(which, method="symmetric", tolerance=1e-3, noisy=False, seed=0):
    """Return relative errors {pattern: (of the picture, of its unlit pixels)}."""
    transport = acquire(which, method, tolerance, noisy, seed).transport
    errors_of_patterns = {}
    for name, pattern in relighting_patterns(SHAPE).items():
        truth = truth_of(which, pattern, seed)
        error = transport.relight(pattern) - truth
        assert np.isfinite(error).all()
        unlit = pattern == 0
        dark = np.linalg.norm(truth[unlit])
        errors_of_patterns[name] = (
            np.linalg.norm(error) / np.linalg.norm(truth),
            np.linalg.norm(error[unlit]) / dark if dark else 0.0,
        )
    return errors_of_patterns


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize(("which", "tolerance"), [("IV", 1e-3), ("IV", 1e-4), ("I", 1e-3)])
def test_errors_from_exact_radiance_are_below_the_tolerance_of_floodlit_light(
    which, tolerance, seed
):
    transport = acquire(which, "symmetric", tolerance, seed=seed).transport
    bound = tolerance * np.linalg.norm(truth_of(which, np.ones(SHAPE, np.float32), seed))
    for pattern in relighting_patterns(SHAPE).values():
        error = transport.relight(pattern) - truth_of(which, pattern, seed)
        assert np.linalg.norm(error) <= bound


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_direct_light_takes_four_patterns_per_level(seed):
    assert acquire("I", seed=seed).patterns == 1 + 4 * np.log2(SHAPE[0])


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
def test_an_acquisition_takes_at_most_the_patterns_of_its_forecast(tolerance):
    symmetric, rays = get_method("symmetric"), RayDomain(SHAPE)
    forecast = symmetric.forecast(rays, rays, 1, options_of(symmetric, tolerance=tolerance))
    for seed in (0, 1, 2):
        assert acquire("IV", "symmetric", tolerance, seed=seed).patterns <= forecast.max_patterns


@pytest.mark.parametrize("which", ["II", "III", "IV"])
def test_noise_of_a_12_bit_camera_adds_at_most_half_to_the_error_of_indirect_light(which):
    exact, noisy = errors(which), errors(which, noisy=True)
    for name in (*HARD_PATTERNS, "spot"):
        known = exact[name][1]
        assert noisy[name][1] <= max(1.5 * known, known + 0.004)
    assert max(total for total, _ in noisy.values()) <= 0.005


def test_symmetric_photography_outperforms_dual_photography():
    """Smaller errors of indirect light with fewer patterns and less than a quarter of the bytes.

    At equal tolerances dual photography is more accurate, since it subdivides each block to single
    rays, but it takes about twice as many patterns.
    """
    dual, symmetric = acquire("IV", "dual"), acquire("IV", "symmetric", 3e-4)
    assert symmetric.patterns < dual.patterns
    assert symmetric.transport.nbytes < dual.transport.nbytes / 4
    dual_errors, symmetric_errors = errors("IV", "dual"), errors("IV", "symmetric", 3e-4)
    for name in (*HARD_PATTERNS, "spot"):
        assert symmetric_errors[name][1] < dual_errors[name][1]
