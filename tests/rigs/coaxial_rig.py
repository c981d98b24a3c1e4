"""A calibrated coaxial rig of simulated devices, with a scene of two planes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from tests.rigs.calibration_bench import CAMERA, bench_of

from rfpipe.config import SceneSettings
from rfpipe.devices.optical_path import OpticalPath
from rfpipe.photometry import CameraModel
from rfpipe.photometry.resampling import Resampling
from rfpipe.rigs import DeviceRig
from rfpipe.rigs.layout import Quadrilateral
from rfpipe.scenes import scene_from_config

RAYS = (12, 16)
PIXELS = 3
"""Pixels a ray and side of projector and camera, whose pictures lie square on each other."""

PICTURE = (RAYS[0] * PIXELS, RAYS[1] * PIXELS)
GOOD = {"title": "Symmetry", "standing": "good", "verdict": "Light goes as it comes."}

Devices = tuple[Any, Any]
Inject = Callable[[Any, Any, int], Devices]


@cache
def path() -> OpticalPath:
    """Return the light path through the scene."""
    height, width = PICTURE
    corners: list[Quadrilateral] = [[(0, 0), (width, 0), (width, height), (0, height)]]
    config = SceneSettings.of("wedge", surfaces=("white", "texture"), shape=RAYS, channels=1)
    return OpticalPath(scene_from_config(config), RAYS, PICTURE, PICTURE, corners, corners)


@cache
def means() -> Resampling:
    """Return the mean of the camera pixels of each ray."""
    rays = path().layout.ray_of_pixel.ravel()
    weights = np.full(rays.size, 1 / PIXELS**2, np.float32)
    pixels = np.arange(rays.size)
    matrix = csr_array((weights, (rays, pixels)), shape=(RAYS[0] * RAYS[1], rays.size))
    return Resampling(RAYS, PICTURE, matrix)


def coaxial_rig(
    inject: Inject | None = None, after: int = 0, seed: int = 0, camera: CameraModel = CAMERA
) -> DeviceRig:
    """Return the rig, optionally with a fault that begins after `after` pictures."""
    bench = bench_of(path(), camera, seed=seed)
    devices: Devices = bench.projector, bench.camera
    if inject is not None:
        devices = inject(*devices, after)
    return DeviceRig(*devices, path().layout, means(), 0.0, {"symmetry": GOOD})


def darker(factor: float) -> CameraModel:
    """Return a camera that collects fewer electrons per radiance."""
    return replace(CAMERA, electrons_per_radiance=CAMERA.electrons_per_radiance / factor)
