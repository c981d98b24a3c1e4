"""Properties of the predefined hard scenes."""

import numpy as np
import pytest
from figures.hard_scenes import hard_cases

from rfpipe.scenes import reference_scene

CASES = hard_cases()


def matrix(name):
    return CASES[name]().dense()


def test_direct_light_is_1e5_times_the_indirect():
    dense = matrix("bright_direct")
    indirect = dense.sum(1) - reference_scene("IV", (16, 16), channels=1, bounces=1).dense().sum(1)
    assert indirect.max() == pytest.approx(1e-5 * dense.diagonal().max(), rel=1e-3)


def test_scenes_have_the_stated_ranks():
    ranks = {"zero_transport": 0, "diffuse_cavity": 1, "mirror": 256, "random_dense": 256}
    assert {name: np.linalg.matrix_rank(matrix(name), rtol=1e-4) for name in ranks} == ranks
