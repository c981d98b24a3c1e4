"""Form factors G between the points of a scene: inter-reflection without albedo.

``G_ij = cos_i cos_j V_ij / (pi d_ij^2)``, with the visibility V and squared distances d^2 clamped
from below (at about the mean pixel area, see `Points.min_squared_distance`). Points of the same
surface exchange no light, so G has one block for each pair of surfaces; using the block and its
transpose for the two directions makes G exactly symmetric.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from rfpipe.array_types import Double, Index
from rfpipe.scenes.pinholes import Points
from rfpipe.scenes.surfaces import Obstruction, Occluder, Surface

_STRIP_ENTRIES = 2**18  # entries of G computed at a time
_TOUCHING = 1e-12  # rounding error of heights, relative to the distance from the camera


@dataclass(frozen=True)
class FacingPair:
    """The points of two surfaces that face each other, with the geometry for G.

    Parameters
    ----------
    surfaces
    indices
        int64 (n_1,) and (n_2,): points of each surface that face the opposite one, ascending.
    positions, normals
        float64 (n_1, 3) and (n_2, 3), scene units.
    heights
        float64 (n_1,) and (n_2,): positive heights above the opposite surface, scene units.
    obstructions
        Objects that may occlude them from each other.
    min_squared_distance
        Lower clamp of the squared distances, scene units squared.
    """

    surfaces: tuple[Surface, Surface]
    indices: tuple[Index, Index]
    positions: tuple[Double, Double]
    normals: tuple[Double, Double]
    heights: tuple[Double, Double]
    obstructions: tuple[Obstruction, ...]
    min_squared_distance: float

    @property
    def size(self) -> int:
        """Number of entries of this block of G."""
        return len(self.indices[0]) * len(self.indices[1])

    @cached_property
    def _coordinates(self) -> list[list[Double]]:
        """Both surfaces' points in the coordinates of each obstruction."""
        return [
            [obstruction.coordinates(points) for points in self.positions]
            for obstruction in self.obstructions
        ]

    def unoccluded(self, i: Index, j: Index) -> Double:
        """Entries between points i and j, which broadcast, without occlusion."""
        squared, cosine_i, cosine_j = (
            np.zeros(np.broadcast_shapes(i.shape, j.shape)) for _ in range(3)
        )
        for axis in range(3):
            offset = self.positions[1][j, axis] - self.positions[0][i, axis]
            squared += offset * offset
            cosine_i += offset * self.normals[0][i, axis]
            cosine_j -= offset * self.normals[1][j, axis]
        np.maximum(squared, self.min_squared_distance, out=squared)
        return np.asarray(np.maximum(cosine_i, 0) * np.maximum(cosine_j, 0) / (np.pi * squared**2))

    def smooth(self, i: Index, j: Index) -> Double:
        """Unoccluded entries divided by both heights: ``1 / (pi d^4)`` between planes."""
        return self.unoccluded(i, j) / (self.heights[0][i] * self.heights[1][j])

    def entries(self, i: Index, j: Index) -> Double:
        """Entries between points i and j, which broadcast, in 1 / (scene units squared)."""
        values = self.unoccluded(i, j)
        for obstruction, (first, second) in zip(self.obstructions, self._coordinates, strict=True):
            values[obstruction.blocks(first[i], second[j])] = 0
        return values

    def block(self) -> Double:
        """The exact, dense block of G: float64 (n_1, n_2)."""
        i, j = (np.arange(len(indices)) for indices in self.indices)
        out = np.empty((len(i), len(j)))
        strip = max(1, _STRIP_ENTRIES // max(1, len(j)))
        for start in range(0, len(i), strip):
            rows = slice(start, start + strip)
            out[rows] = self.entries(i[rows, None], j[None])
        return out


def facing_pairs(points: Points, occluders: Sequence[Occluder] = ()) -> Iterator[FacingPair]:
    """Yield the pairs of surfaces with points that face each other, each unordered pair once.

    Occluders and all further rectangles and spheres of the scene are obstructions.
    """
    touching = _TOUCHING * np.linalg.norm(points.positions, axis=1)
    heights = [surface.heights(points.positions) for surface in points.surfaces]
    for a, b in combinations(range(len(points.surfaces)), 2):
        first = np.flatnonzero((points.surface == a) & (heights[b] > touching))
        second = np.flatnonzero((points.surface == b) & (heights[a] > touching))
        if len(first) and len(second):
            surface_a, surface_b = points.surfaces[a], points.surfaces[b]
            p, q = points.positions[first], points.positions[second]
            further = (surface for k, surface in enumerate(points.surfaces) if k not in (a, b))
            yield FacingPair(
                (surface_a, surface_b),
                (first, second),
                (p, q),
                (surface_a.normals(p), surface_b.normals(q)),
                (heights[b][first], heights[a][second]),
                (*(surface for surface in further if isinstance(surface, Obstruction)), *occluders),
                points.min_squared_distance,
            )
