"""The predefined physically based scenes: reproducible plain data with visible surfaces."""

import numpy as np
import pytest

from rfpipe.mitsuba.parts import lathe, matt
from rfpipe.mitsuba.world import load_scene
from rfpipe.mitsuba.worlds import WORLDS

SHARE_SEEN = 0.4  # least fraction of a view's pixels that see a surface


def kinds_in(value: object) -> set[type]:
    if isinstance(value, dict):
        assert all(isinstance(key, str) for key in value)
        return set().union(*(kinds_in(item) for item in value.values()))
    if isinstance(value, list):
        return set().union(*(kinds_in(item) for item in value))
    return {type(value)}


def test_worlds_are_reproducible_plain_data() -> None:
    for world in WORLDS.values():
        assert kinds_in(world.build()) <= {str, float, int, bool, np.ndarray}
        assert world.describe() == world.describe()
    digests = {name: world.describe()["digest"] for name, world in WORLDS.items()}
    assert digests.pop("two_blocks_aside") == digests["two_blocks"]
    assert len(set(digests.values())) == len(digests) == 14


@pytest.mark.needs("llvm")
@pytest.mark.parametrize("name", WORLDS)
def test_each_view_of_a_world_sees_something(name: str) -> None:
    from rfpipe.mitsuba.rendering import hits

    scene = load_scene(WORLDS[name])
    for side in (WORLDS[name].cameras, WORLDS[name].projectors or ()):
        for view in side[::9]:
            distances, _ = hits(scene, view.pinhole((8, 8)))
            met = distances[np.isfinite(distances)]
            assert len(met) >= SHARE_SEEN * 64
            assert met.min() > 0.3


def test_a_surface_of_revolution_is_closed_with_outward_normals() -> None:
    can = lathe((1, 2, 3), [(0, 0), (0.5, 0), (0.5, 2), (0, 2)], matt(0.5))
    corners = can["vertices"][can["faces"]].astype(np.float64)
    volume = np.linalg.det(corners - [1, 2, 3]).sum() / 6
    assert volume == pytest.approx(np.pi * 0.5**2 * 2, rel=2e-3)
