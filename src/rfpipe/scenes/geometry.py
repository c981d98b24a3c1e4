"""Surfaces in front of pinholes, and the points of them that pixels see.

Lengths are in scene units: x to the right, y down, z ahead of the camera, which is a pinhole at the
origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.pinhole import Pinhole, Vector
from rfpipe.scenes.visibility import Occluder, Sphere

Double = NDArray[np.float64]

_PARALLEL = 1e-6  # 1 - cos of the opening below which planes count as facing, not as a crease


@dataclass(frozen=True)
class Plane:
    """A plane that bounds the room in which the camera stands.

    Parameters
    ----------
    name
        What the plane is called in descriptions and errors.
    point
        A point of the plane.
    normal
        Direction towards the camera's side, of any length.
    """

    name: str
    point: Vector
    normal: Vector

    @property
    def unit_normal(self) -> Double:
        """Normal of length 1, float64 (3,)."""
        normal = np.asarray(self.normal, dtype=np.float64)
        unit: Double = normal / np.linalg.norm(normal)
        return unit

    def heights(self, points: Double) -> Double:
        """Signed distances of points (..., 3) from the plane, positive on the camera's side."""
        distance: Double = (points - np.asarray(self.point)) @ self.unit_normal
        return distance

    def normals(self, points: Double) -> Double:
        """Unit normals (..., 3) at points (..., 3) of the plane."""
        return np.broadcast_to(self.unit_normal, points.shape)

    def depths(self, origin: Double, rays: Double) -> Double:
        """Depths at which rays (N, 3) meet the plane's front, infinite where they don't."""
        depth = np.full(len(rays), np.inf)
        towards = rays @ self.unit_normal  # negative: the ray runs against the front side
        reach = (np.asarray(self.point) - origin) @ self.unit_normal
        np.divide(reach, towards, out=depth, where=towards < 0)
        return depth

    def axes(self) -> Double:
        """Two orthogonal unit vectors in the plane, float64 (2, 3)."""
        normal = self.unit_normal
        least = np.eye(3)[np.argmin(np.abs(normal))]
        first = np.cross(normal, least)
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(normal, first)])


@dataclass(frozen=True)
class Rectangle:
    """An opaque rectangle in the room that reflects on its front; its back is black.

    Parameters
    ----------
    name
        What it is called in descriptions and errors.
    centre
        Scene units.
    edge_u, edge_v
        From the centre to the middle of two neighbouring edges, scene units, at right angles;
        the front is where ``edge_v x edge_u`` points. Seen from there with edge_u to the right,
        edge_v points down, as the rows of a picture do.
    """

    name: str
    centre: Vector
    edge_u: Vector
    edge_v: Vector

    @property
    def plane(self) -> Plane:
        """The plane in which it lies."""
        normal = np.cross(self.edge_v, self.edge_u)
        return Plane(self.name, self.centre, (float(normal[0]), float(normal[1]), float(normal[2])))

    @property
    def occluder(self) -> Occluder:
        """What it hides."""
        return Occluder(self.centre, self.edge_u, self.edge_v)

    def heights(self, points: Double) -> Double:
        """Signed distances of points (..., 3) from its plane, positive before its front."""
        return self.plane.heights(points)

    def normals(self, points: Double) -> Double:
        """Unit normals (..., 3) of its front at points (..., 3) of it."""
        return self.plane.normals(points)

    def depths(self, origin: Double, rays: Double) -> Double:
        """Depths at which rays (N, 3) meet its front or its back, infinite where they don't."""
        here = self.occluder.coordinates(origin)
        sunk, *along = self.occluder.coordinates(np.asarray(self.centre) + rays).T
        with np.errstate(divide="ignore", invalid="ignore"):  # rays within the rectangle's plane
            depth = -here[0] / sunk
            u, v = (start + depth * part for start, part in zip(here[1:], along, strict=True))
            hit = (depth > 0) & (np.abs(u) <= 1) & (np.abs(v) <= 1)
        return np.where(hit, depth, np.inf)


Surface: TypeAlias = Plane | Rectangle | Sphere


def standing(name: str, centre: Vector, half: tuple[float, float], turned: float) -> Rectangle:
    """Return a rectangle that stands upright.

    Parameters
    ----------
    name, centre
        As of `Rectangle`.
    half
        Half its width and height, scene units.
    turned
        Where it faces, degrees: 0 is towards -z, 90 to the right.
    """
    sine, cosine = _turned(turned)
    across = (half[0] * cosine, 0.0, half[0] * sine)
    return Rectangle(name, centre, across, (0.0, half[1], 0.0))


def lying(name: str, centre: Vector, half: tuple[float, float], turned: float) -> Rectangle:
    """Return a rectangle that lies flat and faces up: half its width and depth; as `standing`."""
    sine, cosine = _turned(turned)
    across = (half[0] * cosine, 0.0, half[0] * sine)
    return Rectangle(name, centre, across, (half[1] * sine, 0.0, -half[1] * cosine))


def block(
    name: str, foot: Vector, *, side: float, height: float, turned: float
) -> tuple[Rectangle, ...]:
    """Return the four sides and the lid of a block with a square base.

    Parameters
    ----------
    name
        Of each of them.
    foot
        The middle of its base, scene units.
    side, height
        Of the base, and of the block, scene units.
    turned
        Where one of its sides faces, as of `standing`.
    """
    x, y, z = foot
    half = side / 2
    sides = []
    for angle in (turned, turned - 90, turned + 90, turned + 180):
        sine, cosine = _turned(angle)
        centre = (x + half * sine, y - height / 2, z - half * cosine)
        sides.append(standing(name, centre, (half, height / 2), angle))
    return (*sides, lying(name, (x, y - height, z), (half, half), turned))


def _turned(degrees: float) -> tuple[float, float]:
    """Sine and cosine of an angle."""
    return float(np.sin(np.radians(degrees))), float(np.cos(np.radians(degrees)))


@dataclass(frozen=True)
class Points:
    """Points of a scene's surfaces, each with the area that it stands for.

    Parameters
    ----------
    surfaces
        The planes and rectangles of the scene, which hide what is behind them, and after them a
        sphere among them, if there is one.
    surface
        int64 (N,): index into `surfaces` of the one on which each point lies.
    positions
        float64 (N, 3), scene units.
    areas
        float64 (N,): scene units squared.
    least_squared_distance
        Lower clamp of the squared distance between two points, scene units squared.
    """

    surfaces: tuple[Surface, ...]
    surface: NDArray[np.int64]
    positions: Double
    areas: Double
    least_squared_distance: float

    @property
    def planes(self) -> tuple[Plane, ...]:
        """The planes of the scene, and those in which its rectangles lie."""
        flat = (each for each in self.surfaces if not isinstance(each, Sphere))
        return tuple(each.plane if isinstance(each, Rectangle) else each for each in flat)

    @property
    def occluders(self) -> tuple[Occluder, ...]:
        """What the scene's rectangles hide."""
        return tuple(each.occluder for each in self.surfaces if isinstance(each, Rectangle))

    @property
    def sphere(self) -> Sphere | None:
        """The sphere among them, or None."""
        last = self.surfaces[-1]
        return last if isinstance(last, Sphere) else None

    @property
    def mean_area(self) -> float:
        """Mean area of a point."""
        return float(self.areas.mean())


def least_squared(surfaces: Sequence[Surface], mean_area: float) -> float:
    """Lower clamp of the squared distance between points that pixels see, scene units squared.

    The mean area; in an acute crease of opening t it is 1 / (2 sin(t / 2)^2) times that: seen
    from its mouth, pixels are long and close to each other there, and their central points
    alone would exchange more light than there is.
    """
    normals = [plane.unit_normal for plane in surfaces if isinstance(plane, Plane)]
    openings = [1 + float(one @ other) for one, other in combinations(normals, 2)]  # 1 - cos t
    acute = min((opening for opening in openings if opening > _PARALLEL), default=1.0)
    return mean_area / min(acute, 1.0)


def surface_points(shape: tuple[int, int], surfaces: Sequence[Surface]) -> Points:
    """Find the point, surface and area that every pixel sees.

    A pixel whose central ray meets several planes at the same distance (the column x = 0 of a
    wedge of odd width) belongs to the one listed first, the left one.

    Parameters
    ----------
    shape
        Height and width of the image in pixels, each at least 1.
    surfaces
        The planes that bound the camera's room, the rectangles in it, and last a sphere, if there
        is one; the nearest surface is seen.

    Returns
    -------
    Points
        In image order: a position is where a pixel's central ray meets its surface, an area is what
        the pixel covers, A = d^2 w / cos(angle), w being its solid angle.

    Raises
    ------
    InputError
        If the shape isn't two positive numbers, a pixel sees none of the surfaces, or another
        than the last surface is a sphere.
    """
    if any(isinstance(surface, Sphere) for surface in surfaces[:-1]):
        raise InputError(
            f"surfaces {', '.join(surface.name for surface in surfaces)}: expected at most one "
            "sphere, the last"
        )
    pinhole = Pinhole(shape)
    sight = sight_of(pinhole, surfaces)
    if (sight.surface < 0).any():
        row, column = np.unravel_index(int(np.argmin(sight.surface)), shape)
        raise InputError(
            f"pixel ({row}, {column}) of a {shape[0]} x {shape[1]} image sees none of the surfaces "
            f"{', '.join(surface.name for surface in surfaces)}; close the room with another plane"
        )
    return Points(
        tuple(surfaces),
        sight.surface,
        sight.positions,
        sight.areas,
        least_squared(surfaces, float(sight.areas.mean())),
    )


@dataclass(frozen=True)
class Sight:
    """Where the rays of a pinhole's pixels, cut into `parts` x `parts`, meet surfaces.

    Parameters
    ----------
    pinhole
        Where the rays come from.
    parts
        Of a pixel along either side, each with a ray.
    rays
        float64 (n, 3): as long as to distance 1 from the pinhole.
    surface
        int64 (n,): the surface that each ray meets first, -1 where it meets none.
    positions, normals
        float64 (n, 3): where it does, and the unit normal there; zero where it meets none.
    areas
        float64 (n,): what the ray's share of a pixel covers there, scene units squared.
    """

    pinhole: Pinhole
    parts: int
    rays: Double
    surface: NDArray[np.int64]
    positions: Double
    normals: Double
    areas: Double

    def moves(self, chosen: NDArray[np.bool_ | np.int64]) -> Double:
        """How far it is from chosen (k,) places to those of the next parts: float64 (k, 2, 3).

        Of the part to the right and the one below, on the tangent plane; scene units.
        """
        rays, points, normals = self.rays[chosen], self.positions[chosen], self.normals[chosen]
        depth = (points - self.pinhole.origin) @ self.pinhole.axes[2]
        steps = self.pinhole.axes[:2] * self.pinhole.pitch / self.parts  # on the image plane
        # a ray that turns by a step meets the tangent plane so much farther on
        farther = (normals @ steps.T) / (rays * normals).sum(1)[:, None]
        moved: Double = depth[:, None, None] * (steps - farther[..., None] * rays[:, None])
        return moved


def sight_of(pinhole: Pinhole, surfaces: Sequence[Surface], parts: int = 1) -> Sight:
    """Follow the rays of a pinhole's pixels, cut into `parts` x `parts`, to the nearest surfaces.

    Planes bound the pinhole's room: they are seen from the front alone.
    """
    rays, pitch = pinhole.rays(parts), pinhole.pitch / parts
    depths = np.stack([surface.depths(pinhole.origin, rays) for surface in surfaces])
    surface = np.argmin(depths, axis=0)  # the first of equals
    depth = depths[surface, np.arange(len(rays))]
    missed = ~np.isfinite(depth)
    surface[missed], depth[missed] = -1, 0
    positions = pinhole.origin + rays * depth[:, None]
    positions[missed] = 0
    normals = np.zeros_like(rays)
    for index, each in enumerate(surfaces):
        on = surface == index
        normals[on] = each.normals(positions[on])
    squared_length = (rays**2).sum(1)
    solid_angle = pitch**2 / squared_length**1.5
    cosine = -(rays * normals).sum(1) / np.sqrt(squared_length)
    for index, each in enumerate(surfaces):
        if isinstance(each, Sphere):
            # the mean over the outermost pixel of a disc, whose central ray may run along the limb
            on = surface == index
            cosine[on] = np.maximum(cosine[on], np.sqrt(pitch * depth[on] / (2 * each.radius)))
    cosine[missed] = 1
    areas = solid_angle * squared_length * depth**2 / cosine
    return Sight(pinhole, parts, rays, surface, positions, normals, areas)


def overlaps(
    place: Double, width: Double
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Double]:
    """Share boxes (n, 2), by their centres and widths, out between cells of side 1 from 0 on.

    Returns
    -------
    box, row, column, share
        Of each cell that a box overlaps; the shares of a box add up to 1.
    """
    low, width = place - width / 2, np.maximum(width, 1e-6)
    first = np.floor(low).astype(np.int64)
    parts = []
    for axis in (0, 1):
        cell = first[:, axis, None] + np.arange(int(np.ceil(width[:, axis].max())) + 1)
        start, end = low[:, axis, None], (low + width)[:, axis, None]
        overlap = np.minimum(end, cell + 1) - np.maximum(start, cell)
        parts.append(np.maximum(overlap, 0) / width[:, axis, None])
    share = parts[0][:, :, None] * parts[1][:, None]
    box, down, right = np.nonzero(share > 1e-9)  # a smaller overlap is rounding
    return box, first[box, 0] + down, first[box, 1] + right, share[box, down, right]
