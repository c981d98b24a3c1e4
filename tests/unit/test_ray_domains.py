"""Views arranged in rows and columns, (rows, columns, H, W), from patterns to pictures."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.rigs.known_matrix import dense

from rfpipe import OperatorRig, acquire
from rfpipe.calibration.rays import coverage
from rfpipe.calibration.symmetry import random_signs
from rfpipe.photometry import CameraModel
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.scenes import ONE_VIEW, relighting_patterns, room_scene
from rfpipe.scenes.matrix import MatrixScene
from rfpipe.stages.evaluate import relative_rms
from rfpipe.stages.relight import one_view_at_a_time, relit_arrays
from rfpipe.transport import open_transport, save_transport

STACKED, ARRANGED = (4, 3, 4), (2, 2, 3, 4)
METHODS = ("brute_force", "dual", "hadamard", "near_far", "symmetric")


@pytest.fixture(scope="module")
def matrix() -> NDArray[np.float64]:
    scene = room_scene(("texture", "white", "white"), STACKED[1:], views=(2, 2), channels=1)
    matrix: NDArray[np.float64] = scene.dense(0).astype(np.float64)
    return (matrix + matrix.T) / 2


@pytest.mark.parametrize("method", METHODS)
def test_the_arrangement_of_views_does_not_change_the_transport(method, matrix, tmp_path):
    stacked, arranged = (
        acquire(OperatorRig(matrix, shape, shape, CameraModel(), seed=3), method, progress=False)
        for shape in (STACKED, ARRANGED)
    )
    assert arranged.transport.camera_shape == arranged.transport.projector_shape == ARRANGED
    assert arranged.levels.equals(stacked.levels)
    np.testing.assert_array_equal(dense(arranged.transport), dense(stacked.transport))
    save_transport(arranged.transport, tmp_path / "transport.zarr")
    opened = open_transport(tmp_path / "transport.zarr")
    assert opened.camera_shape == ARRANGED
    np.testing.assert_array_equal(dense(opened), dense(stacked.transport))
    image = opened.T.relight(np.ones(ARRANGED, np.float32))
    assert image.shape == (*ARRANGED, 1)


def test_pictures_of_arranged_views_equal_those_of_a_stack(matrix):
    transport = acquire(OperatorRig(matrix, ARRANGED, ARRANGED), progress=False).transport
    arrays = relit_arrays(transport, MatrixScene(matrix, ARRANGED, ARRANGED))
    assert arrays["relit"].shape == (6, *ARRANGED, 1)
    assert arrays["views_relit"].shape == arrays["views_truth"].shape == (4, *STACKED, 1)
    for light in range(4):
        of_light = matrix.reshape(48, 4, 12)[:, light].sum(axis=1)
        view_truth = arrays["views_truth"][light].reshape(-1)
        np.testing.assert_allclose(view_truth, of_light, rtol=1e-5)
    assert relative_rms(arrays["views_relit"], arrays["views_truth"]) < 0.02


def test_the_arrangement_of_views_does_not_change_the_patterns():
    arranged, stacked = relighting_patterns(ARRANGED), relighting_patterns(STACKED)
    assert list(arranged) == list(stacked)
    for name, pattern in arranged.items():
        assert pattern.shape == ARRANGED
        np.testing.assert_array_equal(pattern.ravel(), stacked[name].ravel())
    assert arranged[ONE_VIEW].sum() == arranged[ONE_VIEW][0, 0].sum() == 12
    np.testing.assert_array_equal(
        one_view_at_a_time(ARRANGED), one_view_at_a_time(STACKED).reshape(4, *ARRANGED)
    )
    signs = random_signs(ARRANGED, 2, seed=1)
    np.testing.assert_array_equal(signs.reshape(2, *STACKED), random_signs(STACKED, 2, 1))


def test_a_calibration_needs_a_map_for_each_of_arranged_views():
    rays = np.arange(48, dtype=np.int32).reshape(6, 8)
    layout = ProjectorLayout(ARRANGED, rays)
    np.testing.assert_array_equal(layout.picture(np.ones(ARRANGED)), np.ones((6, 8)))
    with pytest.raises(ValueError, match="shorter"):
        coverage([lambda points: points] * 2, layout, (4, 4))
