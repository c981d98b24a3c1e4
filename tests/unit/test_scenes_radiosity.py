"""The transport of radiosity scenes: formulas, energy, occluders, compression, determinism."""

import json
from itertools import cycle

import numpy as np
import pytest
from figures.hard_scenes import PLATE

from rfpipe.config import SceneSettings
from rfpipe.errors import InputError
from rfpipe.photometry import CameraModel
from rfpipe.plugins import SCENES, names
from rfpipe.provenance import fingerprint
from rfpipe.scenes import (
    GEOMETRIES,
    Occluder,
    RadiosityScene,
    planes_scene,
    reference_scene,
    scene_from_config,
    surface_points,
)
from rfpipe.scenes.geometries import WHITE, surface_names
from rfpipe.scenes.radiosity import FormFactors

TILTED = Occluder((0.2, 0.1, 1.5), (0.2, 0, 0.1), (0, 0.15, 0.05))  # seen by the camera


def random_patterns(count, rays, seed=0):
    return np.random.default_rng(seed).random((count, rays)).astype(np.float32)


def textured(shape=(12, 14), geometry="wedge", **settings):
    surfaces = [kind for _, kind in zip(surface_names(geometry), cycle(("texture", "white")))]
    return planes_scene(geometry, surfaces, shape, **settings)


def normals_of(points):
    normals = np.zeros_like(points.positions)
    for index, surface in enumerate(points.surfaces):
        normals[points.surface == index] = surface.normals(
            points.positions[points.surface == index]
        )
    return normals


def cosines_of(points):
    """Return both cosines times the distance, and the clamped squared distance, of all points."""
    to, normals = points.positions[None] - points.positions[:, None], normals_of(points)
    cosine_i = np.maximum(np.einsum("ijx,ix->ij", to, normals), 0)
    cosine_j = np.maximum(-np.einsum("ijx,jx->ij", to, normals), 0)
    return cosine_i, cosine_j, np.maximum((to**2).sum(2), points.mean_area)


def test_matrix_follows_the_formulas_entry_by_entry():
    scene = textured((4, 6), channels=1)
    points, albedo = scene.points, scene.albedo.reshape(-1).astype(np.float64)
    cosine_i, cosine_j, squared = cosines_of(points)
    geometry = cosine_i * cosine_j / (np.pi * squared**2)
    reflect = np.diag(albedo)
    expected = np.diag(albedo / points.areas) + reflect @ geometry @ reflect
    expected += reflect @ geometry @ np.diag(albedo * points.areas) @ geometry @ reflect
    assert scene.dense() == pytest.approx(points.mean_area * expected, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("geometry", [name for name in GEOMETRIES if name != "plane"])
@pytest.mark.parametrize("shape", [(32, 32), (33, 35)])
def test_no_point_receives_more_light_than_is_emitted(geometry, shape):
    points = surface_points(shape, GEOMETRIES[geometry])
    received = FormFactors(points, compress=False).apply(points.areas[:, None])[:, 0]
    assert (received >= 0).all()
    assert 0.15 < received.max() <= 1


def test_an_occluder_blocks_exactly_the_occluded_pairs():
    free, plated = (textured((16, 16), channels=1, bounces=2, occluders=o) for o in ((), (PLATE,)))
    points = free.points
    on_left = points.surface == 0
    before, after = (scene.dense()[np.ix_(on_left, ~on_left)] for scene in (free, plated))
    start, stop = points.positions[on_left], points.positions[~on_left]
    fraction = start[:, None, 0] / (start[:, None, 0] - stop[None, :, 0])  # crosses x = 0
    crossing = start[:, None] + fraction[..., None] * (stop[None] - start[:, None])
    hidden = (np.abs(crossing[..., 1]) <= 0.5) & (np.abs(crossing[..., 2] - 2.6) <= 0.25)
    assert 0.1 < hidden.mean() < 0.9
    assert (after[hidden] == 0).all()
    assert np.array_equal(after[~hidden], before[~hidden])
    assert np.array_equal(plated.albedo, free.albedo)  # an occluder seen edge-on hides no pixel


def test_occluder_in_view_is_black():
    scene = textured((20, 22), occluders=(TILTED,))
    x, y, z = TILTED.centre
    is_occluder = (scene.albedo == 0).all(-1)
    assert is_occluder[int((y / z + 0.5) * 20), int(x / z * 20 + 11)]
    assert 0.01 < is_occluder.mean() < 0.2
    assert not scene.dense(0)[is_occluder.ravel()].any()


@pytest.mark.parametrize("geometry", ["sphere_on_plane", "coloured_room"])
def test_nothing_shines_through_a_block_or_a_sphere(geometry):
    points = surface_points((16, 18), GEOMETRIES[geometry])
    entries = FormFactors(points, compress=False).apply(np.eye(16 * 18))[::2]
    faces = [array for array in points.surfaces if array.name == "block"]
    inside = np.full(entries.shape, -np.inf)  # how deep a segment goes into either, scene units
    for place in np.linspace(0, 1, 300)[1:-1]:
        on_way = (1 - place) * points.positions[::2, None] + place * points.positions
        inside = np.maximum(inside, -points.surfaces[-1].heights(on_way))
        if faces:
            in_block = -np.max([face.heights(on_way) for face in faces], axis=0)
            inside = np.maximum(inside, in_block)
    cosine_i, cosine_j, squared = (array[::2] for array in cosines_of(points))
    expected = cosine_i * cosine_j / (np.pi * squared**2)
    lit = (np.minimum(cosine_i, cosine_j) > 1e-9) & (inside < -2e-2)
    shadow = (inside > 1e-6) & (expected > 0)
    assert not entries[inside > 1e-6].any()
    assert entries[lit] == pytest.approx(expected[lit], rel=1e-9)
    assert shadow.sum() > 100
    assert lit.sum() > 5000


def test_the_coloured_room_casts_its_colours():
    room = planes_scene("coloured_room", ("white",) * 7, (32, 36))
    on = np.array([surface.name for surface in room.points.surfaces])[room.points.surface]
    red, green, blue = room.apply((on == "left wall")[None])[0, on == "back wall"].mean(axis=0)
    assert red > 2 * green > 2 * blue > 0  # white, in red light


def test_a_pattern_has_the_same_bits_in_any_batch_also_compressed(monkeypatch):
    monkeypatch.setattr("rfpipe.scenes.radiosity.DENSE_LIMIT", 0)
    scene = textured((21, 23))
    patterns = random_patterns(35, 21 * 23)
    together = scene.apply(patterns)
    order = np.random.default_rng(1).permutation(35)
    assert np.array_equal(scene.apply(patterns[order]), together[order])
    assert np.array_equal(scene.apply(patterns[34:])[0], together[34])


@pytest.mark.parametrize("shape", [(168,), (2, 167), (2, 14, 12), (1, 2, 12, 14)])
def test_patterns_of_another_shape_or_not_finite_are_refused(shape):
    with pytest.raises(InputError, match=r"expected \(patterns, 168\)"):
        textured().apply(np.zeros(shape))
    for value in (np.nan, np.inf):
        with pytest.raises(InputError, match="NaN or infinity"):
            textured().apply(np.full((2, 168), value))


def test_dense_is_refused_where_it_would_not_fit():
    with pytest.raises(InputError, match=r"8281 rays .* apply"):
        textured((91, 91)).dense()


def test_albedo_out_of_range_is_refused():
    points = surface_points((4, 5), GEOMETRIES["plane"])
    with pytest.raises(InputError, match="below 1"):
        RadiosityScene(points, np.ones((4, 5, 1)))


def test_settings_build_the_same_scenes():
    kinds_without_geometry = {"room", "captured", "matrix", "mitsuba"}
    assert set(GEOMETRIES) == set(names(SCENES)) - kinds_without_geometry
    for name in GEOMETRIES:
        assert scene_from_config(SceneSettings.of(name, shape=(6, 7))).shape == (6, 7)
        count = len(surface_names(name))
        with pytest.raises(ValueError, match=rf"{name} should have {count} surfaces .*, not 0"):
            SceneSettings.of(name, surfaces=())
    given = {"shape": (12, 14), "channels": 1, "bounces": 2, "seed": 5}
    config = SceneSettings.of("wedge", surfaces=("white", "texture"), **given)
    direct = planes_scene("wedge", ("white", "texture"), **given)
    assert scene_from_config(config).describe() == direct.describe()


def test_descriptions_are_plain_and_unique():
    variants = [
        textured(),
        textured(seed=1),
        textured(bounces=2),
        textured(channels=1),
        textured((12, 15)),
        textured(occluders=(PLATE,)),
        reference_scene("II", (12, 14)),
        textured(geometry="corner"),
    ]
    prints = {fingerprint(scene.describe()) for scene in variants}
    assert len(prints) == len(variants)
    assert fingerprint(textured().describe()) in prints
    assert json.loads(json.dumps(textured(occluders=(PLATE,)).describe()))["bounces"] == 3


@pytest.mark.parametrize(
    "geometry", [name for name in GEOMETRIES if name not in ("plane", "wedge")]
)
@pytest.mark.parametrize("shape", [(16, 16), (40, 80)])
def test_no_room_is_too_bright_for_the_default_camera(geometry, shape):
    scene = planes_scene(geometry, ("white",) * len(surface_names(geometry)), shape)
    brightest = scene.apply(np.ones((1, *shape))).max()
    camera = CameraModel()
    full_scale = camera.full_well_electrons / camera.electrons_per_radiance / camera.exposures[0]
    coloured = min(1, scene.albedo.max() / WHITE)
    assert 0.6 * coloured * full_scale < brightest < 0.97 * full_scale
    assert scene.scale <= scene.points.mean_area
