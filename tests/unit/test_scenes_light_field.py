"""The room in front of an array of views: geometry, texels, and 8D transport."""

import json

import numpy as np
import pytest

from rfpipe.config import SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes import room_scene, scene_from_config
from rfpipe.scenes.light_field import (
    DISTANCE,
    TexelGrid,
    TexturedRectangle,
    panels_scene,
    room_panels,
    texel_weights,
    view_array,
)

SURFACES = ("texture", "white", "white")
SCREEN = TexturedRectangle((0, 0, 3), (3, 0, 0), (0, 3, 0), "screen", "white", (1, 1, 1))
SPAN = (37, 29)


@pytest.fixture(scope="module")
def small():
    return room_scene(SURFACES, (8, 12), views=(2, 2))


def screen(grid, shape, panel=SCREEN):
    views = view_array(grid, SPAN, shape)
    options = {"channels": 1, "bounces": 1, "seed": 0, "name": "screen"}
    return panels_scene(views, [panel], (len(views), *shape), **options)


def test_views_span_the_angles_and_look_at_the_scene():
    views = view_array((3, 5), SPAN, (4, 6))
    positions = np.array([view.position for view in views])
    towards = np.array([0, 0, DISTANCE]) - positions
    horizontal = np.degrees(np.arctan2(towards[:, 0], towards[:, 2])).reshape(3, 5)
    vertical = np.degrees(np.arctan2(towards[:, 1], towards[:, 2])).reshape(3, 5)
    assert np.ptp(horizontal, axis=1) == pytest.approx([37] * 3)
    assert np.ptp(vertical, axis=0) == pytest.approx([29] * 5)
    assert positions[7] == pytest.approx([0, 0, 0])
    assert (np.diff(positions[:5, 0]) > 0).all()  # ordered by rows
    for view, way in zip(views, towards, strict=True):
        assert view.axes[0, 1] == 0  # the horizon is level
        assert view.axes[2] @ way == pytest.approx(np.linalg.norm(way))


def test_weights_of_texels_add_up_and_so_do_footprints():
    views = view_array((3, 3), SPAN, (26, 40))
    weights, _ = texel_weights(views, TexelGrid(room_panels(SURFACES), DISTANCE * views[0].pitch))
    assert weights.shape[0] == 9 * 26 * 40
    assert weights.sum(axis=1) == pytest.approx(np.ones(weights.shape[0]))
    assert weights.data.min() > 0
    (pinhole,) = view_array((1, 1), (0, 0), (20, 30))
    _, footprint = texel_weights([pinhole], TexelGrid([SCREEN], 0.1))
    wide = 30 * pinhole.pitch * DISTANCE
    assert footprint.sum() == pytest.approx(wide * wide * 20 / 30, rel=1e-9)


def test_a_uniformly_lit_screen_has_no_ripples():
    light = np.zeros((1, 9, 26, 40))
    light[:, 0] = 1  # the light of one view in another, where they overlap
    weights = screen((3, 3), (26, 40)).apply(light).reshape(9, 26, 40)[4, 8:-8, 12:-12]
    second = (
        np.diff(weights, n=2, axis=0) / weights[1:-1],
        np.diff(weights, n=2, axis=1) / weights[:, 1:-1],
    )
    assert max(np.abs(part).max() for part in second) < 0.02


@pytest.mark.parametrize("shape", [(8, 12), (26, 40)])
def test_energy_is_conserved_and_within_the_default_camera_range(shape):
    scene = room_scene(SURFACES, shape, views=(3, 3))
    points, _ = scene._patches
    # fraction of the light of a point that arrives at other points
    arrives = scene.form_factors.apply(points.areas[:, None])
    assert 0 <= arrives.min() < 0.5 < arrives.max() < 1
    picture = scene.apply(np.ones((1, *scene.shape)))
    assert 0.5 < picture.mean() < 1
    assert picture.max() < 1.9  # the default camera fills its well at 2


def test_occluded_parts_of_views_receive_only_indirect_light():
    direct, all_light = (
        room_scene(SURFACES, (26, 40), views=(3, 3), bounces=bounces, channels=1)
        for bounces in (1, 3)
    )
    lights = np.zeros((9, *direct.shape), dtype=np.float32)
    lights[range(9), range(9)] = 1
    pictures = direct.apply(lights).reshape(9, 9, 26, 40)  # light, view
    assert (
        pictures[range(9), range(9)] > 0
    ).all()  # a projector lights everything that its camera sees
    shadow = pictures == 0
    # shadows of objects, not only areas outside of the other view
    assert all(shadow[light, 4, 8:18, 12:28].any() for light in (0, 2, 6, 8))
    assert not np.array_equal(shadow[0, 4], shadow[8, 4])  # they move with the light
    assert (all_light.apply(lights[:1]).reshape(9, 26, 40)[shadow[0]] > 0).mean() > 0.9


@pytest.mark.parametrize(("views", "shape"), [(None, (9, 14)), ((1, 1), (5, 8)), ((2, 3), (4, 6))])
@pytest.mark.parametrize("span", [(0.0, 0.0), (45.0, 45.0)])
def test_every_array_sees_only_fronts(views, shape, span):
    scene = room_scene(SURFACES, shape, views=views, span_degrees=span)
    rays = shape if views is None else (views[0] * views[1], *shape)
    assert scene.shape == rays
    assert scene.albedo.shape == (*rays, 3)
    assert ((scene.albedo > 0) & (scene.albedo < 1)).all()
    assert np.isfinite(scene.apply(np.ones((1, *rays)))).all()


def test_a_ray_without_a_hit_is_named():
    narrow = TexturedRectangle((0, 0, 3), (0.1, 0, 0), (0, 0.1, 0), "narrow", "white", (1, 1, 1))
    with pytest.raises(InputError, match=r"pixel \(0, 0\) of view 0 sees no panel"):
        screen((2, 2), (4, 6), narrow)
    backward = TexturedRectangle((0, 0, 3), (-3, 0, 0), (0, 3, 0), "backward", "white", (1, 1, 1))
    with pytest.raises(InputError, match="no panel, or the back of one"):
        screen((1, 1), (4, 6), backward)


def test_settings_build_the_same_scene_and_descriptions_are_unique(small):
    given = {"shape": (5, 8), "views": (2, 3), "span_degrees": (20, 10), "channels": 1, "seed": 3}
    config = SceneSettings.of("room", surfaces=SURFACES, **given)
    made = scene_from_config(config)
    assert config.ray_shape == made.shape == (6, 5, 8)
    assert made.describe() == room_scene(SURFACES, **given).describe()
    usual = {"surfaces": SURFACES, "shape": (8, 12), "views": (2, 2)}
    changes = [{"seed": 1}, {"bounces": 1}, {"channels": 1}, {"span_degrees": (37, 28)},
               {"views": (1, 4)}, {"surfaces": ("white",) * 3}]  # fmt: skip
    scenes = [small, *(room_scene(**(usual | change)) for change in changes)]
    described = {json.dumps(scene.describe(), sort_keys=True) for scene in scenes}
    assert len(described) == 7
    assert json.dumps(room_scene(**usual).describe(), sort_keys=True) in described
