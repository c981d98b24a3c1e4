"""Light transport between diffuse surfaces as a coaxial rig sees it [thesis 2.2, Fig. 2.1].

A projector pixel sends its light onto one surface point and a camera pixel sees one: T is the
matrix of `DiffuseSurfaces`, times the mean of the pixels' areas and the strength of the light, and
symmetric as in eq. (2.10).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.base import CoaxialScene
from rfpipe.scenes.diffuse import DiffuseScene, DiffuseSurfaces
from rfpipe.scenes.geometry import SurfacePoints
from rfpipe.scenes.occluders import Occluder, blocked

__all__ = ["RadiosityScene"]


class RadiosityScene(CoaxialScene, DiffuseScene):
    """Diffuse surfaces, their albedo and black occluders, seen by a coaxial rig.

    Parameters
    ----------
    points
        The surface points behind the pixels.
    albedo
        (H, W, C) in [0, 1): C is 1 (grey) or 3 (RGB). Pixels that see an occluder get 0.
    bounces
        Light simulated: 1 is direct light alone, each further one adds an inter-reflection.
    occluders
        Black parallelograms that block light between points and the rig's own view.
    compress
        Whether to compress the form factors; None decides by their number.
    light
        Strength of the projector's light: 1 gives direct light of albedo x mean(A) / A.
    name
        What the scene is called in its description.

    Raises
    ------
    InputError
        If albedo, light or bounces are out of range.
    """

    def __init__(
        self,
        points: SurfacePoints,
        albedo: ArrayLike,
        *,
        bounces: int = 3,
        occluders: Sequence[Occluder] = (),
        compress: bool | None = None,
        light: float = 1.0,
        name: str = "radiosity",
    ) -> None:
        values = np.array(albedo, dtype=np.float64)
        if values.shape[:2] != points.shape or values.ndim != 3:
            raise InputError(
                f"albedo of shape {values.shape}: expected ({', '.join(map(str, points.shape))}, "
                "channels)"
            )
        if not light > 0 or not np.isfinite(light):
            raise InputError(f"light {light}: expected a finite number above 0")
        super().__init__(points.shape, values.shape[2])
        self.points = points
        self.light = float(light)
        self.name = name
        origin = np.zeros(3)
        for occluder in occluders:
            seen = blocked(occluder.coordinates(origin), occluder.coordinates(points.positions))
            values[seen.reshape(points.shape)] = 0
        self._surfaces = DiffuseSurfaces(
            points,
            values.reshape(-1, values.shape[2]),
            bounces=bounces,
            occluders=occluders,
            compress=compress,
        )

    @property
    def occluders(self) -> tuple[Occluder, ...]:
        """What blocks light between points and the rig's own view."""
        return self._surfaces.occluders

    def _radiance(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance (N, B, C) of patterns (N, B)."""
        total = self._surfaces.radiosity(weights)
        total *= self.points.mean_area * self.light
        return total

    def _matrix(self, channel: int) -> NDArray[np.float64]:
        """The whole matrix (N, N) of one channel, exact."""
        transport = self._surfaces.dense(channel)
        transport *= self.points.mean_area * self.light
        return transport

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        sphere = self.points.sphere
        return {
            **super().describe(),
            "shape": list(self.shape),
            "planes": [asdict(each) for each in self.points.surfaces if each is not sphere],
            "occluders": [asdict(occluder) for occluder in self.occluders],
            **({} if sphere is None else {"sphere": asdict(sphere)}),
            **({} if self.light == 1 else {"light": self.light}),
        }
