"""The contract of scenes: rfpipe's own keep it, and it finds what is wrong with others."""

import itertools

import numpy as np
import pytest

from rfpipe.config import SceneSettings
from rfpipe.scenes import CoaxialScene, apply_in_batches, scene_from_config
from rfpipe.testing import SceneContract


def of_kind(kind, **options):
    return scene_from_config(SceneSettings.of(kind, **options))


class TestWedge(SceneContract):
    def make_scene(self):
        return of_kind("wedge", surfaces=("texture", "white"), shape=(6, 7))


class TestSphere(SceneContract):
    def make_scene(self):
        surfaces = ("texture", "white", "white")
        return of_kind("sphere_on_plane", surfaces=surfaces, shape=(7, 8), channels=1)


class TestRoom(SceneContract):
    def make_scene(self):
        return of_kind("room", surfaces=("texture",) * 3, shape=(4, 5), views=(1, 2))


class Dim(CoaxialScene):
    """Half of everything; what is wrong with it stands in the classes below."""

    def __init__(self):
        super().__init__((4, 5), 1)

    def apply(self, patterns):
        return apply_in_batches(self.radiance, patterns, self.shape, 1)

    def radiance(self, weights):
        return 0.5 * weights[..., None]

    def describe(self):
        return {"scene": "dim"}


class Negative(Dim):
    def radiance(self, weights):
        return -weights[..., None]


class Black(Dim):
    def radiance(self, weights):
        return 0 * weights[..., None]


class Curved(Dim):
    def radiance(self, weights):
        return weights[..., None] ** 1.1


class Leaking(Dim):
    def radiance(self, weights):
        return weights[..., None] + 1e-3


class Shifted(Dim):
    def radiance(self, weights):
        return np.roll(weights, 1, axis=0)[..., None]


class Together(Dim):
    def apply(self, patterns):
        return super().apply(patterns) * np.float32(1 + 1e-7 * len(patterns))


class Changing(Dim):
    numbers = itertools.count()

    def describe(self):
        return {"number": next(self.numbers)}


class Used(Dim):
    used = 0

    def radiance(self, weights):
        self.used += 1
        return super().radiance(weights)

    def describe(self):
        return {"used": self.used}


class Bright(Dim):
    def radiance(self, weights):
        return 6 * super().radiance(weights)


class Narrow(Dim):
    def radiance(self, weights):
        return super().radiance(weights) * (np.arange(20) % 5 < 4)[:, None, None]


@pytest.mark.parametrize(
    ("scene", "test", "message"),
    [
        (Negative, "light", "negative"),
        (Black, "light", "no light"),
        (Curved, "linearity", "picture of a sum"),
        (Leaking, "linearity", "light in darkness"),
        (Shifted, "dense", "T from its transpose"),
        (Together, "same_bytes_beside_any_patterns", "by themselves"),
        (Changing, "description", "made again"),
        (Used, "description", "after use"),
        (Bright, "light", "default camera"),
        (Narrow, "dense", "lights nothing"),
    ],
)
def test_what_is_wrong_is_found(scene, test, message):
    class Suite(SceneContract):
        def make_scene(self):
            return scene()

    with pytest.raises(AssertionError, match=message):
        getattr(Suite(), f"test_{test}")()
