"""Simulated projectors and cameras with a known scene, for tests of the calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from tests.rigs.simulated_devices import SimulatedCamera, SimulatedProjector

from rfpipe.config import SceneSettings
from rfpipe.devices.optical_path import OpticalPath
from rfpipe.photometry import CameraModel
from rfpipe.rigs.layout import Quadrilateral, centred_corners, tilted_corners
from rfpipe.scenes import RadiosityScene, scene_from_config
from rfpipe.scenes.lenses import Lens, LensView

CAMERA = CameraModel()

GAMMA = 2.2


@dataclass
class Bench:
    """A projector, a camera, and the light path between them."""

    path: OpticalPath
    projector: SimulatedProjector
    camera: SimulatedCamera


class Surface:
    """A scene of direct light alone: radiance is albedo times light."""

    channels = 1

    def __init__(self, albedo: np.ndarray) -> None:
        self.albedo = albedo.reshape(-1, 1).astype(np.float32)

    def apply(self, patterns: np.ndarray) -> np.ndarray:
        return patterns[:, :, None] * self.albedo


def bench_of(
    path: OpticalPath, sensor: CameraModel = CAMERA, gamma: float = 1.0, seed: int = 0
) -> Bench:
    """Return a bench with a projector of a given gamma, a light path and a camera."""
    projector = SimulatedProjector(path.projector_shape)
    light = np.linspace(0, 1, 256) ** gamma

    def radiance() -> np.ndarray:
        codes = np.rint(projector.light * 255).astype(int)
        shown = projector.light if gamma == 1 else light[codes]
        if shown.ndim == 2:
            return path.radiance(shown)
        colours = [path.radiance(shown[..., colour])[..., colour] for colour in range(3)]
        return np.stack(colours, axis=-1)

    shape, channels = path.camera_shape, path.channels
    return Bench(path, projector, SimulatedCamera(radiance, shape, channels, sensor, seed))


def wedge_bench(
    rays: tuple[int, int] = (16, 16),
    display: tuple[int, int] = (144, 160),
    camera: tuple[int, int] = (48, 54),
    sensor: CameraModel = CAMERA,
    gamma: float = 1.0,
    seed: int = 0,
    channels: int = 1,
    lens: Lens | None = None,
) -> Bench:
    """Return a bench with two planes that light each other; `lens`: of both devices."""
    config = SceneSettings.of("wedge", surfaces=("white", "texture"), shape=rays, channels=channels)
    scene = scene_from_config(config)
    direct = scene_from_config(config.model_copy(update={"bounces": 1}))
    assert isinstance(scene, RadiosityScene)
    views = () if lens is None else (LensView(lens, scene.pinholes[0], scene.points.surfaces),)
    path = OpticalPath(
        scene,
        rays,
        display,
        camera,
        centred_corners(rays, display),
        tilted_corners(rays, camera),
        np.asarray(direct.apply(np.ones((1, rays[0] * rays[1]), np.float32)))[0],
        projector_lenses=views,
        camera_lenses=views,
    )
    return bench_of(path, sensor, gamma, seed)


def surface_bench(
    rays: tuple[int, ...],
    display: tuple[int, int],
    camera: tuple[int, int],
    views: tuple[int, int] = (1, 1),
    camera_corners: Sequence[Quadrilateral] | None = None,
    sensor: CameraModel = CAMERA,
    seed: int = 0,
) -> Bench:
    """Return a bench with a surface of random albedo, for one view or an array of views."""
    albedo = np.random.default_rng(seed).uniform(0.3, 0.9, rays)
    path = OpticalPath(
        Surface(albedo),
        rays,
        display,
        camera,
        centred_corners(rays, display, views),
        camera_corners or tilted_corners(rays, camera, views),
        albedo.reshape(-1, 1),
    )
    return bench_of(path, sensor, seed=seed)


def flat_frames(
    camera: CameraModel, light: np.ndarray, count: int, key: tuple[int, ...], seed: int = 0
) -> np.ndarray:
    """Return brackets of a radiance image (H, W)."""
    image = light[..., None].astype(np.float32)
    return np.stack([camera.expose(image, seed, (*key, index)) for index in range(count)])


def uneven(shape: tuple[int, int] = (64, 64), seed: int = 0) -> np.ndarray:
    """Return the radiance of a textured surface under uneven light, up to 1."""
    y, x = np.mgrid[: shape[0], : shape[1]] / shape[0]
    falloff = 0.3 + 0.7 * np.exp(-3 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
    return falloff * np.random.default_rng(seed).choice([0.2, 1.0], shape)


def brighter(camera: CameraModel, factor: float) -> CameraModel:
    """Return a camera that collects more electrons per radiance."""
    return replace(camera, electrons_per_radiance=factor * camera.electrons_per_radiance)
