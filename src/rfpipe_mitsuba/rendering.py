"""Pictures of a physically based scene that Mitsuba renders, pattern by pattern."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe_mitsuba.brightness import brightness
from rfpipe_mitsuba.variant import load_mitsuba
from rfpipe_mitsuba.views import View, Views
from rfpipe_mitsuba.world import World, load_scene

if TYPE_CHECKING:
    from rfpipe_mitsuba.light import Light

__all__ = ["Renderer"]

Double = NDArray[np.float64]


class Renderer:
    """Renders patterns with Mitsuba's own projectors, cameras and path tracers.

    With one seed the picture is linear in the pattern, its noise being that of the paths, which
    stay the same.

    Parameters
    ----------
    world
        The scene.
    camera, projector
        The two sides.
    light
        What is followed; caustics can't be.
    """

    def __init__(self, world: World, camera: Views, projector: Views, light: Light) -> None:
        self._mi = load_mitsuba()
        self._camera, self._projector, self._light = camera, projector, light
        shapes = load_scene(world)
        media = any(shape.is_medium_transition() for shape in shapes.shapes())
        described: dict[str, Any] = {
            "type": "scene",
            "integrator": {
                "type": "volpath" if media else "path",
                "max_depth": light.bounces + 1,
                "rr_depth": light.bounces + 1,
            },
        }
        described |= {f"shape_{k}": shape for k, shape in enumerate(shapes.shapes())}
        described |= {f"camera_{k}": self._sensor(each) for k, each in enumerate(camera.views)}
        described |= {f"light_{k}": self._emitter(each) for k, each in enumerate(projector.views)}
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
        rendered = [
            np.array(
                self._mi.render(
                    self._scene, sensor=index, spp=self._light.samples, seed=self._light.seed
                ),
                dtype=np.float64,
            )
            for index in range(len(self._camera.views))
        ]
        return np.concatenate([each.reshape(-1, 3) for each in rendered]) * self._scale

    def _sensor(self, view: View) -> dict[str, Any]:
        height, width = self._camera.shape
        return {
            "type": "perspective",
            "to_world": self._placed(view),
            "fov": view.degrees,
            "fov_axis": "x",
            "sampler": {"type": "independent"},
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
        }

    def _emitter(self, view: View) -> dict[str, Any]:
        blank = np.ones((*self._projector.shape, 3), dtype=np.float32)
        return {
            "type": "projector",
            "to_world": self._placed(view),
            "fov": view.degrees,
            "fov_axis": "x",
            "irradiance": {
                "type": "bitmap",
                "bitmap": self._mi.Bitmap(blank),
                "raw": True,
                "filter_type": "nearest",
            },
        }

    def _placed(self, view: View) -> Any:
        looking = self._mi.ScalarTransform4f().look_at
        return looking(origin=list(view.origin), target=list(view.target), up=list(view.up))
