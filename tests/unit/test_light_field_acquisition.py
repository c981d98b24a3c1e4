"""Symmetric photography of a light field of 3 x 3 views, at a fifth of the thesis' resolution."""

import numpy as np
import pytest
from tests.rigs.known_matrix import picture_error

from rfpipe import acquire
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import OperatorRig, SimulatedRig
from rfpipe.scenes import relighting_patterns, room_scene
from rfpipe.stages.evaluate import relative_rms
from rfpipe.stages.relight import images_of, one_view_at_a_time
from rfpipe.testing import dot_test

pytestmark = pytest.mark.slow

TOLERANCE = 2e-3


@pytest.fixture(scope="module")
def scene():
    return room_scene(("texture", "white", "white"), (26, 40), views=(3, 3), channels=1)


@pytest.mark.parametrize("camera", [None, CameraModel()], ids=["exact", "camera"])
def test_errors_of_pictures_are_near_the_tolerance_of_floodlit_light(scene, camera):
    result = acquire(SimulatedRig(scene, camera, seed=1), tolerance=TOLERANCE, progress=False)
    assert result.transport.camera_shape == (9, 26, 40)
    levels = result.levels.set_index("level")
    assert list(levels["patterns"][:2]) == [1, 9]  # the tree first splits into views
    assert list(levels["nodes"][:2]) == [1, 45]
    assert result.patterns < 9 * 26 * 40 / 6

    white = np.ones((1, *scene.shape), np.float32)
    patterns = np.stack([white[0], *relighting_patterns(scene.shape).values()])
    floodlit, *truth = images_of(scene, patterns)
    for relit, true in zip(result.transport.relight_batch(patterns[1:]), truth, strict=True):
        assert np.linalg.norm(relit - true) < 3 * TOLERANCE * np.linalg.norm(floodlit)

    # the pictures of [thesis Fig. 5.8]: each view in the light of each other view
    lights = one_view_at_a_time(scene.shape)
    relit, truth = result.transport.relight_batch(lights), images_of(scene, lights)
    between = [relative_rms(relit[a, b], truth[a, b]) for a in range(9) for b in range(9)]
    assert max(between) < 0.02
    dot_test(result.transport)


@pytest.mark.parametrize("tolerance", [3e-2, 1e-2, 3e-3])
def test_equal_views_with_direct_light_are_not_approximated_as_smooth(tolerance):
    """Complete views light all views equally, although each ray lights a different pixel."""
    spots = generator(4).uniform(0.2, 1.0, 64)
    block = np.diag(spots) + 0.02 * np.outer(spots, spots)
    shape = (4, 8, 8)
    matrix = np.kron(np.ones((4, 4)), block) / 8
    result = acquire(OperatorRig(matrix, shape, shape), tolerance=tolerance, progress=False)
    lit = generator(5).random((3, *shape)) < 0.5
    assert picture_error(result.transport, matrix, lit) < 3 * tolerance
