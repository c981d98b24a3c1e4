"""G between the points of a scene, the geometry of inter-reflection without albedo.

``G_ij = cos_i cos_j V_ij / (pi d_ij^2)``, squared distances clamped from below (at the mean pixel
area, see `Points.least_squared_distance`). Points of one surface don't see each other, so that G
consists of one block for each pair of surfaces; the block and its transpose serve the two
directions, which makes G exactly symmetric. Within a block of two planes the cosines factor:
``d cos_j`` is the height of i over the plane of j, whatever j is, hence
``G_ij = h_i h_j V_ij / (pi d_ij^4)``. On a sphere the normal n_i of each point is another, and the
second height gives way to ``max(0, n_i . (x_j - x_i))``, zero where j is in i's own shadow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.geometry import Plane, Points, Surface
from rfpipe.scenes.visibility import Occluder, Sphere, blocked

Double = NDArray[np.float64]

_STRIP_ENTRIES = 2**20  # entries of G computed at a time
_TOUCHING = 1e-12  # height over a plane, relative to the distance from the camera, that is rounding


@dataclass(frozen=True)
class FacingPair:
    """The points of two surfaces that see each other, and what G needs to know of them.

    Parameters
    ----------
    surfaces
        Two planes, or the sphere and a plane.
    indices
        int64 (n_1,) and (n_2,): the points on either surface that see the other's, ascending.
    positions
        float64 (n_1, 3) and (n_2, 3): the points, scene units.
    heights
        float64 (n_1,) and (n_2,): positive heights of the points over the other plane; ones for
        points that face the sphere.
    occluders
        What may stand between them.
    least_squared_distance
        Lower clamp of the squared distances, scene units squared.
    between
        A sphere that may stand between two planes.
    """

    surfaces: tuple[Surface, Plane]
    indices: tuple[NDArray[np.int64], NDArray[np.int64]]
    positions: tuple[Double, Double]
    heights: tuple[Double, Double]
    occluders: tuple[Occluder, ...]
    least_squared_distance: float
    between: Sphere | None = None

    @property
    def normals(self) -> Double | None:
        """Normals of the first surface's points where it is a sphere, float64 (n_1, 3)."""
        first = self.surfaces[0]
        return first.normals(self.positions[0]) if isinstance(first, Sphere) else None

    @property
    def size(self) -> int:
        """Entries of this block of G."""
        return len(self.indices[0]) * len(self.indices[1])

    def block(self, rows: slice | NDArray[np.int64] = slice(None)) -> Double:
        """Rows of this block of G, exact: float64 (rows, n_2), in 1 / (scene units squared)."""
        heights = self.heights[0][rows]
        out = np.empty((len(heights), len(self.indices[1])))
        strip = max(1, _STRIP_ENTRIES // max(1, out.shape[1]))
        here, there = self.positions[0][rows], self.positions[1]
        normals = None if self.normals is None else self.normals[rows]
        shadows = [
            (occluder.coordinates(here), occluder.coordinates(there)) for occluder in self.occluders
        ]
        for start in range(0, len(out), strip):
            part = slice(start, start + strip)
            squared = np.zeros_like(out[part])
            for axis in range(3):
                squared += (here[part, axis, None] - there[:, axis]) ** 2
            np.maximum(squared, self.least_squared_distance, out=squared)
            np.divide(heights[part, None] * self.heights[1], np.pi * squared**2, out=out[part])
            if normals is not None:
                above = normals[part] @ there.T - (normals[part] * here[part]).sum(1)[:, None]
                out[part] *= np.maximum(above, 0)
            if self.between is not None:
                out[part][self.between.hides(here[part], there)] = 0
            for mine, other in shadows:
                out[part][blocked(mine[part, None], other)] = 0
        return out


def facing_pairs(points: Points, occluders: Sequence[Occluder] = ()) -> tuple[FacingPair, ...]:
    """Pair up the surfaces of a scene, each unordered pair once, with the points that face.

    Between them stand the scene's rectangles and sphere, and what else is given.
    """
    pairs = []
    touching = _TOUCHING * np.linalg.norm(points.positions, axis=1)
    surfaces: list[Surface] = [*points.planes]
    planes = range(len(surfaces))
    numbers = list(combinations(planes, 2))
    if points.sphere is not None:
        surfaces.append(points.sphere)
        numbers += [(len(planes), plane) for plane in planes]
    heights = [surface.heights(points.positions) for surface in surfaces]
    for a, b in numbers:
        first = np.flatnonzero((points.surface == a) & (heights[b] > touching))
        second = np.flatnonzero((points.surface == b) & (heights[a] > touching))
        if len(first) and len(second):
            of_planes = a in planes
            pairs.append(
                FacingPair(
                    (surfaces[a], points.planes[b]),
                    (first, second),
                    (points.positions[first], points.positions[second]),
                    (heights[b][first], heights[a][second] if of_planes else np.ones(len(second))),
                    (*points.occluders, *occluders),
                    points.least_squared_distance,
                    points.sphere if of_planes else None,
                )
            )
    return tuple(pairs)


def dense_form_factors(points: Points, occluders: Sequence[Occluder] = ()) -> Double:
    """G with every entry, float64 (N, N), of few points."""
    geometry = np.zeros((len(points.areas), len(points.areas)))
    for pair in facing_pairs(points, occluders):
        first, second = pair.indices
        geometry[np.ix_(first, second)] = block = pair.block()
        geometry[np.ix_(second, first)] = block.T
    return geometry
