"""The contract of scenes: all scenes of rfpipe fulfil it, and it detects violations."""

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


class Own(CoaxialScene):
    """A scene defined by a function of the weights, which counts its uses and instances."""

    made = itertools.count()

    def __init__(self, light, described=()):
        super().__init__((4, 5), 1)
        self.light, self.described = light, described
        self.facts = {"used": 0, "made": next(self.made)}

    def apply(self, patterns):
        self.facts["used"] += 1
        together = np.float32(1 + 1e-7 * len(patterns) * (self.described == "together"))
        return apply_in_batches(self.radiance, patterns, self.shape, 1) * together

    def radiance(self, weights):
        return self.light(weights)[..., None]

    def describe(self):
        return {name: it for name, it in self.facts.items() if name in self.described}


def dim(weights):
    return 0.5 * weights


@pytest.mark.parametrize(
    ("scene", "test", "message"),
    [
        ((lambda weights: -weights,), "light", "negative"),
        ((lambda weights: 0 * weights,), "light", "no light"),
        ((lambda weights: 3 * weights,), "light", "default camera"),
        ((lambda weights: weights**1.1,), "linearity", "image of a sum"),
        ((lambda weights: weights + 1e-3,), "linearity", "black pattern gives light"),
        ((lambda weights: np.roll(weights, 1, axis=0),), "dense", "the transposed matrix"),
        ((lambda weights: weights * (np.arange(20) % 5 < 4)[:, None],), "dense", "nothing"),
        ((dim, "together"), "same_bytes_in_any_batch", "another batch"),
        ((dim, ["made"]), "description", "equal objects"),
        ((dim, ["used"]), "description", "after use"),
    ],
)
def test_violations_of_the_contract_are_detected(scene, test, message):
    def run(*settings):
        suite = SceneContract()
        suite.make_scene = lambda: Own(*settings)
        getattr(suite, f"test_{test}")()

    run(dim)
    with pytest.raises(AssertionError, match=message):
        run(*scene)
