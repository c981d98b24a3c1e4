"""Separate camera and projector: direct light, shadows, reciprocity, and the coaxial case."""

from itertools import cycle

import numpy as np
import pytest

from rfpipe.config import SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes import (
    GEOMETRIES,
    Occluder,
    Pinhole,
    planes_scene,
    scene_from_config,
    surface_points,
)
from rfpipe.scenes.geometries import surface_names
from rfpipe.scenes.noncoaxial import noncoaxial_scene
from rfpipe.scenes.pinholes import first_hits
from rfpipe.testing import SceneContract

PLATE = Occluder((0.3, 0, 2.2), (0.2, 0, 0.1), (0, 0.3, 0))
PLACES = {
    "plane": (1.72, 0, 0.54),
    "wedge_120": (1.72, 0, 0.54),
    "corner": (0.5, -0.3, 0.4),
    "sphere_on_plane": (1.2, -0.5, 0.3),
    "coloured_room": (0.7, -0.4, 0.8),
}
MIDDLE = (0.0, 0.0, 3.0)


def waves(positions, surface):
    """Return a smooth albedo that differs between surfaces."""
    x, y, z = positions.T
    return (0.5 + 0.3 * np.sin(9 * x + 5 * y) * np.cos(7 * z) + 0.01 * surface)[:, None]


def grey(positions, surface):
    return np.full((len(positions), 1), 0.5)


def lamp_at(geometry, shape):
    return Pinhole(shape, PLACES[geometry], MIDDLE)


def aside(geometry, camera=(15, 18), projector=(12, 14), albedo=waves, **settings):
    lamp = lamp_at(geometry, projector)
    return noncoaxial_scene(GEOMETRIES[geometry], Pinhole(camera), lamp, albedo, **settings)


class TestAside(SceneContract):
    coaxial = False

    def make_scene(self):
        lamp = lamp_at("wedge_120", (5, 9))
        given = {"projector": lamp, "occluders": [PLATE]}
        return planes_scene("wedge_120", ("texture", "white"), (7, 8), **given)


@pytest.mark.parametrize("bounces", [1, 3])
@pytest.mark.parametrize("occluders", [(), (PLATE,)])
@pytest.mark.parametrize("geometry", PLACES)
def test_swapping_camera_and_projector_gives_the_transpose(geometry, occluders, bounces):
    settings = {"occluders": occluders, "bounces": bounces}
    scene_1 = aside(geometry, **settings)
    swapped = lamp_at(geometry, (12, 14)), Pinhole((15, 18))
    scene_2 = noncoaxial_scene(GEOMETRIES[geometry], *swapped, waves, **settings)
    matrix, exchanged = scene_1.dense() / scene_1.scale, scene_2.dense() / scene_2.scale
    assert matrix.shape == (270, 168)
    assert matrix.min() >= 0
    np.testing.assert_allclose(matrix, exchanged.T, atol=1e-12 * matrix.max())


@pytest.mark.parametrize("geometry", PLACES)
def test_a_projector_at_the_camera_gives_the_coaxial_matrix(geometry):
    shape = (13, 17)
    surfaces = [kind for _, kind in zip(surface_names(geometry), cycle(("texture", "white")))]
    coaxial = planes_scene(geometry, surfaces, shape)
    same = planes_scene(geometry, surfaces, shape, projector=Pinhole(shape))
    np.testing.assert_array_equal(same.albedo, coaxial.albedo)
    # pixels on an edge see parts of two surfaces, of which the coaxial one takes the middle's
    parts = first_hits(Pinhole(shape), GEOMETRIES[geometry], 4).surface.reshape(-1, 16)
    is_uniform = (parts == parts[:, :1]).all(axis=1)
    assert is_uniform.mean() > 0.6
    actual = same.dense(1) / same.scale
    expected = coaxial.dense(1) / coaxial.scale
    edges = np.diag(np.where(is_uniform, 1, 0)) + 1 - np.eye(len(is_uniform))
    np.testing.assert_allclose(actual * edges, expected * edges, atol=1e-12 * expected.max())
    assert np.linalg.norm(actual - expected) < 0.1 * np.linalg.norm(expected)


@pytest.mark.parametrize("geometry", ["plane", "wedge_120"])
def test_direct_light_follows_the_inverse_square_law(geometry):
    scene = aside(geometry, (31, 36), (24, 28), grey, bounces=1)
    lit = scene.apply(np.ones((1, 24 * 28)))[0, :, 0] / scene.scale
    hits, lamp = first_hits(Pinhole((31, 36)), GEOMETRIES[geometry]), lamp_at(geometry, (24, 28))
    way = hits.positions - lamp.origin
    distance, ahead = np.linalg.norm(way, axis=1), way @ lamp.axes[2]
    cosine = -(way * hits.normals).sum(1) / distance
    # a pixel's solid angle is pitch^2 (ahead / distance)^3
    expected = 0.5 * cosine / distance**2 * (distance / ahead) ** 3 / lamp.pitch**2
    place = lamp.project(hits.positions)
    inside = ((place > 1) & (place < np.array([24, 28]) - 1)).all(axis=1)
    assert inside.mean() > 0.6
    ratio = lit[inside] / expected[inside]
    assert abs(ratio.mean() - 1) < 0.003
    assert np.abs(ratio - 1).max() < 0.06
    assert not lit[((place < -1) | (place > np.array([25, 29]))).any(axis=1)].any()
    # the energy of all visible light is accounted for
    areas = surface_points((31, 36), GEOMETRIES[geometry]).areas
    light = (scene.dense() * areas[:, None]).sum(axis=0) / (0.5 * scene.scale)
    np.testing.assert_allclose(light.reshape(24, 28)[8:16, 8:20], 1, atol=5e-3)
    assert light.max() < 1.1


def test_an_occluder_casts_the_geometric_shadow():
    wall = GEOMETRIES["plane"]
    plate = Occluder((1.25, 0, 1.6), (0.15, 0, 0), (0, 0.15, 0))  # outside the camera's view
    lamp = Pinhole((24, 28), PLACES["plane"], MIDDLE)
    camera = Pinhole((31, 36))
    free, shaded = (
        noncoaxial_scene(wall, camera, lamp, grey, bounces=1, occluders=occluders)
        for occluders in ((), (plate,))
    )
    ones = np.ones((1, 24 * 28))
    share = (shaded.apply(ones) / np.maximum(free.apply(ones), 1e-9))[0, :, 0].reshape(31, 36)
    # the plate's corners, from the lamp onto the wall at z = 3
    corners = np.array([(1.25 + u, v, 1.6) for u in (-0.15, 0.15) for v in (-0.15, 0.15)])
    away = (3 - lamp.origin[2]) / (corners[:, 2] - lamp.origin[2])
    shadow = camera.project(lamp.origin + away[:, None] * (corners - lamp.origin))
    (first_row, first_column), (last_row, last_column) = shadow.min(axis=0), shadow.max(axis=0)
    rows, columns = np.arange(31)[:, None], np.arange(36)
    inner = (
        (rows > first_row)
        & (rows + 1 < last_row)
        & (columns > first_column)
        & (columns + 1 < last_column)
    )
    outer = (
        (rows + 1 < first_row)
        | (rows > last_row)
        | (columns + 1 < first_column)
        | (columns > last_column)
    )
    lit = free.apply(ones)[0, :, 0].reshape(31, 36) > 0
    assert np.count_nonzero(inner) > 4
    assert share[inner].max() < 0.05
    assert share[outer & lit].min() > 0.95


def test_settings_place_the_projector():
    settings = SceneSettings.of(
        "wedge_120", surfaces=("texture", "white"), shape=(9, 12), channels=1,
        projector={"position": PLACES["wedge_120"], "shape": (8, 10)},
    )  # fmt: skip
    assert (settings.ray_shape, settings.camera_ray_shape) == ((8, 10), (9, 12))
    assert not settings.is_coaxial
    made = scene_from_config(settings)
    assert (made.projector_shape, made.camera_shape) == ((8, 10), (9, 12))
    lamp = lamp_at("wedge_120", (8, 10))
    direct = planes_scene("wedge_120", ("texture", "white"), (9, 12), projector=lamp, channels=1)
    assert made.describe() == direct.describe()


def test_projectors_behind_surfaces_are_refused():
    centre = GEOMETRIES["sphere_on_plane"][2].centre
    face = GEOMETRIES["coloured_room"][5]
    within = tuple(np.array(face.centre) - 0.1 * face.plane.unit_normal)
    for geometry, place, name in (
        ("wedge", (3, 0, 3), "right"),
        ("sphere_on_plane", centre, "sphere"),
        ("coloured_room", within, "block"),
    ):
        white = ("white",) * len(surface_names(geometry))
        with pytest.raises(InputError, match=f"is behind the surface {name}"):
            planes_scene(geometry, white, (4, 5), projector=Pinhole((4, 5), place, (9, 0, 9)))
    with pytest.raises(ValueError, match="another point to look at"):
        SceneSettings.of("plane", projector={"position": (0, 1, 3)})
