"""The scenes, each under its name, and the pictures that are relit of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.mitsuba.worlds import WORLDS
from rfpipe.relighting import picture_errors, relighting_pictures
from rfpipe.scenes import Scene, planes_scene
from rfpipe.scenes.pinholes import Pinhole

if TYPE_CHECKING:
    from rfpipe.mitsuba.scene import MitsubaScene

__all__ = ["KINDS", "Kind", "Stage", "settings_of", "stage_of"]


_BRIGHTEST = 1.9
"""Radiance of the brightest pixel of the floodlit image, of 2 that the camera takes."""

_LEAST_SIDE = 8  # of each view of a stack
_PICTURES = 96
_PICTURES_SEED = 1000  # of seed 0's pictures: not the camera's
ASIDE = ((1.72, 0.0, 0.54), (0.0, 0.0, 3.0))  # place and target of a projector


@dataclass(frozen=True)
class Kind:
    """A kind of scene.

    Attributes
    ----------
    what : str
        "physical" or "matt".
    settings : callable
        Plain data that describe the scene, from (side, channels, samples, seed).
    make : callable
        The scene, from the same arguments and the folder of recorded matrices.
    """

    what: str
    settings: Callable[[str, int, int, int], dict[str, Any]]
    make: Callable[[str, int, int, int, Path], Scene]


_WEDGES = {
    "plane_i": ("plane", ("texture",)),
    "wedge_ii": ("wedge", ("white", "white")),
    "wedge_iii": ("wedge", ("white", "texture")),
    "wedge_iv": ("wedge", ("texture", "texture")),
    "wedge_30": ("wedge_30", ("white", "texture")),
    "wedge_120": ("wedge_120", ("white", "texture")),
    "tilted_wedge": ("tilted_wedge", ("white", "texture")),
    "wedge_aside": ("wedge_120", ("texture", "white")),
}


def shape_of(side: str) -> tuple[int, int]:
    """Return height and width of ``48`` or ``310x350``."""
    height, _, width = side.partition("x")
    return int(height), int(width or height)


def _wedge(name: str) -> Kind:
    geometry, surfaces = _WEDGES[name]
    aside = ASIDE if name == "wedge_aside" else None

    def settings(side: str, channels: int, _samples: int, seed: int) -> dict[str, Any]:
        return {"geometry": geometry, "surfaces": surfaces, "side": side, "channels": channels,
                "aside": aside, "seed": seed}  # fmt: skip

    def make(side: str, channels: int, _samples: int, seed: int, _cache: Path) -> Scene:
        shape = shape_of(side)
        lamp = aside and Pinhole(shape, *aside)
        return planes_scene(geometry, surfaces, shape, projector=lamp, channels=channels, seed=seed)

    return Kind("matt", settings, make)


def _world(name: str) -> Kind:
    def settings(side: str, channels: int, samples: int, _seed: int) -> dict[str, Any]:
        return _mitsuba(name, side, channels, samples, Path()).describe()

    def make(side: str, channels: int, samples: int, _seed: int, cache: Path) -> Scene:
        return _mitsuba(name, side, channels, samples, cache)

    return Kind("physical", settings, make)


def _mitsuba(name: str, side: str, channels: int, samples: int, cache: Path) -> MitsubaScene:
    """Return a world; the views of a stack share about the pixels of one picture."""
    from rfpipe.mitsuba.scene import MitsubaOptions, MitsubaScene

    world = WORLDS[name]
    views = max(len(world.cameras), len(world.projectors or ()))
    planes = [
        max(min(length, _LEAST_SIDE), round(length / math.sqrt(views))) for length in shape_of(side)
    ]
    options = MitsubaOptions.model_validate(
        {
            "kind": "rfpipe.mitsuba.scene:MitsubaScene",
            "scene": name,
            "shape": planes,
            "channels": channels,
            "samples": samples,
            "cache": str(cache),
        }
    )
    return MitsubaScene(options)


KINDS: dict[str, Kind] = {name: _world(name) for name in WORLDS} | {
    name: _wedge(name) for name in _WEDGES
}
"""All scenes: every physically based one, and matt wedges, one of them lit from aside."""


def projector_views(name: str) -> int:
    """Return the number of views of a scene's projector; a coaxial one has those of the camera."""
    if name not in WORLDS:
        return 1
    world = WORLDS[name]
    return len(world.projectors or world.cameras)


@lru_cache(maxsize=512)
def settings_of(name: str, side: str, channels: int, samples: int, seed: int) -> dict[str, Any]:
    """Return plain data that describe a scene, without building it."""
    return KINDS[name].settings(side, channels, samples, seed)


class Lit(Scene):
    """A scene under a projector that is dimmed, or opened, to what the camera just takes."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene.camera_shape, scene.projector_shape, scene.channels)
        self._scene = scene
        floodlit = scene.apply(np.ones((1, math.prod(scene.projector_shape))))[0]
        brightest = float(floodlit.max())
        if not brightest > 0:
            raise InputError("no light comes back to the camera from the floodlit scene")
        self._light = _BRIGHTEST / brightest
        self.floodlit = np.float32(self._light) * floodlit.reshape(*scene.camera_shape, -1)

    def apply(self, patterns: ArrayLike) -> Float:
        """Radiance float32 (B, M, C), its maximum in the floodlit image `_BRIGHTEST`."""
        return np.float32(self._light) * self._scene.apply(patterns)

    def describe(self) -> dict[str, Any]:
        """Plain data."""
        return {"light": self._light, **self._scene.describe()}


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene with the pictures that are relit of it.

    Attributes
    ----------
    scene : Lit
    patterns : ndarray of float32, shape (P, *projector_shape)
        Of the distribution of `rfpipe.relighting.relighting_pictures`.
    truth : ndarray of float32, shape (P, *camera_shape, C)
    grain : float
        Standard error of the recorded matrix: of indirect light of a half-lit picture, relative;
        NaN of scenes that aren't recorded.
    coaxial : bool
        Whether both sides share their rays, so that a picture's dark pixels are the pattern's.
    """

    scene: Lit
    patterns: Float
    truth: Float
    grain: float
    coaxial: bool

    def errors(self, images: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the errors of the first pictures, in total and of their indirect light.

        The latter where the pattern is dark; NaN where that isn't what the camera sees.
        """
        patterns = self.patterns[: len(images)]
        dark = patterns == 0 if self.coaxial else None
        truth = self.truth[: len(images)]
        return picture_errors(images, truth, patterns, self.scene.floodlit, dark)


@lru_cache(maxsize=2)
def stage_of(name: str, side: str, channels: int, samples: int, seed: int, cache: Path) -> Stage:
    """Make a scene, its pictures and their truth."""
    scene = KINDS[name].make(side, channels, samples, seed, cache)
    patterns = relighting_pictures(scene.projector_shape, _PICTURES, _PICTURES_SEED + seed)
    grain, coaxial = float("nan"), name != "wedge_aside"
    if KINDS[name].what == "physical":
        of_world: Any = scene
        grain = of_world.recording.noise["half_lit"]["unlit"]
        coaxial = of_world.coaxial
    lit = Lit(scene)
    truth = lit.apply(patterns).reshape(-1, *scene.camera_shape, channels)
    return Stage(lit, patterns, truth, grain, coaxial)
