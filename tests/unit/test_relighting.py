"""Pictures for relighting tests, and the errors of relit pictures."""

import numpy as np
import pytest

from rfpipe.provenance import generator
from rfpipe.relighting import KINDS, picture_errors, relighting_pictures

SIDE = 48


def test_each_kind_has_a_third_of_the_pictures():
    drawn = relighting_pictures((SIDE, 2 * SIDE), 60)
    assert drawn.dtype == np.float32
    assert set(np.unique(drawn)) == {0, 1}
    assert len({picture.tobytes() for picture in drawn}) == 60
    shapes, bars, spots = (drawn[first :: len(KINDS)] for first in range(len(KINDS)))
    lit = shapes.mean(axis=(1, 2))
    assert (lit >= 0.099).all()
    assert (lit <= 0.601).all()
    for bar in bars:  # pixels between two lit pixels of a bar are lit
        rows = [np.flatnonzero(row) for row in bar if row.any()]
        assert all(np.ptp(row) == len(row) - 1 for row in rows)
    sides = []
    for spot in spots:
        extents = [np.ptp(pixels) + 1 for pixels in np.nonzero(spot)]
        assert extents[0] == extents[1]
        assert spot.sum() == extents[0] ** 2
        sides.append(extents[0])
    assert {min(sides), max(sides)} == {2, SIDE // 8}


def test_the_first_pictures_do_not_depend_on_their_number():
    four, eleven = relighting_pictures((9, 13), 4, 5), relighting_pictures((9, 13), 11, 5)
    np.testing.assert_array_equal(four, eleven[:4])
    assert (relighting_pictures((9, 13), 4, 6) != four).any()
    assert relighting_pictures((9, 13), 0).shape == (0, 9, 13)


def test_all_views_or_one_view_get_the_same_picture():
    views = relighting_pictures((3, 9, 13), 6, 1)
    assert views.shape == (6, 3, 9, 13)
    single = relighting_pictures((9, 13), 6, 1)
    for index, (stack, picture) in enumerate(zip(views, single, strict=True)):
        lit = stack.any(axis=(1, 2))
        assert lit.sum() == (3 if index < 3 else 1)
        for view in stack[lit]:
            np.testing.assert_array_equal(view, picture)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (3, 2), (2, 1, 1)])
def test_the_smallest_domains_have_pictures(shape):
    drawn = relighting_pictures(shape, 9).reshape(9, -1)
    assert drawn.shape[1] == np.prod(shape)
    assert (drawn.max(axis=1) == 1).all()


def scene(seed: int = 0, direct: float = 1.0) -> np.ndarray:
    """Return a coaxial matrix of 6 x 8 rays with uniform indirect light and black last rays."""
    albedo = generator(seed).uniform(0.2, 1, 48)
    albedo[40:] = 0
    return np.diag(direct * albedo) + 0.01 * np.outer(albedo, albedo)


def relit(matrix: np.ndarray, patterns: np.ndarray) -> np.ndarray:
    return (patterns.reshape(len(patterns), -1) @ matrix.T).reshape(len(patterns), 6, 8, 1)


PATTERNS = relighting_pictures((6, 8), 9)
WHITE = relit(scene(), np.ones((1, 6, 8)))[0]


def test_the_error_of_a_brighter_picture_is_its_gain():
    truth = relit(scene(), PATTERNS)
    for errors in picture_errors(truth, truth, PATTERNS, WHITE, PATTERNS == 0):
        assert (errors == 0).all()
    total, unknown = picture_errors(1.1 * truth, truth, PATTERNS, WHITE)
    assert total.max() == pytest.approx(0.1)
    assert (total <= 0.1 + 1e-12).all()  # errors of dark pictures are relative to a larger norm
    assert np.isnan(unknown).all()


def test_the_error_of_a_dark_spot_is_relative_to_typical_spots():
    spot = np.zeros((1, 6, 8))
    spot[0, 5, 2:4] = 1  # both rays are black
    truth = relit(scene(), spot)
    assert not truth.any()
    total, indirect = picture_errors(truth + 0.01, truth, spot, WHITE, spot == 0)
    wrong = 0.01 * np.sqrt(48)
    assert total[0] == pytest.approx(wrong / (0.5 * np.linalg.norm(WHITE) * np.sqrt(2 / 48)))
    assert indirect[0] == 0  # no picture sends any light to its dark pixels


def test_the_indirect_error_is_relative_to_the_light_of_unlit_pixels():
    truth, dark = relit(scene(), PATTERNS), PATTERNS == 0
    half = relit(scene() - 0.5 * 0.01 * np.outer(*2 * [np.diag(scene())]), PATTERNS)
    total, indirect = picture_errors(half, truth, PATTERNS, WHITE, dark)
    brighter = relit(scene(direct=2), PATTERNS)
    assert (picture_errors(brighter, truth, PATTERNS, WHITE, dark)[1] < 1e-12).all()
    sent = np.where(dark[..., None], truth, 0).reshape(9, -1)
    bright = (sent**2).sum(axis=1) > 0.3 * (sent**2).sum(axis=1).mean()
    assert indirect[bright] == pytest.approx(0.5, rel=0.05)
    assert (total < 0.1).all()


def test_several_transports_are_compared_with_one_truth():
    truth = relit(scene(), PATTERNS)
    estimates = np.stack([1.1 * truth, truth + 0.01], axis=1)
    total, indirect = picture_errors(iter(estimates), iter(truth), PATTERNS, WHITE, PATTERNS == 0)
    for index in range(2):
        single = picture_errors(estimates[:, index], truth, PATTERNS, WHITE, PATTERNS == 0)
        np.testing.assert_allclose((total[index], indirect[index]), single, rtol=1e-12)
    assert picture_errors(truth[:0], truth[:0], PATTERNS[:0], WHITE)[0].shape == (0,)
