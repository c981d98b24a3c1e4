"""Surfaces of a room, and what hides them from each other.

Lengths are in scene units: x to the right, y down, z ahead of the camera, a pinhole at the origin.

An occluder and a sphere tell what they hide in coordinates of their own, so that those of a point
are taken once. A parallelogram is s = 0, |u| <= 1, |v| <= 1 of affine coordinates (s, u, v), with
``centre + s n + u edge_u + v edge_v`` and n the unit normal; a segment between its two sides
crosses it at ``u = (u_1 s_2 - u_2 s_1) / (s_2 - s_1)``, likewise v, the same to the last bit when
the two ends change places. A sphere is the unit sphere of its own. A cluster of points stands for
the convex hull of k corners.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Double = NDArray[np.float64]
Vector = tuple[float, float, float]

# Fraction of a segment at either end in which it can't be blocked, and relative depth below a
# sphere's surface above which it isn't hidden: surfaces aren't hidden by what they touch.
_END, _GRAZING = 1e-9, 1e-9
_MARGIN = 1e-9  # relative margin by which a whole cluster must be clear, against rounding

# What two clusters can be to each other; `MIXED` where neither is proved of all their points.
HIDDEN, VISIBLE, MIXED = np.int8(0), np.int8(1), np.int8(2)


@dataclass(frozen=True)
class Plane:
    """A plane that bounds the room: one of its points, and a direction to the camera's side."""

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
        """Depths at which rays (N, 3) meet the plane's front, infinite where they don't."""
        depth = np.full(len(rays), np.inf)
        towards = rays @ self.unit_normal  # negative: the ray runs against the front side
        np.divide(-self.heights(origin), towards, out=depth, where=towards < 0)
        return depth


@dataclass(frozen=True)
class Occluder:
    """A black parallelogram that blocks light between surfaces and the camera's own view.

    `edge_u` and `edge_v` go from its centre to the middle of two neighbouring edges.
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
        """Whether it stands between points, given their coordinates (..., 3), which broadcast."""
        s_1, u_1, v_1 = np.moveaxis(first, -1, 0)
        s_2, u_2, v_2 = np.moveaxis(second, -1, 0)
        span = np.abs(s_2 - s_1)
        apart = np.minimum(np.abs(s_1), np.abs(s_2)) > _END * span
        # |u| <= 1 at the crossing, without a division by a span that may be zero
        across = np.abs(u_1 * s_2 - u_2 * s_1) <= span
        along = np.abs(v_1 * s_2 - v_2 * s_1) <= span
        return np.asarray((s_1 * s_2 < 0) & apart & across & along)

    def classify(self, first: Double, second: Double) -> NDArray[np.int8]:
        """What clusters (n, k, 3) in its coordinates are to each other: int8 (n,).

        Lines between hulls on opposite sides of the occluder cross it in the convex hull of the
        corners' crossings, so that bounds of these bound all of them.
        """
        both = np.concatenate([first, second], axis=1)
        low, high = both.min(1), both.max(1)
        clear = (low[:, 0] >= 0) | (high[:, 0] <= 0) | _beside(low[:, 1:], high[:, 1:])
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
            verdict[todo[_beside(low, high)]] = VISIBLE
            verdict[todo[((low > -1 + _MARGIN) & (high < 1 - _MARGIN)).all(1)]] = HIDDEN
        return verdict


def _beside(low: Double, high: Double) -> NDArray[np.bool_]:
    """Whether bounds (n, 2) of u and v lie beyond a parallelogram."""
    return np.asarray((low > 1 + _MARGIN).any(1) | (high < -1 - _MARGIN).any(1))


@dataclass(frozen=True)
class Rectangle(Occluder):
    """An opaque rectangle in the room that reflects on its front; its back is black.

    The front is where ``edge_v x edge_u`` points. Seen from there with edge_u to the right, edge_v
    points down, as the rows of a picture do.
    """

    name: str

    @property
    def plane(self) -> Plane:
        """The plane in which it lies."""
        return Plane(self.name, self.centre, vector(np.cross(self.edge_v, self.edge_u)))

    def heights(self, points: Double) -> Double:
        """Signed distances of points (..., 3) from its plane, positive before its front."""
        return self.plane.heights(points)

    def normals(self, points: Double) -> Double:
        """Unit normals (..., 3) of its front at points (..., 3) of it."""
        return self.plane.normals(points)

    def depths(self, origin: Double, rays: Double) -> Double:
        """Depths at which rays (N, 3) meet its front or its back, infinite where they don't."""
        here = self.coordinates(origin)
        along = self.coordinates(np.asarray(self.centre) + rays)
        with np.errstate(divide="ignore", invalid="ignore"):  # rays within the rectangle's plane
            depth = -here[0] / along[:, 0]
            within = np.abs(here[1:] + depth[:, None] * along[:, 1:]) <= 1
        return np.where((depth > 0) & within.all(1), depth, np.inf)


@dataclass(frozen=True)
class Sphere:
    """An opaque sphere in the room, seen from outside."""

    name: str
    centre: Vector
    radius: float

    def coordinates(self, points: Double) -> Double:
        """Points (..., 3) about its centre, in units of its radius."""
        return np.asarray((points - np.asarray(self.centre)) / self.radius)

    normals = coordinates  # of points of the sphere, pointing outwards

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

    def blocks(self, first: Double, second: Double) -> NDArray[np.bool_]:
        """Whether it stands between points outside it, given as to `Occluder.blocks`."""
        hidden: NDArray[np.bool_] = _distance(first, second) < 1 - _GRAZING
        return hidden

    def classify(self, first: Double, second: Double) -> NDArray[np.int8]:
        """What clusters outside it are to each other, as `Occluder.classify`."""
        (one, radius_1), (two, radius_2) = _ball(first), _ball(second)
        # no segment strays farther than this from the one between the centres
        distance, radius = _distance(one, two), np.maximum(radius_1, radius_2)
        behind = distance + radius < 1 - 2 * _GRAZING
        return np.where(distance >= 1 + radius, VISIBLE, np.where(behind, HIDDEN, MIXED))

    def facing(self, own: Double, others: Double) -> NDArray[np.int8]:
        """What clusters (n, k, 3) of the sphere itself are to others, behind its own bulge.

        A point of the sphere sees what lies above its tangent plane.
        """
        centre, radius = _ball(own)
        above = np.einsum("nx,nkx->nk", centre, others)
        spread = radius * np.linalg.norm(others, axis=2).max(1)  # by which normals differ
        faces = above.min(1) - spread > 1 + _GRAZING
        away = above.max(1) + spread < 1 - _GRAZING
        return np.where(faces, VISIBLE, np.where(away, HIDDEN, MIXED))


Surface: TypeAlias = Plane | Rectangle | Sphere
Hider: TypeAlias = Occluder | Sphere


def _distance(first: Double, second: Double) -> Double:
    """Distance of the origin from segments between points (..., 3)."""
    way = second - first
    length = np.maximum((way**2).sum(-1), np.finfo(np.float64).tiny)
    place = np.clip(-(first * way).sum(-1) / length, 0, 1)
    return np.asarray(np.linalg.norm(first + place[..., None] * way, axis=-1))


def _ball(corners: Double) -> tuple[Double, Double]:
    """Centres (n, 3) and radii (n,) of balls that hold clusters (n, k, 3)."""
    centre = corners.mean(1)
    return centre, np.linalg.norm(corners - centre[:, None], axis=2).max(1)


def is_hidden(first: Double, second: Double, hiders: Iterable[Hider]) -> NDArray[np.bool_]:
    """Whether any hider stands between points (..., 3), which broadcast: bool (...)."""
    hidden = np.zeros(np.broadcast_shapes(first.shape, second.shape)[:-1], np.bool_)
    for each in hiders:
        hidden |= each.blocks(each.coordinates(first), each.coordinates(second))
    return hidden


def rotation(axis: int, degrees: float) -> Double:
    """Matrix (3, 3) that turns y to z, z to x or x to y, about axis 0, 1 or 2."""
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    one, other = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[one, other], [one, other]] = cosine
    matrix[other, one], matrix[one, other] = sine, -sine
    return matrix


def vector(values: Double) -> Vector:
    """Return three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def standing(name: str, centre: Vector, half: tuple[float, float], turned: float) -> Rectangle:
    """Return an upright rectangle of half its width and height, scene units.

    `turned` says where it faces, degrees: 0 is towards -z, 90 to the right.
    """
    across = rotation(1, -turned)[:, 0] * half[0]
    return Rectangle(centre, vector(across), (0.0, half[1], 0.0), name)


def lying(name: str, centre: Vector, half: tuple[float, float], turned: float) -> Rectangle:
    """Return a rectangle that faces up, of half its width and depth; as `standing`."""
    across, _, ahead = rotation(1, -turned).T
    return Rectangle(centre, vector(across * half[0]), vector(-ahead * half[1]), name)


def block(
    name: str, foot: Vector, *, side: float, height: float, turned: float
) -> tuple[Rectangle, ...]:
    """Return the four sides and the lid of a block whose square base has its middle at `foot`.

    `turned` says where one of its sides faces, as of `standing`.
    """
    x, y, z = foot
    half = side / 2
    sides = []
    for angle in (turned, turned - 90, turned + 90, turned + 180):
        ahead = rotation(1, -angle)[:, 2] * half
        centre = vector(np.array([x, y - height / 2, z]) - ahead)
        sides.append(standing(name, centre, (half, height / 2), angle))
    return (*sides, lying(name, (x, y - height, z), (half, half), turned))
