"""Light transport between the views of an array: an 8D reflectance field [thesis 5.2, Fig. 5.8].

Each ray sees, and lights, a few texels: a sparse matrix P, whose rows add up to 1, says which and
in what proportion. With M the matrix of `DiffuseSurfaces` over the texels,
``T = s P M P^T``, symmetric as eq. (2.10) wants it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import fingerprint
from rfpipe.scenes.base import CoaxialScene
from rfpipe.scenes.diffuse import DiffuseScene, DiffuseSurfaces
from rfpipe.scenes.panels import Panel, TexelGrid
from rfpipe.scenes.textures import surface_albedo
from rfpipe.scenes.views import DISTANCE, ViewArray, sightings

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["LightFieldScene"]

_PARTS = 3  # of a pixel along either side, each seen along a ray of its own
_PATCH = 2  # texels along either side of a patch that indirect light takes for one


class LightFieldScene(CoaxialScene, DiffuseScene):
    """Panels with texels, seen and lit by an array of views.

    Only texels that some ray sees take part: light that falls elsewhere is lost.

    Parameters
    ----------
    views
        The array; a texel is about as large as a pixel of it where the views look.
    panels
        The surfaces; those that don't enclose the scene also hide others from each other.
    channels
        1 (grey) or 3 (RGB).
    bounces
        Light simulated: 1 is direct light alone, each further one adds an inter-reflection.
    seed
        Seed of the textures.
    compress
        Whether to compress the form factors; None decides by their number.
    name
        What the scene is called in its description.

    Raises
    ------
    InputError
        If a ray sees no panel or the back of one, or a setting is out of range.
    """

    def __init__(
        self,
        views: ViewArray,
        panels: Sequence[Panel],
        *,
        channels: int = 3,
        bounces: int = 3,
        seed: int = 0,
        compress: bool | None = None,
        name: str = "light field",
    ) -> None:
        super().__init__(views.ray_shape, channels)
        self.views = views
        self.panels = tuple(panels)
        self.name = name
        grid = TexelGrid(panels, DISTANCE * views.pitch)
        seen = sightings(views, grid, _PARTS)
        texels = np.unique(seen.texels.indices).astype(np.int64)
        self._seen = seen.texels[:, texels]
        self._scale = float(seen.footprint.mean()) / views.count
        albedo = np.concatenate(
            [
                surface_albedo(
                    panel.surface, (height, width), channels, seed, index, panel.tint
                ).reshape(-1, channels)
                for index, (panel, (height, width)) in enumerate(
                    zip(panels, grid.shapes.tolist(), strict=True)
                )
            ]
        )
        self._surfaces = DiffuseSurfaces(
            grid.points(texels),
            albedo[texels],
            bounces=bounces,
            compress=compress,
            patches=grid.patches(texels, _PATCH),
        )

    @property
    def albedo(self) -> NDArray[np.float32]:
        """Mean albedo seen by each ray, float32 (*shape, C), in [0, 1)."""
        albedo = np.asarray(self._seen @ self._surfaces.albedo)
        return albedo.reshape(*self.shape, self.channels).astype(np.float32)

    @cached_property
    def _texels(self) -> csr_array[np.float64]:
        """The transpose of the rays' matrix, which spreads their light onto the texels."""
        return self._seen.T.tocsr()

    def _radiance(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance (N, B, C) of patterns (N, B)."""
        leaving = self._surfaces.radiosity(np.asarray(self._texels @ weights))
        leaving *= self._scale
        radiance = np.asarray(self._seen @ leaving.reshape(len(leaving), -1))
        return radiance.reshape(*weights.shape, -1)

    def _matrix(self, channel: int) -> NDArray[np.float64]:
        """The whole matrix (N, N) of one channel."""
        half = np.asarray(self._seen @ self._surfaces.dense(channel))
        transport: NDArray[np.float64] = self._scale * np.asarray(self._seen @ half.T)
        return (transport + transport.T) / 2  # products round

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        return {
            **super().describe(),
            "views": asdict(self.views),
            "distance": DISTANCE,
            "parts": _PARTS,
            "patch": _PATCH,
            "panels": [asdict(panel) for panel in self.panels],
            "rays": fingerprint([self._seen.indptr, self._seen.indices, self._seen.data]),
        }
