"""Planes in front of a pinhole camera, and the surface points that its pixels see.

Lengths are in scene units. The camera, which shares its rays with the projector, is a pinhole at
the origin that looks along +z; its image plane at z = 1 spans -0.5 to 0.5 along the image's short
side and its pixels are square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

__all__ = ["GEOMETRIES", "Plane", "Points", "SurfacePoints", "surface_points"]

Vector = tuple[float, float, float]


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


# The camera's room as the planes that bound it: each pixel sees the nearest one.
GEOMETRIES: dict[str, tuple[Plane, ...]] = {
    "plane": (Plane("front", (0, 0, 3), (0, 0, -1)),),
    "wedge": (
        Plane("left", (0, 0, 3), (1, 0, -1)),  # z = 3 + x
        Plane("right", (0, 0, 3), (-1, 0, -1)),  # z = 3 - x
    ),
}


@dataclass(frozen=True)
class Points:
    """Points of a scene's surfaces, each with the area that it stands for.

    Parameters
    ----------
    planes
        The planes of the scene.
    surface
        int64 (N,): index into `planes` of the plane on which each point lies.
    positions
        float64 (N, 3), scene units.
    areas
        float64 (N,): scene units squared.
    """

    planes: tuple[Plane, ...]
    surface: NDArray[np.int64]
    positions: NDArray[np.float64]
    areas: NDArray[np.float64]

    @property
    def mean_area(self) -> float:
        """Mean area of a point, and the least squared distance between two."""
        return float(self.areas.mean())


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


def surface_points(shape: tuple[int, int], planes: tuple[Plane, ...]) -> SurfacePoints:
    """Find the point, plane and area that every pixel sees.

    A pixel whose central ray meets several planes at the same distance (the column x = 0 of a
    wedge of odd width) belongs to the one listed first, the left one.

    Parameters
    ----------
    shape
        Height and width of the image in pixels, each at least 1.
    planes
        The planes that bound the camera's room; the nearest one is seen.

    Returns
    -------
    SurfacePoints

    Raises
    ------
    InputError
        If the shape isn't two positive numbers, or a pixel sees none of the planes.
    """
    if len(shape) != 2 or min(shape) < 1:
        raise InputError(
            f"scene shape {tuple(shape)}: expected height and width in pixels, each at least 1"
        )
    height, width = shape
    pitch = 1 / min(shape)
    x = (np.arange(width) + 0.5 - width / 2) * pitch
    y = (np.arange(height) + 0.5 - height / 2) * pitch
    image_plane = np.ones((height, width, 3))
    image_plane[..., 0], image_plane[..., 1] = x, y[:, None]
    rays = image_plane.reshape(-1, 3)

    depths = np.full((len(planes), len(rays)), np.inf)
    for depth, plane in zip(depths, planes, strict=True):
        towards = rays @ plane.unit_normal  # negative: the ray runs against the front side
        reach = np.asarray(plane.point) @ plane.unit_normal
        np.divide(reach, towards, out=depth, where=towards < 0)
    surface = np.argmin(depths, axis=0)  # the first of equals
    depth = depths[surface, np.arange(len(rays))]
    if not np.isfinite(depth).all():
        row, column = np.unravel_index(int(np.argmin(np.isfinite(depth))), shape)
        raise InputError(
            f"pixel ({row}, {column}) of a {height} x {width} image sees none of the planes "
            f"{', '.join(plane.name for plane in planes)}; close the room with another plane"
        )
    positions = rays * depth[:, None]

    squared_length = (rays**2).sum(1)
    solid_angle = pitch**2 / squared_length**1.5
    normals = np.stack([plane.unit_normal for plane in planes])[surface]
    cosine = -(rays * normals).sum(1) / np.sqrt(squared_length)
    areas = solid_angle * squared_length * depth**2 / cosine
    return SurfacePoints(planes, surface, positions, areas, (height, width))
