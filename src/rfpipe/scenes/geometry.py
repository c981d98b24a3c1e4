"""Surfaces in front of a pinhole camera, and the points of them that its pixels see.

Lengths are in scene units. The camera, which shares its rays with the projector, is a pinhole at
the origin that looks along +z; its image plane at z = 1 spans -0.5 to 0.5 along the image's short
side and its pixels are square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

__all__ = ["Plane", "Points", "Sphere", "Surface", "SurfacePoints", "surface_points"]

Vector = tuple[float, float, float]

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
    def unit_normal(self) -> NDArray[np.float64]:
        """Normal of length 1, float64 (3,)."""
        normal = np.asarray(self.normal, dtype=np.float64)
        unit: NDArray[np.float64] = normal / np.linalg.norm(normal)
        return unit

    def heights(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distances of points (..., 3) from the plane, positive on the camera's side."""
        distance: NDArray[np.float64] = (points - np.asarray(self.point)) @ self.unit_normal
        return distance

    def axes(self) -> NDArray[np.float64]:
        """Two orthogonal unit vectors in the plane, float64 (2, 3)."""
        normal = self.unit_normal
        least = np.eye(3)[np.argmin(np.abs(normal))]
        first = np.cross(normal, least)
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(normal, first)])


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

    def normals(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Unit normals (..., 3) at points (..., 3) of the sphere, pointing outwards."""
        outwards: NDArray[np.float64] = (points - np.asarray(self.centre)) / self.radius
        return outwards


Surface: TypeAlias = Plane | Sphere


@dataclass(frozen=True)
class Points:
    """Points of a scene's surfaces, each with the area that it stands for.

    Parameters
    ----------
    planes
        The planes of the scene.
    surface
        int64 (N,): index into `planes` of the plane on which each point lies; their number for
        points of the sphere.
    positions
        float64 (N, 3), scene units.
    areas
        float64 (N,): scene units squared.
    sphere
        A sphere among the planes, or None.
    """

    planes: tuple[Plane, ...]
    surface: NDArray[np.int64]
    positions: NDArray[np.float64]
    areas: NDArray[np.float64]
    sphere: Sphere | None = field(default=None, kw_only=True)

    @property
    def mean_area(self) -> float:
        """Mean area of a point."""
        return float(self.areas.mean())

    @property
    def least_squared_distance(self) -> float:
        """Lower clamp of the squared distance between two points: the mean area."""
        return self.mean_area


@dataclass(frozen=True)
class SurfacePoints(Points):
    """The points that the pixels of a pinhole camera see, in image order.

    A position is where a pixel's central ray meets its plane; an area is what the pixel covers,
    A = d^2 w / cos(angle), with w the pixel's solid angle seen from the pinhole.

    Parameters
    ----------
    shape
        Height and width of the image, H x W = N pixels.
    """

    shape: tuple[int, int]

    @property
    def least_squared_distance(self) -> float:
        """Lower clamp of the squared distance between two points, scene units squared.

        The mean area; in an acute crease of opening t it is 1 / (2 sin(t / 2)^2) times that: seen
        from its mouth, pixels are long and close to each other there, and their central points
        alone would exchange more light than there is.
        """
        normals = [plane.unit_normal for plane in self.planes]
        openings = [1 + float(one @ other) for one, other in combinations(normals, 2)]  # 1 - cos t
        acute = min((opening for opening in openings if opening > _PARALLEL), default=1.0)
        return self.mean_area / min(acute, 1.0)


def surface_points(shape: tuple[int, int], surfaces: Sequence[Surface]) -> SurfacePoints:
    """Find the point, surface and area that every pixel sees.

    A pixel whose central ray meets several planes at the same distance (the column x = 0 of a
    wedge of odd width) belongs to the one listed first, the left one.

    Parameters
    ----------
    shape
        Height and width of the image in pixels, each at least 1.
    surfaces
        The planes that bound the camera's room, and after them a sphere in it, if there is one;
        the nearest surface is seen.

    Returns
    -------
    SurfacePoints

    Raises
    ------
    InputError
        If the shape isn't two positive numbers, a pixel sees none of the surfaces, or another
        than the last surface is a sphere.
    """
    if len(shape) != 2 or min(shape) < 1:
        raise InputError(
            f"scene shape {tuple(shape)}: expected height and width in pixels, each at least 1"
        )
    planes = tuple(surface for surface in surfaces if isinstance(surface, Plane))
    sphere = surfaces[-1] if isinstance(surfaces[-1], Sphere) else None
    if len(planes) + (sphere is not None) != len(surfaces):
        raise InputError(
            f"surfaces {', '.join(surface.name for surface in surfaces)}: expected planes, and at "
            "most one sphere, the last"
        )
    height, width = shape
    pitch = 1 / min(shape)
    rays = _rays(height, width, pitch)
    depths = [_depth_of_plane(plane, rays) for plane in planes]
    depths += [] if sphere is None else [_depth_of_sphere(sphere, rays)]
    surface = np.argmin(depths, axis=0)  # the first of equals
    depth = np.stack(depths)[surface, np.arange(len(rays))]
    if not np.isfinite(depth).all():
        row, column = np.unravel_index(int(np.argmin(np.isfinite(depth))), shape)
        raise InputError(
            f"pixel ({row}, {column}) of a {height} x {width} image sees none of the surfaces "
            f"{', '.join(surface.name for surface in surfaces)}; close the room with another plane"
        )
    positions = rays * depth[:, None]

    squared_length = (rays**2).sum(1)
    solid_angle = pitch**2 / squared_length**1.5
    normals = np.zeros_like(rays)
    for index, plane in enumerate(planes):
        normals[surface == index] = plane.unit_normal
    on_sphere = surface == len(planes)
    if sphere is not None:
        normals[on_sphere] = sphere.normals(positions[on_sphere])
    cosine = -(rays * normals).sum(1) / np.sqrt(squared_length)
    if sphere is not None:
        # the mean over the outermost pixel of a disc, whose central ray may run along the limb
        limb = np.sqrt(pitch * depth[on_sphere] / (2 * sphere.radius))
        cosine[on_sphere] = np.maximum(cosine[on_sphere], limb)
    areas = solid_angle * squared_length * depth**2 / cosine
    return SurfacePoints(planes, surface, positions, areas, (height, width), sphere=sphere)


def _rays(height: int, width: int, pitch: float) -> NDArray[np.float64]:
    """Central rays of the pixels, (H W, 3), as long as they are at z = 1."""
    image_plane = np.ones((height, width, 3))
    image_plane[..., 0] = (np.arange(width) + 0.5 - width / 2) * pitch
    image_plane[..., 1] = ((np.arange(height) + 0.5 - height / 2) * pitch)[:, None]
    return image_plane.reshape(-1, 3)


def _depth_of_plane(plane: Plane, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth z at which rays (N, 3) meet the front of a plane, infinite where they don't."""
    depth = np.full(len(rays), np.inf)
    towards = rays @ plane.unit_normal  # negative: the ray runs against the front side
    reach = np.asarray(plane.point) @ plane.unit_normal
    np.divide(reach, towards, out=depth, where=towards < 0)
    return depth


def _depth_of_sphere(sphere: Sphere, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth z at which rays (N, 3) from outside meet a sphere, infinite where they don't."""
    centre = np.asarray(sphere.centre)
    squared_length, along = (rays**2).sum(1), rays @ centre
    power = centre @ centre - sphere.radius**2
    chord = along**2 - squared_length * power
    met = (chord > 0) & (along > 0)
    depth = np.full(len(rays), np.inf)
    depth[met] = power / (along[met] + np.sqrt(chord[met]))
    return depth
