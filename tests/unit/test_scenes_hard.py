"""The named hard cases are what their names say."""

import json

import numpy as np
import pytest
from figures.hard_scenes import hard_cases

from rfpipe.scenes import reference_scene

CASES = hard_cases()


def matrix(name):
    return CASES[name]().dense()


@pytest.mark.parametrize("name", CASES)
def test_every_case_is_a_finite_scene_made_alike_each_time(name):
    scene, again = CASES[name](), CASES[name]()
    rays = int(np.prod(scene.shape))
    assert rays <= 400
    assert scene.albedo.shape == (*scene.shape, scene.channels)
    assert json.dumps(scene.describe()) == json.dumps(again.describe())
    patterns = np.random.default_rng(0).random((3, rays))
    radiance = scene.apply(patterns)
    for channel in range(scene.channels):
        dense = scene.dense(channel)
        assert np.isfinite(dense).all()
        assert (dense >= 0).all()
        assert radiance[..., channel] == pytest.approx(patterns @ dense.T, rel=1e-6)
        assert np.array_equal(dense, dense.T) is not name.startswith("asymmetric")


def test_direct_light_is_1e5_times_the_indirect():
    dense = matrix("bright_direct")
    indirect = dense.sum(1) - reference_scene("IV", (16, 16), channels=1, bounces=1).dense().sum(1)
    assert indirect.max() == pytest.approx(1e-5 * dense.diagonal().max(), rel=1e-3)


def test_ranks():
    ranks = {"zero_transport": 0, "diffuse_cavity": 1, "mirror": 256, "random_dense": 256}
    assert {name: np.linalg.matrix_rank(matrix(name), rtol=1e-4) for name in ranks} == ranks


def test_permutations_are_involutions():
    for name in ("mirror", "random_permutation"):
        dense = matrix(name)
        assert ((dense > 0).sum(1) == 1).all()
        assert dense @ dense == pytest.approx(0.81 * np.eye(256))
    assert np.flatnonzero(matrix("mirror")[0]).tolist() == [15]


def test_caustics_are_few_and_strong():
    dense, plain = matrix("caustics"), reference_scene("IV", (16, 16), channels=1).dense()
    changed = ~np.isclose(dense, plain)
    assert changed.sum() == 32
    assert (dense[changed] > 4 * plain.diagonal().mean()).all()


def test_dark_channel_reflects_nothing():
    scene = CASES["dark_channel"]()
    assert scene.channels == 3
    assert not scene.apply(np.ones((1, 256)))[..., 2].any()
    assert (scene.apply(np.ones((1, 256)))[..., :2] > 0).all()
