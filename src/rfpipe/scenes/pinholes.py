"""Pinhole cameras and projectors, and the surface points that their pixels see.

Lengths are in scene units. In diffuse scenes, x is to the right, y down and z ahead of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.errors import InputError
from rfpipe.scenes.surfaces import Plane, Sphere, Surface, Vector

_PARALLEL = 1e-6  # smallest 1 - cos(opening) of planes that form an edge


@dataclass(frozen=True)
class Pinhole:
    """A pinhole camera or projector with square pixels.

    Parameters
    ----------
    shape
        Height and width in pixels, each at least 1.
    position, look_at, up
        Position, a point on the optical axis, and the direction that is up in the picture.
    width
        Width of the image plane at distance 1; None: its short side has length 1, which is a
        field of view of 53 degrees.

    Raises
    ------
    InputError
        If `look_at` is the position, or the optical axis is parallel to `up`.
    """

    shape: tuple[int, int]
    position: Vector = (0.0, 0.0, 0.0)
    look_at: Vector = (0.0, 0.0, 1.0)
    up: Vector = (0.0, -1.0, 0.0)
    width: float | None = None

    def __post_init__(self) -> None:
        direction = np.subtract(self.look_at, self.position, dtype=np.float64)
        across = np.linalg.norm(np.cross(self.up, direction))
        if not across > 1e-6 * np.linalg.norm(direction) * np.linalg.norm(
            self.up
        ):  # 1e-6: rounding
            raise InputError(
                f"a pinhole at {self.position} looks at {self.look_at}, up being {self.up}: "
                "expected another point to look at, and not one straight above or below"
            )

    @property
    def pitch(self) -> float:
        """Width of a pixel on the image plane at distance 1."""
        return 1 / min(self.shape) if self.width is None else self.width / self.shape[1]

    @property
    def origin(self) -> Double:
        """Position as float64 (3,)."""
        return np.array(self.position, dtype=np.float64)

    @cached_property
    def axes(self) -> Double:
        """Unit vectors to the right, down and ahead: float64 (3, 3)."""
        ahead = np.subtract(self.look_at, self.position, dtype=np.float64)
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(ahead, right), ahead])

    @property
    def matrix(self) -> Double:
        """Projection matrix of homogeneous points to depth x (column, row, 1): float64 (3, 4)."""
        height, width = self.shape
        inner = np.diag([1 / self.pitch, 1 / self.pitch, 1])
        inner[:2, 2] = width / 2, height / 2
        return inner @ np.column_stack([self.axes, -self.axes @ self.origin])

    def rays(self, parts: int = 1) -> Double:
        """Rays through `parts` x `parts` parts of each pixel: float64 (H W parts^2, 3).

        In the order of pixels; each ends on the image plane at distance 1.
        """
        height, width = self.shape
        within = (np.arange(parts) + 0.5) / parts
        image_plane = np.ones((height, width, parts, parts, 3))
        x, y = (
            (np.arange(length)[:, None] + within - length / 2) * self.pitch
            for length in (width, height)
        )
        image_plane[..., 0] = x[None, :, None, :]
        image_plane[..., 1] = y[:, None, :, None]
        return image_plane.reshape(-1, 3) @ self.axes

    def project(self, points: Double) -> Double:
        """Project points (n, 3) to rows and columns in the picture: float64 (n, 2).

        In pixels from the upper left corner; NaN for points behind the pinhole.
        """
        return self._project(points)[0] / self.pitch + np.array(self.shape) / 2

    def project_steps(self, points: Double, steps: Double) -> Double:
        """Project small steps (n, k, 3) from points (n, 3) to the picture: float64 (n, k, 2)."""
        position, depth = self._project(points)
        rotated = steps @ self.axes.T
        projected = rotated[..., [1, 0]] - position[:, None] * rotated[..., 2:]
        return np.asarray(projected / (depth[:, None, None] * self.pitch))

    def _project(self, points: Double) -> tuple[Double, Double]:
        """Project points to the image plane, (down, right) (n, 2), and depths (n,), or NaN."""
        right, down, ahead = ((points - self.origin) @ self.axes.T).T
        depth = np.where(ahead > 0, ahead, np.nan)
        return np.stack([down, right], axis=-1) / depth[:, None], depth


@dataclass(frozen=True)
class Points:
    """Points of a scene's surfaces, each with an area.

    `surface`, int64 (N,), is the index of each point's surface; positions float64 (N, 3), areas
    float64 (N,) and the lower clamp of squared distances between points are in scene units.
    """

    surfaces: tuple[Surface, ...]
    surface: NDArray[np.int64]
    positions: Double
    areas: Double
    min_squared_distance: float

    @property
    def mean_area(self) -> float:
        """Mean area of a point."""
        return float(self.areas.mean())


def clamp_of_squared_distance(surfaces: Sequence[Surface], mean_area: float) -> float:
    """Lower clamp of squared distances between the surface points of pixels, scene units squared.

    This is the mean area, or 1 / (2 sin(t / 2)^2) times it for an edge with an acute opening t:
    there pixels are long and close to each other, and the form factors of their central points
    would be too large.
    """
    normals = [plane.unit_normal for plane in surfaces if isinstance(plane, Plane)]
    openings = [1 + float(a @ b) for a, b in combinations(normals, 2)]  # 1 - cos t
    acute = min((opening for opening in openings if opening > _PARALLEL), default=1.0)
    return mean_area / min(acute, 1.0)


def surface_points(shape: tuple[int, int], surfaces: Sequence[Surface]) -> Points:
    """Compute the surface point and covered area of every pixel of the camera, in image order.

    A position is the first hit of a pixel's central ray (of several surfaces at equal distance, as
    in the column x = 0 of a wedge of odd width, the first one counts). The covered area is
    ``A = d^2 w / cos(angle)``, where w is the pixel's solid angle.

    Raises
    ------
    InputError
        If a pixel sees none of the surfaces.
    """
    hits = first_hits(Pinhole(shape), surfaces)
    if (hits.surface < 0).any():
        row, column = np.unravel_index(int(np.argmin(hits.surface)), shape)
        raise InputError(
            f"pixel ({row}, {column}) of a {shape[0]} x {shape[1]} image sees none of the surfaces "
            f"{', '.join(surface.name for surface in surfaces)}; close the room with another plane"
        )
    clamp = clamp_of_squared_distance(surfaces, float(hits.areas.mean()))
    return Points(tuple(surfaces), hits.surface, hits.positions, hits.areas, clamp)


@dataclass(frozen=True)
class Hits:
    """First hits of the rays through `parts` x `parts` parts of a pinhole's pixels.

    Parameters
    ----------
    rays
        float64 (n, 3), from the pinhole to the image plane at distance 1.
    surface
        int64 (n,): index of the surface hit first, -1 without a hit.
    positions, normals, areas
        float64 (n, 3), (n, 3), (n,): position, unit normal and area covered by the part of the
        pixel, in scene units (squared); zero without a hit.
    """

    pinhole: Pinhole
    parts: int
    rays: Double
    surface: NDArray[np.int64]
    positions: Double
    normals: Double
    areas: Double

    def steps_to_neighbours(self, index: NDArray[np.int64] | slice = slice(None)) -> Double:
        """Vectors from hits (k,) to those of the parts to the right and below: float64 (k, 2, 3).

        On the tangent plane, in scene units.
        """
        rays, points, normals = self.rays[index], self.positions[index], self.normals[index]
        depth = (points - self.pinhole.origin) @ self.pinhole.axes[2]
        steps = self.pinhole.axes[:2] * self.pinhole.pitch / self.parts  # on the image plane
        # relative change of the depth of the intersection with the tangent plane
        change = (normals @ steps.T) / (rays * normals).sum(1)[:, None]
        return np.asarray(depth[:, None, None] * (steps - change[..., None] * rays[:, None]))


def first_hits(pinhole: Pinhole, surfaces: Sequence[Surface], parts: int = 1) -> Hits:
    """Trace rays through `parts` x `parts` parts of a pinhole's pixels to the nearest surfaces.

    Planes are visible from the front only.
    """
    rays, pitch = pinhole.rays(parts), pinhole.pitch / parts
    depths = np.stack([surface.depths(pinhole.origin, rays) for surface in surfaces])
    surface = np.argmin(depths, axis=0)  # the first one of equals
    depth = depths[surface, np.arange(len(rays))]
    no_hit = ~np.isfinite(depth)
    surface[no_hit], depth[no_hit] = -1, 0
    positions = pinhole.origin + rays * depth[:, None]
    positions[no_hit] = 0
    normals, squared_length = np.zeros_like(rays), (rays**2).sum(1)
    cosine = np.ones(len(rays))
    for index, candidate in enumerate(surfaces):
        hit = surface == index
        normals[hit] = candidate.normals(positions[hit])
        cosine[hit] = -(rays[hit] * normals[hit]).sum(1) / np.sqrt(squared_length[hit])
        if isinstance(candidate, Sphere):
            # at least the mean over an outermost pixel, whose central ray may graze the sphere
            limb = np.sqrt(pitch * depth[hit] / (2 * candidate.radius))
            cosine[hit] = np.maximum(cosine[hit], limb)
    areas = pitch**2 / squared_length**1.5 * squared_length * depth**2 / cosine
    return Hits(pinhole, parts, rays, surface, positions, normals, areas)


def overlapped_cells(
    centre: Double, width: Double
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Double]:
    """Distribute boxes, given by centres and widths (n, 2), to the unit cells that they overlap.

    Returns
    -------
    box, row, column, weight
        For each overlap of a box and a cell; the weights of a box add up to 1.
    """
    low, width = centre - width / 2, np.maximum(width, 1e-6)
    first = np.floor(low).astype(np.int64)
    parts = []
    for axis in (0, 1):
        cell = first[:, axis, None] + np.arange(int(np.ceil(width[:, axis].max())) + 1)
        start, end = low[:, axis, None], (low + width)[:, axis, None]
        overlap = np.minimum(end, cell + 1) - np.maximum(start, cell)
        parts.append(np.maximum(overlap, 0) / width[:, axis, None])
    weight = parts[0][:, :, None] * parts[1][:, None]
    box, down, right = np.nonzero(weight > 1e-9)  # smaller overlaps are rounding errors
    return box, first[box, 0] + down, first[box, 1] + right, weight[box, down, right]
