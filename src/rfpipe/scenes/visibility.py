"""What stands between two points: black occluders, and a sphere.

An occluder is a parallelogram. In its own affine coordinates (s, u, v) a point is
``centre + s n + u edge_u + v edge_v``, with n the unit normal, so that the occluder is s = 0,
|u| <= 1, |v| <= 1. The segment between two points on opposite sides of s = 0 crosses that plane at
``u = (u_1 s_2 - u_2 s_1) / (s_2 - s_1)``, likewise v: a form that is the same, to the last bit,
when the two points change places.

A segment is hidden by a sphere when it passes through it. A point of the sphere sees what lies
above its tangent plane, ``n_i . (x_j - c) > R`` with n its normal, c the centre and R the radius:
as a sphere is convex, that is all of its own shadow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.pinhole import Vector

Double = NDArray[np.float64]

# Fraction of a segment at either end in which it can't be blocked, and relative depth below a
# sphere's surface above which it isn't hidden: surfaces aren't hidden by what they touch.
END_TOLERANCE = 1e-9
GRAZING = 1e-9
_MARGIN = 1e-9  # relative margin by which a whole cluster must be clear, against rounding

# What a pair of point clusters can be to each other.
HIDDEN, VISIBLE, MIXED = np.int8(0), np.int8(1), np.int8(2)


@dataclass(frozen=True)
class Occluder:
    """A black parallelogram that blocks light between surfaces and the camera's own view.

    Parameters
    ----------
    centre
        Centre, scene units.
    edge_u, edge_v
        Vectors from the centre to the middle of two neighbouring edges, scene units; not
        parallel.

    Raises
    ------
    InputError
        If the vectors don't span a parallelogram.
    """

    centre: Vector
    edge_u: Vector
    edge_v: Vector

    def __post_init__(self) -> None:
        frame = np.array([self.edge_u, self.edge_v], dtype=np.float64)
        area = np.linalg.norm(np.cross(frame[0], frame[1]))
        if not area > 1e-12 * np.linalg.norm(frame, axis=1).prod():
            raise InputError(
                f"occluder at {self.centre}: edges {self.edge_u} and {self.edge_v} should span a "
                "parallelogram; give two vectors that are neither zero nor parallel"
            )

    def coordinates(self, points: Double) -> Double:
        """Affine coordinates (s, u, v) of points (..., 3), float64 of the same shape."""
        edges = np.array([self.edge_u, self.edge_v], dtype=np.float64)
        normal = np.cross(edges[0], edges[1])
        normal /= np.linalg.norm(normal)
        frame = np.linalg.inv(np.stack([normal, edges[0], edges[1]], axis=1))
        affine: Double = (points - np.asarray(self.centre)) @ frame.T
        return affine


def blocked(first: Double, second: Double) -> NDArray[np.bool_]:
    """Whether an occluder stands between points.

    Parameters
    ----------
    first, second
        float64 (..., 3): affine coordinates of the segments' ends, broadcast against each other.

    Returns
    -------
    ndarray of bool
        True where the segment crosses the occluder, its two ends excepted.
    """
    s_1, u_1, v_1 = np.moveaxis(first, -1, 0)
    s_2, u_2, v_2 = np.moveaxis(second, -1, 0)
    span = s_2 - s_1
    ends = END_TOLERANCE * np.abs(span)
    crosses: NDArray[np.bool_] = (s_1 * s_2 < 0) & (np.abs(s_1) > ends) & (np.abs(s_2) > ends)
    # |u| <= 1 at the crossing, without a division by a span that may be zero
    crosses &= np.abs(u_1 * s_2 - u_2 * s_1) <= np.abs(span)
    crosses &= np.abs(v_1 * s_2 - v_2 * s_1) <= np.abs(span)
    return crosses


def classify(first: Double, second: Double) -> NDArray[np.int8]:
    """Prove pairs of clusters wholly visible to each other or wholly hidden, where possible.

    A cluster stands for the convex hull of its corners. When two hulls lie on opposite sides of
    the occluder's plane, the lines between them cross it in the convex hull of the corners'
    crossings, so that bounds of these bound all of them.

    Parameters
    ----------
    first, second
        float64 (n, k, 3): affine coordinates of the k corners of each cluster.

    Returns
    -------
    int8 (n,)
        `VISIBLE`, `HIDDEN`, or `MIXED` where neither is proved.
    """
    both = np.concatenate([first, second], axis=1)
    low, high = both.min(1), both.max(1)
    clear = (low[:, 0] >= 0) | (high[:, 0] <= 0)
    clear |= (low[:, 1:] > 1 + _MARGIN).any(1) | (high[:, 1:] < -1 - _MARGIN).any(1)
    verdict = np.where(clear, VISIBLE, MIXED)

    s_1, s_2 = first[..., 0], second[..., 0]
    margin = _MARGIN * (high[:, 0] - low[:, 0])
    opposite = (s_1.max(1) < -margin) & (s_2.min(1) > margin)
    opposite |= (s_1.min(1) > margin) & (s_2.max(1) < -margin)
    todo = np.flatnonzero(opposite & ~clear)
    if len(todo):
        p, q = first[todo][:, :, None], second[todo][:, None]
        s_p, s_q = p[..., :1], q[..., :1]
        crossing = (p[..., 1:] * s_q - q[..., 1:] * s_p) / (s_q - s_p)
        low, high = crossing.min((1, 2)), crossing.max((1, 2))
        missed = (low > 1 + _MARGIN).any(1) | (high < -1 - _MARGIN).any(1)
        inside = ((low > -1 + _MARGIN) & (high < 1 - _MARGIN)).all(1)
        verdict[todo[missed]] = VISIBLE
        verdict[todo[inside]] = HIDDEN
    return verdict


@dataclass(frozen=True)
class Sphere:
    """An opaque sphere in the room, seen from outside.

    Parameters
    ----------
    name
        What the sphere is called in descriptions and errors.
    centre
        Scene units.
    radius
        Scene units, above 0.
    """

    name: str
    centre: Vector
    radius: float

    def normals(self, points: Double) -> Double:
        """Unit normals (..., 3) at points (..., 3) of the sphere, pointing outwards."""
        outwards: Double = (points - np.asarray(self.centre)) / self.radius
        return outwards

    def heights(self, points: Double) -> Double:
        """Distances of points (..., 3) from the sphere, negative within it."""
        distance = np.linalg.norm(points - np.asarray(self.centre), axis=-1)
        return np.asarray(distance - self.radius)

    def depths(self, origin: Double, rays: Double) -> Double:
        """Depths at which rays (N, 3) from outside meet the sphere, infinite where they don't."""
        centre = np.asarray(self.centre) - origin
        squared_length, along = (rays**2).sum(1), rays @ centre
        power = centre @ centre - self.radius**2
        chord = along**2 - squared_length * power
        met = (chord > 0) & (along > 0)
        depth = np.full(len(rays), np.inf)
        depth[met] = power / (along[met] + np.sqrt(chord[met]))
        return depth

    def hides(self, first: Double, second: Double) -> NDArray[np.bool_]:
        """Whether it stands between points (n_1, 3) and (n_2, 3) outside it: bool (n_1, n_2)."""
        centre = np.asarray(self.centre)
        start = first - centre
        length, along, squared = (np.zeros((len(first), len(second))) for _ in range(3))
        for axis in range(3):
            way = second[:, axis] - first[:, axis, None]
            length += way**2
            along -= start[:, axis, None] * way
        place = np.clip(along / np.maximum(length, np.finfo(np.float64).tiny), 0, 1)
        for axis in range(3):
            way = second[:, axis] - first[:, axis, None]
            squared += (start[:, axis, None] + place * way) ** 2
        through: NDArray[np.bool_] = squared < ((1 - GRAZING) * self.radius) ** 2
        return through

    def classify_between(self, first: Double, second: Double, radius: Double) -> NDArray[np.int8]:
        """Prove pairs of clusters wholly visible or wholly hidden behind it, as `classify` does.

        Parameters
        ----------
        first, second
            float64 (n, 3): centres of the clusters, all of whose points lie outside.
        radius
            float64 (n,): of the larger cluster; no segment between the clusters strays farther
            than that from the one between their centres.
        """
        start, way = first - np.asarray(self.centre), second - first
        length = np.maximum((way**2).sum(1), np.finfo(np.float64).tiny)
        place = np.clip(-(start * way).sum(1) / length, 0, 1)
        distance = np.linalg.norm(start + place[:, None] * way, axis=1)
        clear = distance >= self.radius + radius
        behind = distance + radius < (1 - 2 * GRAZING) * self.radius
        return np.where(clear, VISIBLE, np.where(behind, HIDDEN, MIXED))

    def classify_facing(self, centres: Double, radius: Double, corners: Double) -> NDArray[np.int8]:
        """Prove clusters of it to face clusters elsewhere, or to be turned away from them.

        Parameters
        ----------
        centres, radius
            float64 (n, 3) and (n,): balls that hold the clusters of the sphere.
        corners
            float64 (n, k, 3): corners of the other clusters.
        """
        ways = corners - np.asarray(self.centre)
        above = np.einsum("nx,nkx->nk", self.normals(centres), ways)
        # the normals of a cluster stray from its centre's by radius / R at most
        spread = radius / self.radius * np.linalg.norm(ways, axis=2).max(1)
        facing = above.min(1) - spread > (1 + GRAZING) * self.radius
        away = above.max(1) + spread < (1 - GRAZING) * self.radius
        return np.where(facing, VISIBLE, np.where(away, HIDDEN, MIXED))
