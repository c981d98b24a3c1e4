"""Surface points behind the pixels, textures and relighting patterns."""

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe.scenes import GEOMETRIES, ONE_VIEW, Plane, relighting_patterns, surface_points
from rfpipe.scenes.textures import INK, PAPER, TINTS, WHITE, printed_page, surface_albedo


def test_plane_points_lie_at_z_3_and_cover_the_visible_rectangle():
    points = surface_points((31, 35), GEOMETRIES["plane"])
    assert np.allclose(points.positions[:, 2], 3)
    assert np.allclose(points.positions[0, :2], [-17 / 31 * 3, -15 / 31 * 3])
    # each pixel's central ray stands for its whole area: the error is of second order
    assert points.areas.sum() == pytest.approx(3 * 3 * 35 / 31, rel=1e-12)


def test_wedge_points_lie_on_z_3_minus_x_and_meet_at_right_angles():
    points = surface_points((20, 24), GEOMETRIES["wedge"])
    x, _, z = points.positions.T
    assert np.allclose(z, 3 - np.abs(x))
    assert np.array_equal(points.surface, (x > 0).astype(int))
    normals = [plane.unit_normal for plane in points.planes]
    assert normals[0] @ normals[1] == pytest.approx(0, abs=1e-15)
    assert all(
        (plane.heights(np.zeros(3)) > 0) and np.allclose(plane.axes() @ plane.unit_normal, 0)
        for plane in points.planes
    )


def test_wedge_areas_add_up_to_the_visible_trapezoids():
    points = surface_points((200, 240), GEOMETRIES["wedge"])
    end = 240 / 200 / 2
    near = 3 / (1 + end)  # depth at the image's left and right end
    side = (3 - near) * np.sqrt(2)  # of the plane, from the edge to there
    assert points.areas.sum() == pytest.approx(2 * side * (3 + near) / 2, rel=1e-4)


def test_odd_width_gives_the_middle_column_to_the_left_plane():
    points = surface_points((5, 7), GEOMETRIES["wedge"])
    surface = points.surface.reshape(5, 7)
    assert (surface[:, :4] == 0).all()
    assert (surface[:, 4:] == 1).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 37), (37, 1), (13, 29)])
def test_tiny_domains_have_finite_points_and_positive_areas(shape):
    points = surface_points(shape, GEOMETRIES["wedge"])
    assert points.positions.shape == (shape[0] * shape[1], 3)
    assert np.isfinite(points.positions).all()
    assert (points.areas > 0).all()


@pytest.mark.parametrize("shape", [(0, 4), (4,), (2, 3, 4)])
def test_a_shape_that_is_no_image_is_refused(shape):
    with pytest.raises(InputError, match="height and width"):
        surface_points(shape, GEOMETRIES["plane"])


def test_a_pixel_that_sees_no_plane_is_named():
    floor = Plane("floor", (0, 1, 0), (0, -1, 0))
    with pytest.raises(InputError, match=r"pixel \(0, 0\) .* floor"):
        surface_points((4, 4), (floor,))


def test_pages_follow_from_their_seed_and_differ_between_seeds_and_surfaces():
    page = printed_page((62, 70), seed=3, page=1)
    assert np.array_equal(page, printed_page((62, 70), seed=3, page=1))
    assert not np.array_equal(page, printed_page((62, 70), seed=4, page=1))
    assert not np.array_equal(page, printed_page((62, 70), seed=3, page=0))


@pytest.mark.parametrize("shape", [(62, 70), (64, 64), (155, 175)])
def test_strokes_are_dense_and_of_high_frequency_at_every_resolution(shape):
    page = printed_page(shape, seed=0)
    assert 0.3 < page.mean() < 0.45
    # strokes are one or two pixels wide, so that ink changes every few pixels
    assert (page[:, 1:] != page[:, :-1]).mean() > 0.25
    assert (page[1:] != page[:-1]).mean() > 0.15


def test_albedo_has_the_stated_values_and_its_tint_stays_below_one():
    grey = surface_albedo("texture", (62, 70), 1, 0, 0)
    assert set(np.unique(grey)) == {INK, PAPER}
    assert (surface_albedo("white", (4, 5), 1, 0, 1) == WHITE).all()
    for surface, tint in enumerate(TINTS):
        colour = surface_albedo("texture", (62, 70), 3, 0, surface)
        assert colour.max() < 0.95
        assert colour == pytest.approx(
            surface_albedo("texture", (62, 70), 1, 0, surface) * np.array(tint)
        )
        assert tint[1] == 1


def test_relighting_patterns_are_those_of_the_design():
    patterns = relighting_patterns((62, 70), seed=1)
    assert list(patterns) == ["vertical_bar", "horizontal_bar", "noise", "binary", "spot"]
    assert all(p.dtype == np.float32 and p.shape == (62, 70) for p in patterns.values())
    columns = np.flatnonzero(patterns["vertical_bar"].all(0))
    assert columns.tolist() == list(range(13, 21))  # 70 / 8 wide, centred at 70 / 4
    assert np.flatnonzero(patterns["horizontal_bar"].all(1)).tolist() == list(range(20, 31))
    assert 0 <= patterns["noise"].min() < 0.01
    assert 0.99 < patterns["noise"].max() <= 1
    assert set(np.unique(patterns["binary"])) == {0, 1}
    assert 0.2 < patterns["binary"].mean() < 0.8
    changes = (np.diff(patterns["binary"], axis=0) != 0).mean()
    assert changes < 0.2  # smooth outlines
    rows, columns = np.nonzero(patterns["spot"])
    assert patterns["spot"].sum() == 12
    assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == (3, 4)
    assert columns.max() < 35


def test_relighting_patterns_follow_from_their_seed():
    first, same, other = (relighting_patterns((16, 16), seed=s) for s in (1, 1, 2))
    assert all(np.array_equal(first[name], same[name]) for name in first)
    assert not np.array_equal(first["noise"], other["noise"])
    assert not np.array_equal(first["binary"], other["binary"])


@pytest.mark.parametrize("shape", [(1, 1), (1, 37), (37, 1), (2, 2), (13, 29)])
def test_relighting_patterns_light_something_on_tiny_domains(shape):
    for picture in relighting_patterns(shape).values():
        assert picture.shape == shape
        assert picture.any()


def test_relighting_patterns_of_views_repeat_the_picture():
    views, image = relighting_patterns((3, 8, 10)), relighting_patterns((8, 10))
    one = views.pop(ONE_VIEW)
    assert one[0].all()
    assert not one[1:].any()
    assert list(views) == list(image)
    for name, stack in views.items():
        assert stack.shape == (3, 8, 10)
        assert all(np.array_equal(view, image[name]) for view in stack)


@pytest.mark.parametrize("shape", [(4,), (0, 3), (1, 0, 3, 4)])
def test_relighting_patterns_refuse_other_shapes(shape):
    with pytest.raises(InputError, match=r"expected height and width"):
        relighting_patterns(shape)
