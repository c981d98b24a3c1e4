"""Surface points of pixels, occlusion, textures and relighting patterns."""

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe.scenes import (
    GEOMETRIES,
    ONE_VIEW,
    Occluder,
    Pinhole,
    Plane,
    relighting_patterns,
    surface_points,
)
from rfpipe.scenes.geometries import (
    INK,
    PAPER,
    SURFACE_TINTS,
    WHITE,
    printed_page,
    surface_albedo,
    surface_names,
)
from rfpipe.scenes.surfaces import is_occluded

SQUARE = Occluder((0, 0, 1), (0.5, 0, 0), (0, 0.5, 0))  # in the plane z = 1


def test_planes_meet_at_the_angles_of_their_names():
    for name, opening in (("wedge", 90), ("wedge_30", 30), ("wedge_120", 120),
                          ("tilted_wedge", 90)):  # fmt: skip
        left_normal, right_normal = (plane.unit_normal for plane in GEOMETRIES[name])
        assert np.degrees(np.pi - np.arccos(left_normal @ right_normal)) == pytest.approx(opening)
    corner = np.stack([plane.unit_normal for plane in GEOMETRIES["corner"]])
    assert corner @ corner.T == pytest.approx(np.eye(3), abs=1e-12)


def test_points_of_plane_and_wedge_have_exact_positions_and_areas():
    points = surface_points((31, 35), GEOMETRIES["plane"])
    assert np.allclose(points.positions[:, 2], 3)
    assert np.allclose(points.positions[0, :2], [-17 / 31 * 3, -15 / 31 * 3])
    # the central ray represents the area of its pixel, with an error of second order
    assert points.areas.sum() == pytest.approx(3 * 3 * 35 / 31, rel=1e-12)
    wedge = surface_points((200, 240), GEOMETRIES["wedge"])
    x, _, z = wedge.positions.T
    assert np.allclose(z, 3 - np.abs(x))
    assert np.array_equal(wedge.surface, (x > 0).astype(int))
    near = 3 / (1 + 240 / 200 / 2)  # depth at the image's left and right end
    side = (3 - near) * np.sqrt(2)  # of the plane, from the edge to there
    assert wedge.areas.sum() == pytest.approx(2 * side * (3 + near) / 2, rel=1e-4)


@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("shape", [(64, 64), (62, 70), (33, 31), (1, 5), (7, 3), (1, 1)])
def test_every_ray_hits_a_surface_and_rooms_are_divided_evenly(geometry, shape):
    points = surface_points(shape, GEOMETRIES[geometry])
    assert (points.areas > 0).all()
    assert np.isfinite(points.positions).all()
    if min(shape) > 30:
        names = np.array([surface.name for surface in points.surfaces])[points.surface]
        shares = np.unique(names, return_counts=True)[1] / len(names)
        assert len(shares) == len(surface_names(geometry))
        assert shares.min() > 0.3 / len(shares)


def test_the_sphere_rests_on_its_floor_and_its_visible_cap_is_covered():
    floor, wall, sphere = GEOMETRIES["sphere_on_plane"]
    centre = np.array(sphere.centre)
    assert floor.heights(centre) == pytest.approx(sphere.radius)
    assert wall.heights(centre) > 1.5 * sphere.radius
    points = surface_points((200, 210), GEOMETRIES["sphere_on_plane"])
    on_sphere = points.surface == 2
    radii = np.linalg.norm(points.positions[on_sphere] - centre, axis=1)
    assert radii == pytest.approx(sphere.radius, rel=1e-9)
    cap = 2 * np.pi * sphere.radius**2 * (1 - sphere.radius / np.linalg.norm(centre))
    assert points.areas[on_sphere].sum() == pytest.approx(cap, rel=0.08)
    assert points.areas.max() < 10 * points.mean_area  # rays along the limb, too


def test_invalid_surfaces_and_positions_are_refused():
    with pytest.raises(InputError, match=r"pixel \(0, 0\) .* floor"):
        surface_points((4, 4), (Plane("floor", (0, 1, 0), (0, -1, 0)),))
    with pytest.raises(InputError, match="another point to look at"):
        Pinhole((4, 5), (1, 0, 1), (1, 5, 1))


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ((0, 0, 0), (0, 0, 2), True),
        ((0, 0, 0), (0.9, 0, 2), True),  # crosses at x = 0.45
        ((0, 0, 0), (1.1, 0, 2), False),
        ((0, 0, 0), (0, 0, 0.9), False),  # in front of the occluder
        ((0.1, 0, 1), (0.1, 0, 2), False),  # starts on the occluder
        ((-0.2, 0, 1), (0.2, 0, 1), False),  # runs within its plane
    ],
)
def test_segments_are_blocked_by_an_occluder(first, second, expected):
    p, q = (np.array(point, dtype=float) for point in (first, second))
    assert bool(is_occluded(p, q, [SQUARE])) is bool(is_occluded(q, p, [SQUARE])) is expected


@pytest.mark.parametrize("shape", [(62, 70), (155, 175)])
def test_textures_have_high_frequencies_and_depend_on_seed_and_surface(shape):
    page = printed_page(shape, seed=3, page=1)
    assert np.array_equal(page, printed_page(shape, seed=3, page=1))
    assert not np.array_equal(page, printed_page(shape, seed=4, page=1))
    assert not np.array_equal(page, printed_page(shape, seed=3, page=0))
    assert 0.3 < page.mean() < 0.45
    # strokes are one or two pixels wide, so that ink changes every few pixels
    assert (page[:, 1:] != page[:, :-1]).mean() > 0.25
    assert (page[1:] != page[:-1]).mean() > 0.15


def test_albedo_has_the_stated_values_and_its_tint_stays_below_one():
    grey = surface_albedo("texture", (62, 70), 1, 0, 0)
    assert set(np.unique(grey)) == {INK, PAPER}
    assert (surface_albedo("white", (4, 5), 1, 0, 1) == WHITE).all()
    for surface, tint in enumerate(SURFACE_TINTS):
        colour = surface_albedo("texture", (62, 70), 3, 0, surface)
        grey = surface_albedo("texture", (62, 70), 1, 0, surface)
        assert colour.max() < 0.95
        assert colour == pytest.approx(grey * np.array(tint))


def test_relighting_patterns_follow_the_design_and_their_seed():
    patterns = relighting_patterns((62, 70), seed=1)
    assert list(patterns) == ["vertical_bar", "horizontal_bar", "noise", "binary", "spot"]
    assert all(p.dtype == np.float32 and p.shape == (62, 70) for p in patterns.values())
    columns = np.flatnonzero(patterns["vertical_bar"].all(0))
    assert columns.tolist() == list(range(13, 21))  # 70 / 8 wide, centred at 70 / 4
    assert np.flatnonzero(patterns["horizontal_bar"].all(1)).tolist() == list(range(20, 31))
    assert 0 <= patterns["noise"].min() < 0.01
    assert 0.99 < patterns["noise"].max() <= 1
    assert 0.2 < patterns["binary"].mean() < 0.8
    assert (np.diff(patterns["binary"], axis=0) != 0).mean() < 0.2  # smooth outlines
    rows, columns = np.nonzero(patterns["spot"])
    assert (np.ptp(rows) + 1, np.ptp(columns) + 1, len(rows)) == (3, 4, 12)
    assert columns.max() < 35
    assert not np.array_equal(patterns["noise"], relighting_patterns((62, 70), seed=2)["noise"])
    for shape in ((1, 1), (1, 37), (37, 1), (2, 2)):
        assert all(picture.any() for picture in relighting_patterns(shape).values())
    for shape in ((4,), (0, 3), (1, 0, 3, 4)):
        with pytest.raises(InputError, match=r"expected height and width"):
            relighting_patterns(shape)


def test_relighting_patterns_of_views_repeat_the_picture():
    views, image = relighting_patterns((3, 8, 10)), relighting_patterns((8, 10))
    one_view = views.pop(ONE_VIEW)
    assert one_view[0].all()
    assert not one_view[1:].any()
    for name, stack in views.items():
        assert stack.shape == (3, 8, 10)
        assert all(np.array_equal(view, image[name]) for view in stack)
