"""A light field of 3 x 3 views by symmetric photography, at a fifth of the thesis' resolution."""

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

# Relative errors allowed in total at a tolerance of 2e-3; about 1.5 times what was measured. A spot
# of twelve pixels a view is little light for the tolerance, which is of the floodlit maximum.
MARKS = {"spot": 0.05, "vertical_bar": 0.02, "one_view": 0.01, "noise": 0.008}
USUAL_MARK = 0.013


@pytest.fixture(scope="module")
def scene():
    return room_scene(("texture", "white", "white"), (26, 40), views=(3, 3), channels=1)


@pytest.mark.parametrize("camera", [None, CameraModel()], ids=["exact", "camera"])
def test_the_field_is_recovered_in_a_sixth_of_the_patterns_of_brute_force(scene, camera):
    result = acquire(SimulatedRig(scene, camera, seed=1), tolerance=2e-3, progress=False)
    assert result.transport.camera_shape == (9, 26, 40)
    levels = result.levels.set_index("level")
    assert list(levels["patterns"][:2]) == [1, 9]  # the tree first splits into views
    assert list(levels["nodes"][:2]) == [1, 45]
    assert result.patterns < 9 * 26 * 40 / 6

    patterns = relighting_patterns(scene.shape)
    relit = result.transport.relight_batch(np.stack(list(patterns.values())))
    truth = images_of(scene, np.stack(list(patterns.values())))
    errors = {
        name: relative_rms(*images) for name, *images in zip(patterns, relit, truth, strict=True)
    }
    too_large = {n: e for n, e in errors.items() if not e < MARKS.get(n, USUAL_MARK)}
    assert not too_large

    # the pictures of Fig. 5.8, each view in the light of each
    lights = one_view_at_a_time(scene.shape)
    relit, truth = result.transport.relight_batch(lights), images_of(scene, lights)
    between = [relative_rms(relit[a, b], truth[a, b]) for a in range(9) for b in range(9)]
    assert max(between) < 0.02
    dot_test(result.transport)


@pytest.mark.parametrize("tolerance", [3e-2, 1e-2, 3e-3])
def test_views_that_see_the_same_spots_alike_are_not_taken_for_smooth(tolerance):
    """Whole views light all views alike, whatever each ray does."""
    spots = generator(4).uniform(0.2, 1.0, 64)
    block = np.diag(spots) + 0.02 * np.outer(spots, spots)
    shape = (4, 8, 8)
    matrix = np.kron(np.ones((4, 4)), block) / 8
    result = acquire(OperatorRig(matrix, shape, shape), tolerance=tolerance, progress=False)
    lit = generator(5).random((3, *shape)) < 0.5
    assert picture_error(result.transport, matrix, lit) < 3 * tolerance
