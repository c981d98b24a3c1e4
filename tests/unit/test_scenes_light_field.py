"""The room and the array of views that looks at it: geometry, texels, and its 8D transport."""

import json

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator

from rfpipe.config import SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes import LightFieldScene, room_scene, scene_from_config
from rfpipe.scenes.panels import Panel, TexelGrid
from rfpipe.scenes.room import room_panels
from rfpipe.scenes.views import DISTANCE, ViewArray, sightings
from rfpipe.testing import dot_test

SURFACES = ("texture", "white", "white")
SCREEN = Panel("screen", (0, 0, 3), (3, 0, 0), (0, 3, 0), "white", (1, 1, 1))


@pytest.fixture(scope="module")
def small() -> LightFieldScene:
    return room_scene(SURFACES, (8, 12), views=(2, 2))


def random_patterns(count, scene, seed=0):
    return np.random.default_rng(seed).random((count, *scene.shape)).astype(np.float32)


def test_views_span_the_angles_and_look_at_the_scene():
    views = ViewArray((3, 5), (37, 29), (4, 6))
    positions = np.array([view.position for view in views.pinholes()])
    towards = np.array([0, 0, DISTANCE]) - positions
    horizontal = np.degrees(np.arctan2(towards[:, 0], towards[:, 2])).reshape(3, 5)
    vertical = np.degrees(np.arctan2(towards[:, 1], towards[:, 2])).reshape(3, 5)
    assert np.ptp(horizontal, axis=1) == pytest.approx([37] * 3)
    assert np.ptp(vertical, axis=0) == pytest.approx([29] * 5)
    assert positions[7] == pytest.approx([0, 0, 0])
    assert (positions[:, 2] == 0).all()
    assert (np.diff(positions[:5, 0]) > 0).all()  # left to right, then down
    assert len(positions) == views.count
    for view, pinhole in enumerate(views.pinholes()):
        axes = pinhole.axes
        assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1)
        assert axes[0, 1] == 0  # the horizon is level
        assert axes[2] @ towards[view] == pytest.approx(np.linalg.norm(towards[view]))


def test_texels_are_rows_of_the_panel_as_seen_from_its_front():
    assert SCREEN.plane.heights(np.zeros(3)) == pytest.approx(3)
    grid = TexelGrid([SCREEN, SCREEN], 2.0)
    assert grid.shapes.tolist() == [[3, 3], [3, 3]]
    points = grid.points(np.array([0, 1, 3, 13]))
    assert points.surface.tolist() == [0, 0, 0, 1]
    assert points.positions.tolist() == [[-2, -2, 3], [0, -2, 3], [-2, 0, 3], [0, 0, 3]]
    assert points.areas.tolist() == [4] * 4


def test_boxes_are_shared_out_between_the_texels_they_overlap():
    grid = TexelGrid([SCREEN], 1.0)  # 6 x 6 texels, each a third wide on the scale of -1 to 1
    place = np.array([[-1 / 6, 0.5], [0, 0], [-1, 1], [0, 0]])
    width = np.array([[1 / 6, 1 / 6], [1 / 6, 1 / 6], [1 / 6, 1 / 6], [5, 0]])
    texel, share = grid.overlaps(np.zeros(4, dtype=np.int64), place, width)
    assert share.sum(axis=1) == pytest.approx(np.ones(4))
    rows = [
        np.bincount(t, s, minlength=36).reshape(6, 6) for t, s in zip(texel, share, strict=True)
    ]
    assert rows[0][4, 2] == pytest.approx(1)  # within one texel
    assert rows[1][2:4, 2:4] == pytest.approx(np.full((2, 2), 0.25))  # on a corner of four
    assert rows[2][5, 0] == pytest.approx(1)  # beyond the panel's edge
    assert rows[3].sum(axis=0)[2:4] == pytest.approx([0.5, 0.5])  # a box counts as one texel broad


def test_pixels_see_texels_in_whole_and_panels_look_smooth():
    views = ViewArray((3, 3), (37, 29), (26, 40))
    seen = sightings(views, TexelGrid(room_panels(SURFACES), DISTANCE * views.pitch), 3)
    assert seen.texels.shape[0] == 9 * 26 * 40
    assert seen.texels.sum(axis=1) == pytest.approx(np.ones(seen.texels.shape[0]))
    assert seen.texels.data.min() > 0
    # head-on at its distance, a screen's pixels and texels are one
    one = ViewArray(None, (37, 29), (10, 20))
    straight = sightings(one, TexelGrid([SCREEN], DISTANCE * one.pitch), 3)
    assert straight.footprint == pytest.approx((DISTANCE * one.pitch) ** 2, rel=0.25)


def test_footprints_add_up_to_what_a_view_sees_of_a_screen():
    views = ViewArray(None, (0, 0), (20, 30))
    seen = sightings(views, TexelGrid([SCREEN], 0.1), 3)
    wide = 30 * views.pitch * DISTANCE
    assert seen.footprint.sum() == pytest.approx(wide * wide * 20 / 30, rel=1e-9)


def test_a_uniformly_lit_screen_has_no_ripples():
    views = ViewArray((3, 3), (37, 29), (26, 40))
    scene = LightFieldScene(views, [SCREEN], channels=1, bounces=1)
    light = np.zeros((1, 9, 26, 40))
    light[:, 0] = 1  # one view's light, seen by another where both look
    seen = scene.apply(light).reshape(9, 26, 40)[4, 8:-8, 12:-12]
    second = np.diff(seen, n=2, axis=0) / seen[1:-1], np.diff(seen, n=2, axis=1) / seen[:, 1:-1]
    assert max(np.abs(part).max() for part in second) < 0.02


@pytest.mark.parametrize("channels", [1, 3])
def test_the_matrix_is_symmetric_and_applied_faithfully(channels):
    scene = room_scene(SURFACES, (8, 12), views=(2, 2), channels=channels)
    patterns = random_patterns(3, scene)
    radiance = scene.apply(patterns)
    assert radiance.shape == (3, 4 * 8 * 12, channels)
    assert radiance.dtype == np.float32
    for channel in range(channels):
        matrix = scene.dense(channel)
        assert np.array_equal(matrix, matrix.T)
        assert (matrix >= 0).all()
        expected = patterns.reshape(3, -1) @ matrix
        assert radiance[..., channel] == pytest.approx(expected, rel=1e-6)


def test_compressed_scenes_are_their_own_transpose():
    scene = room_scene(SURFACES, (26, 40), views=(3, 3), channels=1, compress=True)
    rays = 9 * 26 * 40

    def lit(pattern):
        return scene.apply(pattern.reshape(1, rays)).ravel()

    dot_test(LinearOperator((rays, rays), matvec=lit, rmatvec=lit, dtype=np.float32))


@pytest.mark.parametrize("shape", [(8, 12), (26, 40)])
def test_no_light_is_made(shape):
    surfaces = room_scene(SURFACES, shape, views=(2, 2))._surfaces
    # what of the light that leaves a point arrives elsewhere
    arrives = surfaces.form_factors.apply(surfaces.points.areas[:, None])
    assert 0 <= arrives.min() < 0.5 < arrives.max() < 1
    assert surfaces.albedo.max() < 0.95


def test_bounces_add_light(small):
    matrices = [
        room_scene(SURFACES, (8, 12), views=(2, 2), bounces=bounces).dense(1)
        for bounces in (1, 2, 3)
    ]
    assert (matrices[1] >= matrices[0]).all()
    assert (matrices[2] >= matrices[1]).all()
    floodlit = [matrix.sum() for matrix in matrices]
    assert 1.02 < floodlit[1] / floodlit[0] < floodlit[2] / floodlit[0] < 1.5
    assert np.array_equal(matrices[2], small.dense(1))


def test_compressed_form_factors_make_the_same_light():
    shape = (20, 30)
    plain, packed = (
        room_scene(SURFACES, shape, views=(2, 2), compress=compress) for compress in (False, True)
    )
    patterns = random_patterns(2, plain)
    assert packed.apply(patterns) == pytest.approx(plain.apply(patterns), rel=1e-5)


def test_views_differ_and_hide_parts_from_each_other():
    scene = room_scene(SURFACES, (26, 40), views=(3, 3), bounces=1, channels=1)
    lights = np.zeros((9, *scene.shape), dtype=np.float32)
    lights[range(9), range(9)] = 1
    pictures = scene.apply(lights).reshape(9, 9, 26, 40)  # light, view
    assert all(
        np.abs(scene.albedo[view] - scene.albedo[other]).mean() > 0.01
        for view in range(9)
        for other in range(view)
    )
    own = pictures[range(9), range(9)]
    assert (own > 0).all()  # a projector lights whatever its camera sees
    shadow = pictures == 0
    # shadows of the things in the room, not only places that the other view doesn't look at
    within = np.s_[8:18, 12:28]
    assert all(shadow[light, 4][within].any() for light in (0, 2, 6, 8))
    assert not shadow[4, 4].any()
    assert not np.array_equal(shadow[0, 4], shadow[8, 4])  # they move with the light


def test_indirect_light_reaches_the_shadows():
    direct, all_light = (
        room_scene(SURFACES, (26, 40), views=(3, 3), bounces=bounces, channels=1)
        for bounces in (1, 3)
    )
    light = np.zeros((1, *direct.shape), dtype=np.float32)
    light[:, 0] = 1
    before, after = (scene.apply(light)[0, :, 0] for scene in (direct, all_light))
    dark = before == 0
    assert dark.any()
    assert (after[dark] > 0).mean() > 0.9


def test_a_pattern_gives_the_same_bits_in_any_company(small):
    patterns = random_patterns(19, small)
    together = small.apply(patterns)
    order = np.random.default_rng(1).permutation(19)
    assert np.array_equal(small.apply(patterns[order]), together[order])
    for index in (0, 7, 18):
        assert np.array_equal(small.apply(patterns[index : index + 1])[0], together[index])


def test_floodlight_stays_within_the_cameras_range_at_every_size():
    for shape in ((8, 12), (26, 40)):
        scene = room_scene(SURFACES, shape, views=(3, 3))
        picture = scene.apply(np.ones((1, *scene.shape)))
        assert 0.5 < picture.mean() < 1
        assert picture.max() < 1.9  # the default camera fills its well at 2


@pytest.mark.parametrize(("views", "shape"), [(None, (9, 14)), ((1, 1), (5, 8)), ((2, 3), (4, 6))])
@pytest.mark.parametrize("span", [(0.0, 0.0), (45.0, 45.0)])
def test_every_array_sees_fronts_alone(views, shape, span):
    scene = room_scene(SURFACES, shape, views=views, span_degrees=span)
    rays = shape if views is None else (views[0] * views[1], *shape)
    assert scene.shape == rays
    assert scene.albedo.shape == (*rays, 3)
    assert (scene.albedo > 0).all()
    assert (scene.albedo < 1).all()
    assert np.isfinite(scene.apply(np.ones((1, *rays)))).all()


def test_a_ray_that_sees_nothing_is_named():
    narrow = Panel("narrow", (0, 0, 3), (0.1, 0, 0), (0, 0.1, 0), "white", (1, 1, 1))
    with pytest.raises(InputError, match=r"pixel \(0, 0\) of view 0 sees nothing"):
        LightFieldScene(ViewArray((2, 2), (37, 29), (4, 6)), [narrow])
    backward = Panel("backward", (0, 0, 3), (-3, 0, 0), (0, 3, 0), "white", (1, 1, 1))
    with pytest.raises(InputError, match="the back of a panel"):
        LightFieldScene(ViewArray(None, (37, 29), (4, 6)), [backward])


def test_config_describes_the_same_scene():
    config = SceneSettings.of(
        "room", surfaces=SURFACES, shape=(5, 8), views=(2, 3), span_degrees=(20, 10),
        channels=1, bounces=2, seed=3,
    )  # fmt: skip
    made = scene_from_config(config)
    direct = room_scene(
        SURFACES, (5, 8), views=(2, 3), span_degrees=(20, 10), channels=1, bounces=2, seed=3
    )
    assert config.ray_shape == made.shape == (6, 5, 8)
    assert made.describe() == direct.describe()


def test_descriptions_are_plain_and_tell_scenes_apart(small):
    variants = [
        small,
        room_scene(SURFACES, (8, 12), views=(2, 2), seed=1),
        room_scene(SURFACES, (8, 12), views=(2, 2), bounces=1),
        room_scene(SURFACES, (8, 12), views=(2, 2), channels=1),
        room_scene(SURFACES, (8, 12), views=(2, 2), span_degrees=(37, 28)),
        room_scene(SURFACES, (8, 12), views=(1, 4)),
        room_scene(("white", "white", "white"), (8, 12), views=(2, 2)),
    ]
    described = [json.dumps(scene.describe(), sort_keys=True) for scene in variants]
    assert len(set(described)) == len(variants)
    again = room_scene(SURFACES, (8, 12), views=(2, 2))
    assert json.dumps(again.describe(), sort_keys=True) == described[0]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"surfaces": ("white",)}, "expected 3"),
        ({"surfaces": ("white", "white", "mirror")}, "'white' or 'texture'"),
        ({"channels": 2}, "channels 2"),
        ({"bounces": 0}, "bounces 0"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        room_scene(**({"surfaces": SURFACES, "shape": (4, 6)} | settings))


def test_dense_is_refused_where_it_would_not_fit(small):
    with pytest.raises(InputError, match=r"9360 rays .* apply"):
        room_scene(SURFACES, (26, 40), views=(3, 3)).dense()
    with pytest.raises(InputError, match="channel 3"):
        small.dense(3)
