"""Pictures of a physically based scene that Mitsuba renders, pattern by pattern."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.sight import Pinhole
from rfpipe_mitsuba.variant import load_mitsuba
from rfpipe_mitsuba.views import Side
from rfpipe_mitsuba.world import Light, World, load_scene

Double = NDArray[np.float64]


class Renderer:
    """Renders patterns with Mitsuba's own projectors, cameras and path tracers.

    With one seed the picture is linear in the pattern, its noise being that of the paths, which
    stay the same. Caustics can't be followed.
    """

    def __init__(self, world: World, camera: Side, projector: Side, light: Light) -> None:
        self._mi = load_mitsuba()
        self._camera, self._projector, self._light = camera, projector, light
        shapes = load_scene(world)
        media = any(shape.is_medium_transition() for shape in shapes.shapes())
        depth = light.bounces + 1
        described: dict[str, Any] = {
            "type": "scene",
            "integrator": {
                "type": "volpath" if media else "path",
                "max_depth": depth,
                "rr_depth": depth,
            },
        }
        described |= {f"shape_{k}": shape for k, shape in enumerate(shapes.shapes())}
        described |= {f"camera_{k}": self._sensor(each) for k, each in enumerate(camera.pinholes)}
        described |= {
            f"light_{k}": self._emitter(each) for k, each in enumerate(projector.pinholes)
        }
        self._scene = self._mi.load_dict(described)
        # A projector of Mitsuba's lights a surface at distance 1 so that white has radiance 1.
        self._scale = brightness(shapes, projector) / np.pi

    def render(self, pattern: Double) -> Double:
        """Return radiance float64 (M, 3) under one pattern (N,)."""
        pictures = pattern.reshape(-1, *self._projector.shape, 1).repeat(3, axis=3)
        parameters = self._mi.traverse(self._scene)
        for index, picture in enumerate(pictures):
            key = f"light_{index}.irradiance.data"
            parameters[key] = type(parameters[key])(picture.astype(np.float32))
        parameters.update()
        options = {"spp": self._light.samples, "seed": self._light.seed}
        rendered = [
            np.array(self._mi.render(self._scene, sensor=index, **options), dtype=np.float64)
            for index in range(len(self._camera.pinholes))
        ]
        return np.concatenate([each.reshape(-1, 3) for each in rendered]) * self._scale

    def _sensor(self, pinhole: Pinhole) -> dict[str, Any]:
        film = {
            "type": "hdrfilm",
            "width": pinhole.shape[1],
            "height": pinhole.shape[0],
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        }
        placed = self._placed("perspective", pinhole)
        return {**placed, "sampler": {"type": "independent"}, "film": film}

    def _emitter(self, pinhole: Pinhole) -> dict[str, Any]:
        blank = self._mi.Bitmap(np.ones((*pinhole.shape, 3), dtype=np.float32))
        picture = {"type": "bitmap", "bitmap": blank, "raw": True, "filter_type": "nearest"}
        return {**self._placed("projector", pinhole), "irradiance": picture}

    def _placed(self, kind: str, pinhole: Pinhole) -> dict[str, Any]:
        at = self._mi.ScalarTransform4f().look_at(
            origin=list(pinhole.position), target=list(pinhole.look_at), up=list(pinhole.up)
        )
        degrees = 2 * np.degrees(np.arctan(pinhole.pitch * pinhole.shape[1] / 2))
        return {"type": kind, "to_world": at, "fov": float(degrees), "fov_axis": "x"}


def brightness(scene: Any, projector: Side) -> float:
    """Return the flux per area of a projector's image plane at distance 1 in Mitsuba's scene.

    It is such that the full light of all projectors together gives a matt white surface that faces
    it radiance 1, or less, but for the nearest 5 % of what their pixels cover: who sets up a rig
    dims the light until its camera can take it.
    """
    areas = []
    for pinhole in projector.pinholes:
        rays = pinhole.rays()
        lengths = np.linalg.norm(rays, axis=1)
        distances, normals = hits(scene, pinhole)
        met = np.isfinite(distances)
        cosines = np.abs((rays * normals).sum(axis=1)) / lengths
        areas.append((distances**2 / lengths**3 / np.maximum(cosines, 1e-3))[met])
    covered = np.concatenate(areas)
    return float(np.pi * np.quantile(covered, 0.05)) / len(areas) if len(covered) else 1.0


def hits(scene: Any, pinhole: Pinhole) -> tuple[Double, Double]:
    """Return distances (n,), infinite where a pixel's ray meets nothing, and normals (n, 3)."""
    mi = load_mitsuba()
    start = [float(x) for x in pinhole.position]
    ways = pinhole.rays()
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    if not mi.variant().startswith("scalar"):
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(start), mi.Vector3f(ways.T)))
        return hit.t.numpy().astype(np.float64), hit.n.numpy().T.astype(np.float64)
    met = [scene.ray_intersect(mi.Ray3f(start, [float(x) for x in way])) for way in ways]
    return np.array([hit.t for hit in met]), np.array([list(hit.n) for hit in met])
