"""Light between diffuse surfaces, camera and projector apart [thesis 2.2, Fig. 3.10].

The camera's pixel i covers a piece of surface of area A_i around the point that its central ray
meets, the projector's pixel j one of area B_j. With r the albedo at a place x of a surface, and all
times s, the mean of B and the strength of the light:

- Direct light. A projector pixel spreads its light evenly over its part of the picture, and a
  camera pixel sees the mean over its own: ``T_ij = sum over x in i of r(x) [x in j] / (K B_j)``,
  over the K parts into which i is cut, those alone that nothing hides from the projector. By the
  parts of j the same is ``sum over x in j of r(x) [x in i] / (K A_i)``; the mean of the two is
  taken.
- Indirect light is that of `rfpipe.scenes.diffuse`, from the projector's points j to the camera's
  i: ``r_i G_ij r_j + r_i (sum over k of G_ik r_k a_k G_kj) r_j``. The points k in between are those
  of both pictures. What both see counts by half in either: ``a_i = A_i (1 - v_i / 2)``, with v_i
  the share of i that the projector sees; likewise ``a_j = B_j (1 - v_j / 2)``.

When the two change places, T becomes ``T^T`` but for s (Helmholtz' reciprocity). Where they stand
at one place, v is 1, A is B, and T the coaxial matrix of `RadiosityScene`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.crossing import is_clear, require_inside, shares
from rfpipe.scenes.diffuse import DiffuseScene, DiffuseSurfaces
from rfpipe.scenes.geometry import Points, Surface, least_squared, sight_of
from rfpipe.scenes.occluders import Occluder
from rfpipe.scenes.pinhole import Pinhole

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["AsideScene"]

Double = NDArray[np.float64]
Albedo = Callable[[Double, NDArray[np.int64]], Double]

_PARTS = 4  # of a pixel along either side


class AsideScene(DiffuseScene):
    """Diffuse surfaces, seen by a camera and lit by a projector that stands elsewhere.

    Rays that meet no surface carry no light.

    Parameters
    ----------
    surfaces
        The planes that bound the room, and after them a sphere in it, if there is one.
    camera, projector
        The two pinholes.
    albedo
        Albedo in [0, 1), float64 (n, C), of places float64 (n, 3) on surfaces int64 (n,), which
        are numbered as in `surfaces`.
    bounces
        Light simulated: 1 is direct light alone, each further one adds an inter-reflection.
    occluders
        Black parallelograms that block light between points, and the view of either pinhole.
    compress
        Whether to compress the form factors; None decides by their number.
    contrast
        The light is dimmed so that no pixel of the projector has more of it, per area, than this
        times what one of mean area has at full strength.
    name
        What the scene is called in its description.

    Raises
    ------
    InputError
        If a pinhole stands behind a plane or within the sphere, or a setting is out of range.
    """

    def __init__(
        self,
        surfaces: Sequence[Surface],
        camera: Pinhole,
        projector: Pinhole,
        albedo: Albedo,
        *,
        bounces: int = 3,
        occluders: Sequence[Occluder] = (),
        compress: bool | None = None,
        contrast: float = math.inf,
        name: str = "aside",
    ) -> None:
        self.surfaces, self.occluders = tuple(surfaces), tuple(occluders)
        seen, lit = (
            _side(one, other, self.surfaces, self.occluders, albedo)
            for one, other in ((camera, projector), (projector, camera))
        )
        super().__init__(camera.shape, projector.shape, seen.albedo.shape[1])
        self.name = name
        self.camera, self.projector = camera, projector
        self.scale = float(min(lit.seen_areas.mean(), contrast * lit.seen_areas.min()))
        self._direct = [
            (forward.multiply(1 / lit.areas) + backward.T.multiply(1 / seen.areas[:, None])).tocsr()
            * (self.scale / 2)
            for forward, backward in zip(seen.common, lit.common, strict=True)
        ]
        self._surfaces = DiffuseSurfaces(
            _joined(self.surfaces, seen, lit),
            np.concatenate([seen.albedo, lit.albedo]),
            bounces=bounces,
            occluders=occluders,
            compress=compress,
        )

    def _radiance(self, weights: Double) -> Double:
        """Radiance (M, B, C) of patterns (N, B)."""
        total = np.stack([np.asarray(direct @ weights) for direct in self._direct], axis=-1)
        if self._surfaces.bounces > 1:
            flux = np.concatenate([np.zeros((self._rays, weights.shape[1])), weights])
            total += self.scale * self._surfaces.radiosity(flux)[: self._rays]
        return total

    def _matrix(self, channel: int) -> Double:
        """The whole matrix (M, N) of one channel."""
        indirect = self._surfaces.dense(channel)[: self._rays, self._rays :]
        transport: Double = self._direct[channel].toarray() + self.scale * indirect
        return transport

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        return {
            **super().describe(),
            "camera": asdict(self.camera),
            "projector": asdict(self.projector),
            "parts": _PARTS,
            "surfaces": [asdict(surface) for surface in self.surfaces],
            "occluders": [asdict(occluder) for occluder in self.occluders],
            "scale": self.scale,
        }


@dataclass(frozen=True)
class _Side:
    """What one pinhole sees of the surfaces, pixel by pixel, n in all.

    `positions` (n, 3), `surface` (n,), -1 of none; `areas` (n,) covered there, 1 of none, and
    `bounce_areas`, what they count in light that goes on; `albedo` (n, C), 0 of none and of an
    occluder; `common`, the sums over x in the module's first equation, (n, the other's pixels), one
    a channel.
    """

    positions: Double
    surface: NDArray[np.int64]
    areas: Double
    bounce_areas: Double
    albedo: Double
    common: list[csr_array[np.float64]]

    @property
    def seen_areas(self) -> Double:
        """The areas of the pixels that see a surface; 1 of a pinhole that sees none."""
        areas = self.areas[self.surface >= 0]
        return areas if len(areas) else np.ones(1)


def _side(
    one: Pinhole,
    other: Pinhole,
    surfaces: tuple[Surface, ...],
    occluders: tuple[Occluder, ...],
    albedo: Albedo,
) -> _Side:
    """Look at the surfaces through one pinhole, and find what it has in common with the other."""
    from scipy.sparse import csr_array, diags_array

    require_inside(one.origin, surfaces)
    sight, parts = sight_of(one, surfaces), sight_of(one, surfaces, _PARTS)
    clear = is_clear(one.origin, sight, (), occluders)
    both = is_clear(one.origin, parts, (), occluders)
    both &= is_clear(other.origin, parts, surfaces, occluders)
    shared = shares(parts, other, both)
    count, each = len(sight.surface), _PARTS**2
    sums = csr_array(
        (np.full(count * each, 1 / each), np.arange(count * each), np.arange(count + 1) * each)
    )
    reflected = albedo(parts.positions, parts.surface)
    areas = np.where(sight.surface >= 0, sight.areas, 1)
    visible = np.asarray((sums @ shared).sum(axis=1))
    return _Side(
        sight.positions,
        sight.surface,
        areas,
        areas * (1 - visible / 2),
        albedo(sight.positions, sight.surface) * clear[:, None],
        [(sums @ diags_array(r) @ shared).tocsr() for r in reflected.T],
    )


def _joined(surfaces: tuple[Surface, ...], seen: _Side, lit: _Side) -> Points:
    """Put the points of both sides together, the camera's first."""
    mean = float((seen.seen_areas.mean() + lit.seen_areas.mean()) / 2)
    return Points(
        surfaces,
        np.concatenate([seen.surface, lit.surface]),
        np.concatenate([seen.positions, lit.positions]),
        np.concatenate([seen.bounce_areas, lit.bounce_areas]),
        least_squared(surfaces, mean),
    )
