"""Surfaces of a scene, and occlusion between them.

Lengths are in scene units: x to the right, y down, z ahead of the camera at the origin.

Occlusion by an obstruction is computed in its local coordinates, to which points are transformed
once. A parallelogram is s = 0, |u| <= 1, |v| <= 1 in affine coordinates (s, u, v) of a point
``centre + s n + u edge_u + v edge_v``, with the unit normal n. A segment between its two sides
crosses it at ``u = (u_1 s_2 - u_2 s_1) / (s_2 - s_1)``, likewise v; exchanging the ends gives the
same bits. A sphere is the unit sphere. A cluster of points is represented by the convex hull of k
corners.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double

Vector = tuple[float, float, float]

# Fractions of a segment at its ends that can't be blocked, and relative depth below a sphere's
# surface that isn't occluded, so that touching surfaces don't occlude each other.
_END, _GRAZING = 1e-9, 1e-9
_MARGIN = 1e-9  # relative margin of tests of clusters, for rounding errors

# Visibility between two clusters; `MIXED`: neither is proved for all pairs of points.
OCCLUDED, VISIBLE, MIXED = np.int8(0), np.int8(1), np.int8(2)


@dataclass(frozen=True)
class Plane:
    """A plane that bounds the room: a point, and a normal towards the camera's side."""

    name: str
    point: Vector
    normal: Vector

    @property
    def unit_normal(self) -> Double:
        """Normal of length 1, float64 (3,)."""
        return np.asarray(np.divide(self.normal, np.linalg.norm(self.normal)))

    def heights(self, points: Double) -> Double:
        """Signed distances of points (..., 3), positive on the camera's side."""
        return np.asarray((points - np.asarray(self.point)) @ self.unit_normal)

    def normals(self, points: Double) -> Double:
        """Unit normals (..., 3) at points (..., 3) of the plane."""
        return np.broadcast_to(self.unit_normal, points.shape)

    def depths(self, origin: Double, rays: Double) -> Double:
        """Depths at which rays (N, 3) hit the plane's front; infinite without a hit."""
        depth = np.full(len(rays), np.inf)
        towards = rays @ self.unit_normal  # negative for rays towards the front
        np.divide(-self.heights(origin), towards, out=depth, where=towards < 0)
        return depth


@dataclass(frozen=True)
class Occluder:
    """A black parallelogram that blocks light between surfaces, and the camera's view.

    `edge_u` and `edge_v` point from its centre to the midpoints of two adjacent edges.
    """

    centre: Vector
    edge_u: Vector
    edge_v: Vector

    def coordinates(self, points: Double) -> Double:
        """Affine coordinates (s, u, v) of points (..., 3), float64 of the same shape."""
        normal = np.cross(self.edge_u, self.edge_v)
        normal = normal / np.linalg.norm(normal)
        frame = np.linalg.inv(np.stack([normal, self.edge_u, self.edge_v], axis=1))
        return np.asarray((points - np.asarray(self.centre)) @ frame.T)

    def blocks(self, first: Double, second: Double) -> NDArray[np.bool_]:
        """Test whether it blocks segments between points, given by coordinates (..., 3)."""
        s_1, u_1, v_1 = np.moveaxis(first, -1, 0)
        s_2, u_2, v_2 = np.moveaxis(second, -1, 0)
        span = np.abs(s_2 - s_1)
        apart = np.minimum(np.abs(s_1), np.abs(s_2)) > _END * span
        # |u| <= 1 at the crossing, without a division by a span that may be zero
        across = np.abs(u_1 * s_2 - u_2 * s_1) <= span
        along = np.abs(v_1 * s_2 - v_2 * s_1) <= span
        return np.asarray((s_1 * s_2 < 0) & apart & across & along)

    def classify(self, first: Double, second: Double) -> NDArray[np.int8]:
        """Visibility between clusters (n, k, 3), given by local coordinates: int8 (n,).

        Segments between hulls on opposite sides cross the occluder's plane in the convex hull of
        the crossings of segments between corners, so bounds of the latter suffice.
        """
        corners = np.concatenate([first, second], axis=1)
        low, high = corners.min(1), corners.max(1)
        clear = (low[:, 0] >= 0) | (high[:, 0] <= 0) | _is_outside(low[:, 1:], high[:, 1:])
        verdict: NDArray[np.int8] = np.where(clear, VISIBLE, MIXED)
        margin = _MARGIN * (high[:, 0] - low[:, 0])
        s_1, s_2 = first[..., 0], second[..., 0]
        opposite = (s_1.max(1) < -margin) & (s_2.min(1) > margin)
        opposite |= (s_1.min(1) > margin) & (s_2.max(1) < -margin)
        todo = np.flatnonzero(opposite & ~clear)
        if len(todo):
            p, q = first[todo][:, :, None], second[todo][:, None]
            s_p, s_q = p[..., :1], q[..., :1]
            crossing = (p[..., 1:] * s_q - q[..., 1:] * s_p) / (s_q - s_p)
            low, high = crossing.min((1, 2)), crossing.max((1, 2))
            verdict[todo[_is_outside(low, high)]] = VISIBLE
            verdict[todo[((low > -1 + _MARGIN) & (high < 1 - _MARGIN)).all(1)]] = OCCLUDED
        return verdict


def _is_outside(low: Double, high: Double) -> NDArray[np.bool_]:
    """Test whether bounds (n, 2) of u and v are outside the parallelogram."""
    return np.asarray((low > 1 + _MARGIN).any(1) | (high < -1 - _MARGIN).any(1))


@dataclass(frozen=True)
class Rectangle(Occluder):
    """An opaque rectangle with a reflecting front and a black back.

    The front faces in the direction of ``edge_v x edge_u``. Seen from the front, with edge_u to the
    right, edge_v points down, in the order of a picture's rows.
    """

    name: str

    @property
    def plane(self) -> Plane:
        """The plane of the rectangle."""
        return Plane(self.name, self.centre, vector(np.cross(self.edge_v, self.edge_u)))

    def heights(self, points: Double) -> Double:
        """Signed distances of points (..., 3) from its plane, positive on the front side."""
        return self.plane.heights(points)

    def normals(self, points: Double) -> Double:
        """Unit normals (..., 3) of the front at points (..., 3) of the rectangle."""
        return self.plane.normals(points)

    def depths(self, origin: Double, rays: Double) -> Double:
        """Depths at which rays (N, 3) hit the front or back; infinite without a hit."""
        start = self.coordinates(origin)
        along = self.coordinates(np.asarray(self.centre) + rays)
        with np.errstate(divide="ignore", invalid="ignore"):  # rays within the rectangle's plane
            depth = -start[0] / along[:, 0]
            inside = np.abs(start[1:] + depth[:, None] * along[:, 1:]) <= 1
        return np.where((depth > 0) & inside.all(1), depth, np.inf)


@dataclass(frozen=True)
class Sphere:
    """An opaque sphere, seen from outside."""

    name: str
    centre: Vector
    radius: float

    def coordinates(self, points: Double) -> Double:
        """Points (..., 3) relative to the centre, in units of the radius."""
        return np.asarray((points - np.asarray(self.centre)) / self.radius)

    normals = coordinates  # outward unit normals at points of the sphere

    def heights(self, points: Double) -> Double:
        """Distances of points (..., 3) from the sphere, negative within it."""
        distance = np.linalg.norm(points - np.asarray(self.centre), axis=-1)
        return np.asarray(distance - self.radius)

    def depths(self, origin: Double, rays: Double) -> Double:
        """Depths at which rays (N, 3) from outside hit the sphere; infinite without a hit."""
        centre = np.asarray(self.centre) - origin
        squared_length, along = (rays**2).sum(1), rays @ centre
        power = centre @ centre - self.radius**2
        chord = along**2 - squared_length * power
        hit = (chord > 0) & (along > 0)
        depth = np.full(len(rays), np.inf)
        depth[hit] = power / (along[hit] + np.sqrt(chord[hit]))
        return depth

    def blocks(self, first: Double, second: Double) -> NDArray[np.bool_]:
        """Test whether it blocks segments between points outside it; see `Occluder.blocks`."""
        occluded: NDArray[np.bool_] = _distance(first, second) < 1 - _GRAZING
        return occluded

    def classify(self, first: Double, second: Double) -> NDArray[np.int8]:
        """Visibility between clusters outside it; see `Occluder.classify`."""
        (centre_1, radius_1), (centre_2, radius_2) = _ball(first), _ball(second)
        # largest distance of a segment from the one between the centres
        distance, radius = _distance(centre_1, centre_2), np.maximum(radius_1, radius_2)
        blocked = distance + radius < 1 - 2 * _GRAZING
        return np.where(distance >= 1 + radius, VISIBLE, np.where(blocked, OCCLUDED, MIXED))

    def facing(self, on_sphere: Double, clusters: Double) -> NDArray[np.int8]:
        """Visibility between clusters (n, k, 3) on the sphere and outside it, by its curvature.

        A point of the sphere sees points above its tangent plane.
        """
        centre, radius = _ball(on_sphere)
        above = np.einsum("nx,nkx->nk", centre, clusters)
        spread = radius * np.linalg.norm(clusters, axis=2).max(1)  # due to differing normals
        faces = above.min(1) - spread > 1 + _GRAZING
        away = above.max(1) + spread < 1 - _GRAZING
        return np.where(faces, VISIBLE, np.where(away, OCCLUDED, MIXED))


Surface: TypeAlias = Plane | Rectangle | Sphere
Obstruction: TypeAlias = Occluder | Sphere


def _distance(first: Double, second: Double) -> Double:
    """Distance of the origin from segments between points (..., 3)."""
    segment = second - first
    length = np.maximum((segment**2).sum(-1), np.finfo(np.float64).tiny)
    nearest = np.clip(-(first * segment).sum(-1) / length, 0, 1)
    return np.asarray(np.linalg.norm(first + nearest[..., None] * segment, axis=-1))


def _ball(corners: Double) -> tuple[Double, Double]:
    """Centres (n, 3) and radii (n,) of bounding balls of clusters (n, k, 3)."""
    centre = corners.mean(1)
    return centre, np.linalg.norm(corners - centre[:, None], axis=2).max(1)


def is_occluded(
    first: Double, second: Double, obstructions: Iterable[Obstruction]
) -> NDArray[np.bool_]:
    """Test whether an obstruction is between points (..., 3), which broadcast: bool (...)."""
    occluded = np.zeros(np.broadcast_shapes(first.shape, second.shape)[:-1], np.bool_)
    for item in obstructions:
        occluded |= item.blocks(item.coordinates(first), item.coordinates(second))
    return occluded


def rotation(axis: int, degrees: float) -> Double:
    """Rotation matrix (3, 3) from y to z, z to x or x to y, about axis 0, 1 or 2."""
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[i, j], [i, j]] = cosine
    matrix[j, i], matrix[i, j] = sine, -sine
    return matrix


def vector(values: Double) -> Vector:
    """Convert three numbers to a tuple of float."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def upright(name: str, centre: Vector, half: tuple[float, float], turned: float) -> Rectangle:
    """Create a vertical rectangle from half its width and height, in scene units.

    `turned` is the direction of its front in degrees: 0 is towards -z, 90 to the right.
    """
    across = rotation(1, -turned)[:, 0] * half[0]
    return Rectangle(centre, vector(across), (0.0, half[1], 0.0), name)


def horizontal(name: str, centre: Vector, half: tuple[float, float], turned: float) -> Rectangle:
    """Create a rectangle that faces up from half its width and depth; see `upright`."""
    across, _, ahead = rotation(1, -turned).T
    return Rectangle(centre, vector(across * half[0]), vector(-ahead * half[1]), name)


def block(
    name: str, foot: Vector, *, side: float, height: float, turned: float
) -> tuple[Rectangle, ...]:
    """Create the four sides and the top of a block with a square base, centred at `foot`.

    `turned` is the direction of one of its sides, see `upright`.
    """
    x, y, z = foot
    half = side / 2
    sides = []
    for angle in (turned, turned - 90, turned + 90, turned + 180):
        ahead = rotation(1, -angle)[:, 2] * half
        centre = vector(np.array([x, y - height / 2, z]) - ahead)
        sides.append(upright(name, centre, (half, height / 2), angle))
    return (*sides, horizontal(name, (x, y - height, z), (half, half), turned))
