"""Our own physically based scenes: plain data, the same each time, and seen by their views."""

import numpy as np
import pytest

from rfpipe_mitsuba.views import Views
from rfpipe_mitsuba.world import load_scene
from rfpipe_mitsuba.worlds import WORLDS, boxes, clear, shiny, still_lifes
from rfpipe_mitsuba.worlds.parts import matt, turned
from rfpipe_mitsuba.worlds.textures import blots, lettering

SHARE_SEEN = 0.4  # of a view's pixels that meet a surface, at least


def kinds_in(value: object) -> set[type]:
    if isinstance(value, dict):
        assert all(isinstance(key, str) for key in value)
        return set().union(*(kinds_in(each) for each in value.values()))
    if isinstance(value, list):
        return set().union(*(kinds_in(each) for each in value))
    return {type(value)}


def test_each_has_a_name_of_its_own_and_says_what_it_tests() -> None:
    worlds = (*boxes.BOXES, *shiny.SHINY, *clear.CLEAR, *still_lifes.STILL_LIFES)
    assert len(WORLDS) == len(worlds) >= 12
    assert len({world.tests for world in worlds}) == len(worlds)


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_is_plain_data_and_the_same_each_time(name: str) -> None:
    world = WORLDS[name]
    assert kinds_in(world.build()) <= {str, float, int, bool, np.ndarray}
    assert world.describe() == world.describe()
    others = [other.describe()["digest"] for other in WORLDS.values() if other.build != world.build]
    assert world.describe()["digest"] not in others


@pytest.mark.needs("llvm")
@pytest.mark.parametrize("name", WORLDS)
def test_each_view_of_a_world_sees_something(name: str) -> None:
    import mitsuba as mi

    world = WORLDS[name]
    scene = load_scene(world)
    from rfpipe_mitsuba.pinholes import Pinholes

    for side in (world.cameras, world.projectors or ()):
        for view in side[::9]:
            pixels = mi.UInt32(np.arange(64))
            hit = scene.ray_intersect(
                Pinholes(Views((view,), (8, 8))).rays(pixels, mi.Point2f(0.5))
            )
            distances = hit.t.numpy()[hit.is_valid().numpy()]
            assert len(distances) >= SHARE_SEEN * 64
            assert distances.min() > 0.3


def test_the_pairs_and_arrays_of_views() -> None:
    assert len(WORLDS["sweets"].cameras) == 2
    assert len(WORLDS["still_life_arc"].cameras) == 80
    assert len(WORLDS["views_3x3"].cameras) == 9
    one, other = (np.array(view.origin) - view.target for view in WORLDS["sweets"].cameras)
    flat = [each[[0, 2]] / np.linalg.norm(each[[0, 2]]) for each in (one, other)]
    assert np.dot(*flat) == pytest.approx(np.cos(np.radians(120)))
    [camera], [projector] = WORLDS["right_angles"].cameras, WORLDS["right_angles"].projectors
    assert abs(np.dot(camera.axes[2], projector.axes[2])) < np.cos(np.radians(75))


def test_letters_stand_upright() -> None:
    dots = lettering(["L"], ink=(0, 0, 0), paper=(1, 1, 1), fine=1)[..., 0]
    assert dots.shape == (11, 9)
    inked = dots == 0
    assert inked[2:9, 2].all()  # the stem
    assert inked[8, 2:7].all()  # the foot
    assert inked.sum() == 11


def test_letters_that_the_font_lacks() -> None:
    with pytest.raises(KeyError):
        lettering(["é"])


def test_blots_by_their_seed() -> None:
    colours = [(0.5, 0.5, 0.5), (0.1, 0.2, 0.3)]
    one, again, other = (blots(32, seed, colours) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()


def test_a_turned_body_is_closed_and_its_outside_away_from_the_axis() -> None:
    can = turned((1, 2, 3), [(0, 0), (0.5, 0), (0.5, 2), (0, 2)], matt(0.5))
    corners = can["vertices"][can["faces"]].astype(np.float64)
    volume = np.linalg.det(corners - [1, 2, 3]).sum() / 6
    assert volume == pytest.approx(np.pi * 0.5**2 * 2, rel=2e-3)
