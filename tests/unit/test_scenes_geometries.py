"""Rooms beside the wedge at right angles: where their surfaces are, and the light between them."""

from itertools import cycle

import numpy as np
import pytest

from rfpipe.config import SceneSettings
from rfpipe.errors import InputError
from rfpipe.photometry import CameraModel
from rfpipe.plugins import SCENES, names
from rfpipe.provenance import fingerprint
from rfpipe.scenes import (
    CREASE,
    GEOMETRIES,
    Occluder,
    RadiosityScene,
    planes_scene,
    reference_scene,
    relighting_patterns,
    room_scene,
    scene_from_config,
    scene_patterns,
    surface_points,
)
from rfpipe.scenes.facing import facing_pairs
from rfpipe.scenes.formfactors import DENSE_LIMIT, form_factors
from rfpipe.scenes.geometries import TINTS, names_of
from rfpipe.scenes.spheres import hidden
from rfpipe.scenes.textures import WHITE

ROOMS = ("wedge_30", "wedge_120", "tilted_wedge", "corner", "sphere_on_plane", "coloured_room")
SCREEN = Occluder((0.1, 0.1, 2.2), (0.2, 0, 0.1), (0, 0.15, 0.05))


def textured(geometry, shape, **settings):
    surfaces = [kind for _, kind in zip(names_of(geometry), cycle(("texture", "white")))]
    return planes_scene(geometry, surfaces, shape, **settings)


def normals_of(points):
    normals = np.zeros_like(points.positions)
    for index, plane in enumerate(points.planes):
        normals[points.surface == index] = plane.unit_normal
    on_sphere = points.surface == len(points.planes)
    if on_sphere.any():
        outwards = points.positions[on_sphere] - np.array(points.sphere.centre)
        normals[on_sphere] = outwards / np.linalg.norm(outwards, axis=1)[:, None]
    return normals


def test_planes_meet_at_the_angles_of_their_names():
    for name, opening in (("wedge", 90), ("wedge_30", 30), ("wedge_120", 120),
                          ("tilted_wedge", 90)):  # fmt: skip
        left, right = (plane.unit_normal for plane in GEOMETRIES[name])
        assert np.degrees(np.pi - np.arccos(left @ right)) == pytest.approx(opening)
    corner = np.stack([plane.unit_normal for plane in GEOMETRIES["corner"]])
    assert corner @ corner.T == pytest.approx(np.eye(3), abs=1e-12)
    assert corner[:, 2] == pytest.approx(-1 / np.sqrt(3))  # seen along the diagonal
    assert corner[2, 1] < 0 < corner[0, 1]  # y points down: the floor faces up


def test_the_crease_of_the_tilted_wedge_is_neither_upright_nor_across_the_view():
    left, right = (plane.unit_normal for plane in GEOMETRIES["tilted_wedge"])
    along = np.cross(left, right)
    along /= np.linalg.norm(along)
    assert np.degrees(np.arcsin(abs(along[2]))) == pytest.approx(20)
    assert np.degrees(np.arctan2(abs(along[0]), abs(along[1]))) == pytest.approx(25)


@pytest.mark.parametrize("geometry", ROOMS)
@pytest.mark.parametrize("shape", [(64, 64), (62, 70), (33, 31), (1, 5), (7, 3)])
def test_every_ray_meets_a_surface_and_each_room_is_evenly_shared(geometry, shape):
    points = surface_points(shape, GEOMETRIES[geometry])
    assert (points.areas > 0).all()
    assert np.isfinite(points.positions).all()
    if min(shape) > 30:
        names = np.array([surface.name for surface in points.surfaces])[points.surface]
        shares = np.unique(names, return_counts=True)[1] / len(names)
        assert len(shares) == len(names_of(geometry))
        assert shares.min() > 0.3 / len(shares)


@pytest.mark.parametrize("geometry", ["wedge_30", "tilted_wedge", "corner"])
def test_pixels_cover_as_much_at_any_resolution(geometry):
    coarse, fine = (
        surface_points((side, side), GEOMETRIES[geometry]).areas.sum() for side in (40, 160)
    )
    assert coarse == pytest.approx(fine, rel=5e-3)


def test_the_sphere_rests_on_its_floor_and_its_visible_cap_is_covered():
    floor, wall, sphere = GEOMETRIES["sphere_on_plane"]
    centre = np.array(sphere.centre)
    assert floor.heights(centre) == pytest.approx(sphere.radius)
    assert wall.heights(centre) > 1.5 * sphere.radius
    points = surface_points((200, 210), GEOMETRIES["sphere_on_plane"])
    on_sphere = points.surface == 2
    radii = np.linalg.norm(points.positions[on_sphere] - centre, axis=1)
    assert radii == pytest.approx(sphere.radius, rel=1e-9)
    distance = np.linalg.norm(centre)
    cap = 2 * np.pi * sphere.radius**2 * (1 - sphere.radius / distance)
    assert points.areas[on_sphere].sum() == pytest.approx(cap, rel=0.08)
    assert points.areas.max() < 10 * points.mean_area  # rays along the limb, too


def test_other_orders_of_surfaces_are_refused():
    floor, wall, sphere = GEOMETRIES["sphere_on_plane"]
    with pytest.raises(InputError, match="at most one sphere, the last"):
        surface_points((4, 4), (sphere, floor, wall))


@pytest.mark.parametrize("geometry", ROOMS)
def test_light_transport_is_symmetric_and_applied_faithfully(geometry):
    scene = textured(geometry, (17, 19), occluders=[SCREEN])
    patterns = np.random.default_rng(0).random((3, 17 * 19))
    radiance = scene.apply(patterns)
    matrix = scene.dense(2)
    assert np.array_equal(matrix, matrix.T)
    assert (matrix >= 0).all()
    assert radiance[..., 2] == pytest.approx(patterns @ matrix, rel=1e-5)


@pytest.mark.parametrize("geometry", ROOMS)
@pytest.mark.parametrize("shape", [(32, 32), (33, 35), (62, 70)])
def test_no_point_gets_more_light_than_leaves_the_others(geometry, shape):
    points = surface_points(shape, GEOMETRIES[geometry])
    received = form_factors(points, compress=False).apply(points.areas[:, None])[:, 0]
    assert (received >= 0).all()
    assert 0.15 < received.max() <= 1


def test_a_point_in_the_crease_sees_what_the_opening_says():
    # In an endless wedge of opening t a point of the crease has the form factor (1 + cos t) / 2.
    for name, opening in (("wedge", 90), ("wedge_120", 120), ("wedge_30", 30)):
        points = surface_points((128, 128), GEOMETRIES[name])
        received = form_factors(points).apply(points.areas[:, None]).reshape(128, 128)
        expected = (1 + np.cos(np.radians(opening))) / 2
        assert received[64, 66] == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("occluders", [(), (SCREEN,)])
@pytest.mark.parametrize("geometry", ROOMS)
def test_compressed_form_factors_are_the_dense_ones(geometry, occluders):
    points = surface_points((37, 41), GEOMETRIES[geometry])
    dense, packed = (form_factors(points, occluders, compress=c) for c in (False, True))
    columns = np.random.default_rng(0).random((37 * 41, 3))
    columns[:, 1] = 0
    columns[700:704, 1] = 1  # light from a spot alone
    expected = dense.apply(columns)
    error = np.abs(packed.apply(columns) - expected)
    assert (error <= 5e-6 * expected + 1e-9 * expected.max(axis=0)).all()
    assert packed.nbytes < dense.nbytes


@pytest.mark.slow
def test_form_factors_with_a_sphere_follow_the_formulas_entry_by_entry():
    points = surface_points((18, 20), GEOMETRIES["sphere_on_plane"])
    found = form_factors(points, compress=False).apply(np.eye(360))
    to = points.positions[None] - points.positions[:, None]
    squared = np.maximum((to**2).sum(2), points.mean_area)
    normals = normals_of(points)
    cosines = [
        np.maximum(np.einsum("ijx,ix->ij", to, normals), 0),
        np.maximum(-np.einsum("ijx,jx->ij", to, normals), 0),
    ]
    expected = cosines[0] * cosines[1] / (np.pi * squared**2)
    centre, radius = np.array(points.sphere.centre), points.sphere.radius
    places = np.linspace(0, 1, 400)[1:-1, None, None, None]
    depth = np.full(found.shape, np.inf)
    for place in places:  # points along the segments between all pairs
        on_way = points.positions[:, None] + place * to
        depth = np.minimum(depth, np.linalg.norm(on_way - centre, axis=2))
    planes = points.surface < 2
    between_planes = planes[:, None] & planes
    shadow = between_planes & (depth < 0.999 * radius)
    clear = ~between_planes | (depth > 1.001 * radius)
    other = points.surface[:, None] != points.surface
    assert (found[shadow] == 0).all()
    assert found[clear & other] == pytest.approx(expected[clear & other], rel=1e-9, abs=1e-12)
    assert not found[~other].any()
    assert (shadow & (expected > 0)).sum() > 500
    assert (clear & other & (expected > 0)).sum() > 20_000


def test_the_sphere_hides_the_wall_behind_it_from_the_floor_before_it():
    _, wall, sphere = GEOMETRIES["sphere_on_plane"]
    centre, away = np.array(sphere.centre), wall.unit_normal
    before, behind = centre + 2 * sphere.radius * away, centre - 2 * sphere.radius * away
    aside = behind + np.array([3 * sphere.radius, 0, 0])
    assert hidden(sphere, before[None], np.stack([behind, aside])).tolist() == [[True, False]]
    touching = centre + np.array([sphere.radius, 0, 0]) + np.outer([-1, 1], away)
    assert not hidden(sphere, touching[:1], touching[1:]).any()


def test_nothing_shines_through_the_block_and_the_sphere_of_the_coloured_room():
    points = surface_points((24, 27), GEOMETRIES["coloured_room"])
    found = form_factors(points, compress=False).apply(np.eye(24 * 27))
    faces = [each for each in points.surfaces if each.name == "block"]
    places = np.linspace(0, 1, 300)[1:-1]
    inside = np.full(found.shape, -np.inf)  # how deep a segment goes into either, scene units
    for place in places:
        on_way = (1 - place) * points.positions[:, None] + place * points.positions
        in_block = -np.max([face.heights(on_way) for face in faces], axis=0)
        in_sphere = -GEOMETRIES["coloured_room"][-1].heights(on_way)
        inside = np.maximum(inside, np.maximum(in_block, in_sphere))
    assert not found[inside > 1e-6].any()
    to = points.positions[None] - points.positions[:, None]
    normals = normals_of(points)
    cosines = np.einsum("ijx,ix->ij", to, normals), -np.einsum("ijx,jx->ij", to, normals)
    squared = np.maximum((to**2).sum(2), points.mean_area)
    expected = cosines[0] * cosines[1] / (np.pi * squared**2)
    facing = (np.minimum(*cosines) > 1e-9) & (inside < -2e-2)
    assert found[facing] == pytest.approx(expected[facing], rel=1e-9)
    names = np.array([surface.name for surface in points.surfaces])[points.surface]
    walls = np.isin(names, ["left wall", "right wall"])
    across = np.ix_(walls, walls)
    shadows = (inside > 1e-6) & (np.minimum(*cosines) > 1e-9)
    assert (shadows[across].sum(), facing[across].sum()) > (2000, 2000)


def test_the_coloured_room_shows_its_colours_and_casts_them():
    room = planes_scene("coloured_room", ("white",) * 7, (32, 36))
    points = room.points
    names = np.array([surface.name for surface in points.surfaces])[points.surface]
    lit = np.zeros((1, 32 * 36))
    lit[0, names == "left wall"] = 1
    onto = {
        name: room.apply(lit)[0, names == name].mean(axis=0) for name in names_of("coloured_room")
    }
    assert onto["left wall"].argmax() == 0
    red, green, blue = onto["back wall"]  # white, in red light
    assert red > 2 * green > 2 * blue > 0
    assert TINTS["coloured_room"].keys() == set(names)
    for name, tint in TINTS["coloured_room"].items():
        seen = room.albedo.reshape(-1, 3)[names == name]
        assert seen == pytest.approx(np.broadcast_to(WHITE * np.array(tint), seen.shape))


def test_large_rooms_are_compressed_by_themselves():
    points = surface_points((128, 128), GEOMETRIES["corner"])
    assert sum(pair.size for pair in facing_pairs(points)) > DENSE_LIMIT


def test_the_settings_know_the_same_rooms_with_as_many_surfaces():
    others = {"room", "captured", "matrix", "mitsuba", "recorded"}
    assert set(GEOMETRIES) == set(names(SCENES)) - others
    for name in GEOMETRIES:
        surfaces = names_of(name)
        assert SceneSettings.model_of(name).surface_names == surfaces
        config = SceneSettings.of(name, surfaces=("white",) * len(surfaces), shape=(6, 7))
        assert scene_from_config(config).shape == (6, 7)
        with pytest.raises(
            ValueError, match=rf"{name} should have {len(surfaces)} surfaces .*, not 0"
        ):
            SceneSettings.of(name, surfaces=())


def test_rooms_are_told_apart_by_their_descriptions():
    ball = textured("sphere_on_plane", (6, 7)).describe()
    assert ball["sphere"]["radius"] == GEOMETRIES["sphere_on_plane"][2].radius
    assert "sphere" not in textured("corner", (6, 7)).describe()


@pytest.mark.parametrize(("width", "reach"), [(20, 1), (64, 1), (127, 1), (128, 2), (350, 5)])
def test_the_crease_strip_of_a_wedge_is_as_wide_as_said(width, reach):
    patterns = scene_patterns(reference_scene("II", (16, width), channels=1))
    assert list(patterns) == [*relighting_patterns((16, width)), CREASE]
    strip = patterns[CREASE]
    assert strip.dtype == np.float32
    assert (strip == strip[0]).all()
    middle = width // 2
    first = middle - reach + width % 2
    assert np.flatnonzero(strip[0]).tolist() == list(range(first, first + 2 * reach))


def test_the_crease_strip_follows_every_crease_and_no_outline():
    assert CREASE not in scene_patterns(reference_scene("I", (16, 16), channels=1))
    assert CREASE not in scene_patterns(room_scene(("white",) * 3, (6, 8), channels=1))
    for geometry in ROOMS[:-1]:
        scene = textured(geometry, (62, 70), channels=1)
        lit = scene_patterns(scene)[CREASE] > 0
        points = scene.points
        # the sphere hides where it touches the floor: all round it there is but its outline
        assert set(points.surface[lit.ravel()]) == set(range(len(points.planes)))
        assert 0.01 < lit.mean() < 0.06
        heights = np.stack([plane.heights(points.positions) for plane in points.planes])
        over_other_plane = np.sort(heights, axis=0)[1].reshape(lit.shape)
        assert over_other_plane[lit].max() < 2 * np.sqrt(points.mean_area)


@pytest.mark.parametrize("geometry", ROOMS)
@pytest.mark.parametrize("shape", [(16, 16), (62, 70), (40, 80)])
def test_no_room_is_too_bright_for_the_default_camera(geometry, shape):
    white = ("white",) * len(names_of(geometry))
    scene = planes_scene(geometry, white, shape)
    brightest = scene.apply(np.ones((1, *shape))).max()
    camera = CameraModel()
    full_scale = camera.full_well_electrons / camera.electrons_per_radiance / camera.exposures[0]
    coloured = min(1, scene.albedo.max() / WHITE)
    assert 0.6 * coloured * full_scale < brightest < 0.97 * full_scale
    assert scene.light <= 1


def test_light_scales_the_transport_and_is_part_of_the_description():
    points = surface_points((6, 7), GEOMETRIES["wedge"])
    full, dim = (RadiosityScene(points, np.full((6, 7, 1), 0.5), light=x) for x in (1.0, 0.25))
    assert dim.dense() == pytest.approx(0.25 * full.dense(), rel=1e-12)
    pattern = np.ones((1, 42))
    assert dim.apply(pattern) == pytest.approx(0.25 * full.apply(pattern), rel=1e-6)
    assert fingerprint(dim.describe()) != fingerprint(full.describe())
    with pytest.raises(InputError, match="light 0"):
        RadiosityScene(points, np.full((6, 7, 1), 0.5), light=0)
