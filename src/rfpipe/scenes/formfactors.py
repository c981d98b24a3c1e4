"""G between the points of a scene, the geometry of inter-reflection without albedo.

``G_ij = cos_i cos_j V_ij / (pi d_ij^2)``, squared distances clamped from below (at the mean pixel
area, see `Points.least_squared_distance`). Points of one surface don't see each other, so that G
consists of one block for each pair of surfaces; the block and its transpose serve the two
directions, which makes G exactly symmetric.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.sight import Points
from rfpipe.scenes.surfaces import Hider, Occluder, Surface

Double = NDArray[np.float64]
Index = NDArray[np.int64]

_STRIP_ENTRIES = 2**18  # entries of G computed at a time
_TOUCHING = 1e-12  # height over a plane, relative to the distance from the camera, that is rounding


@dataclass(frozen=True)
class FacingPair:
    """The points of two surfaces that see each other, and what G needs to know of them.

    Parameters
    ----------
    surfaces
        The two.
    indices
        int64 (n_1,) and (n_2,): the points on either surface that see the other's, ascending.
    positions, normals
        float64 (n_1, 3) and (n_2, 3): of the points, scene units.
    heights
        float64 (n_1,) and (n_2,): of the points over the other surface, above 0, scene units.
    hiders
        What may stand between them.
    least_squared_distance
        Lower clamp of the squared distances, scene units squared.
    """

    surfaces: tuple[Surface, Surface]
    indices: tuple[Index, Index]
    positions: tuple[Double, Double]
    normals: tuple[Double, Double]
    heights: tuple[Double, Double]
    hiders: tuple[Hider, ...]
    least_squared_distance: float

    @property
    def size(self) -> int:
        """Entries of this block of G."""
        return len(self.indices[0]) * len(self.indices[1])

    @cached_property
    def _coordinates(self) -> list[list[Double]]:
        """Either side's points in the coordinates of each hider."""
        return [[each.coordinates(points) for points in self.positions] for each in self.hiders]

    def unhidden(self, i: Index, j: Index) -> Double:
        """Entries between points i and j, which broadcast, as if nothing stood between them."""
        squared, here, there = (np.zeros(np.broadcast_shapes(i.shape, j.shape)) for _ in range(3))
        for axis in range(3):
            way = self.positions[1][j, axis] - self.positions[0][i, axis]
            squared += way * way
            here += way * self.normals[0][i, axis]
            there -= way * self.normals[1][j, axis]
        np.maximum(squared, self.least_squared_distance, out=squared)
        return np.asarray(np.maximum(here, 0) * np.maximum(there, 0) / (np.pi * squared**2))

    def smooth(self, i: Index, j: Index) -> Double:
        """Such entries over both heights, which leaves ``1 / (pi d^4)`` between planes."""
        return self.unhidden(i, j) / (self.heights[0][i] * self.heights[1][j])

    def entries(self, i: Index, j: Index) -> Double:
        """Entries between points i and j, which broadcast, in 1 / (scene units squared)."""
        values = self.unhidden(i, j)
        for hider, (first, second) in zip(self.hiders, self._coordinates, strict=True):
            values[hider.blocks(first[i], second[j])] = 0
        return values

    def block(self) -> Double:
        """The whole block of G, exact: float64 (n_1, n_2)."""
        i, j = (np.arange(len(each)) for each in self.indices)
        out = np.empty((len(i), len(j)))
        strip = max(1, _STRIP_ENTRIES // max(1, len(j)))
        for start in range(0, len(i), strip):
            rows = slice(start, start + strip)
            out[rows] = self.entries(i[rows, None], j[None])
        return out


def facing_pairs(points: Points, occluders: Sequence[Occluder] = ()) -> Iterator[FacingPair]:
    """Pair up the surfaces of a scene, each unordered pair once, with the points that face.

    Between them stand the scene's other rectangles and spheres, and the occluders.
    """
    touching = _TOUCHING * np.linalg.norm(points.positions, axis=1)
    heights = [surface.heights(points.positions) for surface in points.surfaces]
    for a, b in combinations(range(len(points.surfaces)), 2):
        first = np.flatnonzero((points.surface == a) & (heights[b] > touching))
        second = np.flatnonzero((points.surface == b) & (heights[a] > touching))
        if len(first) and len(second):
            one, two = points.surfaces[a], points.surfaces[b]
            p, q = points.positions[first], points.positions[second]
            others = (each for k, each in enumerate(points.surfaces) if k not in (a, b))
            yield FacingPair(
                (one, two),
                (first, second),
                (p, q),
                (one.normals(p), two.normals(q)),
                (heights[b][first], heights[a][second]),
                (*(each for each in others if isinstance(each, Hider)), *occluders),
                points.least_squared_distance,
            )
