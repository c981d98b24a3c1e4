"""Projector layouts: the ray of each projector pixel."""

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe.rigs import ProjectorLayout


def test_a_grid_is_centred_in_whole_pixels() -> None:
    layout = ProjectorLayout.grid((7, 12), (2, 3))
    expected = np.full((7, 12), -1)
    expected[0:6, 1:10] = np.repeat(np.repeat([[0, 1, 2], [3, 4, 5]], 3, axis=0), 3, axis=1)
    assert np.array_equal(layout.ray_of_pixel, expected)
    assert layout.display_shape == (7, 12)


def test_a_pattern_becomes_a_picture() -> None:
    rays = np.array([[0, 0, 5], [1, -1, 4]], np.int32)
    layout = ProjectorLayout((2, 3), rays)
    pattern = np.arange(6, dtype=np.float32).reshape(2, 3) / 5
    picture = layout.picture(pattern)
    assert picture.dtype == np.float32
    assert picture == pytest.approx(np.array([[0, 0, 1], [0.2, 0, 0.8]]))


@pytest.mark.parametrize(
    ("shape", "rays", "expected"),
    [
        ((2, 3), np.array([[6]]), "has 6 to 6; expected -1"),
        ((6,), np.array([[0]]), r"expected height and width, \(H, W\)"),
    ],
)
def test_invalid_layouts_are_refused(
    shape: tuple[int, ...], rays: np.ndarray, expected: str
) -> None:
    with pytest.raises(InputError, match=expected):
        ProjectorLayout(shape, rays)


def test_impossible_grids_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(8, 8\) rays don't fit into a picture of \(7, 12\)"):
        ProjectorLayout.grid((7, 12), (8, 8))
    with pytest.raises(InputError, match="Calibrate the rig to measure"):
        ProjectorLayout.grid((7, 12), (2, 3, 3))
