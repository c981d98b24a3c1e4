"""Simulated scenes: ground-truth light transport for simulated rigs."""

from rfpipe.scenes.base import CoaxialScene, Scene, apply_in_batches, scene_from_config
from rfpipe.scenes.geometries import GEOMETRIES
from rfpipe.scenes.light_field import room_scene
from rfpipe.scenes.matrix import MatrixScene
from rfpipe.scenes.pinholes import Pinhole, surface_points
from rfpipe.scenes.radiosity import RadiosityScene
from rfpipe.scenes.relighting import (
    ONE_VIEW,
    RELIGHTING_PATTERNS,
    relighting_patterns,
)
from rfpipe.scenes.rooms import REFERENCE_SCENES, planes_scene, reference_scene
from rfpipe.scenes.surfaces import Occluder, Plane, Sphere

__all__ = [
    "GEOMETRIES",
    "ONE_VIEW",
    "REFERENCE_SCENES",
    "RELIGHTING_PATTERNS",
    "CoaxialScene",
    "MatrixScene",
    "Occluder",
    "Pinhole",
    "Plane",
    "RadiosityScene",
    "Scene",
    "Sphere",
    "apply_in_batches",
    "planes_scene",
    "reference_scene",
    "relighting_patterns",
    "room_scene",
    "scene_from_config",
    "surface_points",
]
