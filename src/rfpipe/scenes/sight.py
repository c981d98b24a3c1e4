"""What pinholes see: where a camera or a projector stands, and the surfaces that its pixels meet.

Lengths are in scene units. In the frame of rfpipe's own scenes x is to the right, y down, z ahead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.surfaces import Plane, Sphere, Surface, Vector

Double = NDArray[np.float64]

_PARALLEL = 1e-6  # 1 - cos of the opening below which planes count as facing, not as a crease


@dataclass(frozen=True)
class Pinhole:
    """A camera or a projector of square pixels.

    Parameters
    ----------
    shape
        Height and width in pixels, each at least 1.
    position, look_at, up
        Where it stands, a point on its optical axis, and what is up in its picture.
    width
        Of its image plane at distance 1; None where that plane's short side spans -0.5 to 0.5:
        53 degrees.

    Raises
    ------
    InputError
        If it looks at itself or along `up`.
    """

    shape: tuple[int, int]
    position: Vector = (0.0, 0.0, 0.0)
    look_at: Vector = (0.0, 0.0, 1.0)
    up: Vector = (0.0, -1.0, 0.0)
    width: float | None = None

    def __post_init__(self) -> None:
        way = np.subtract(self.look_at, self.position, dtype=np.float64)
        across = np.linalg.norm(np.cross(self.up, way))
        if not across > 1e-6 * np.linalg.norm(way) * np.linalg.norm(self.up):  # 1e-6: rounding
            raise InputError(
                f"a pinhole at {self.position} looks at {self.look_at}, up being {self.up}: "
                "expected another point to look at, and not one straight above or below"
            )

    @property
    def pitch(self) -> float:
        """Side of a pixel at distance 1."""
        return 1 / min(self.shape) if self.width is None else self.width / self.shape[1]

    @property
    def origin(self) -> Double:
        """Its position as float64 (3,)."""
        return np.array(self.position, dtype=np.float64)

    @cached_property
    def axes(self) -> Double:
        """Unit vectors to the picture's right, down and ahead: float64 (3, 3)."""
        ahead = np.subtract(self.look_at, self.position, dtype=np.float64)
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(ahead, right), ahead])

    @property
    def matrix(self) -> Double:
        """Projection of homogeneous points to (column, row, 1), times depth: float64 (3, 4)."""
        height, width = self.shape
        inner = np.diag([1 / self.pitch, 1 / self.pitch, 1])
        inner[:2, 2] = width / 2, height / 2
        return inner @ np.column_stack([self.axes, -self.axes @ self.origin])

    def rays(self, parts: int = 1) -> Double:
        """Directions of the pixels' parts, `parts` x `parts` each, float64 (H W parts^2, 3).

        Pixel by pixel; as long as to distance 1.
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
        """Rows and columns at which points (n, 3) stand in the picture: float64 (n, 2).

        In pixels from its upper left corner; NaN for points that aren't ahead.
        """
        return self._place(points)[0] / self.pitch + np.array(self.shape) / 2

    def project_moves(self, points: Double, moves: Double) -> Double:
        """How far small moves (n, k, 3) of points (n, 3) go in the picture: float64 (n, k, 2)."""
        place, depth = self._place(points)
        turned = moves @ self.axes.T
        steps = turned[..., [1, 0]] - place[:, None] * turned[..., 2:]
        return np.asarray(steps / (depth[:, None, None] * self.pitch))

    def _place(self, points: Double) -> tuple[Double, Double]:
        """Points' places at distance 1, down and right (n, 2), and their depths (n,), or NaN."""
        right, down, ahead = ((points - self.origin) @ self.axes.T).T
        depth = np.where(ahead > 0, ahead, np.nan)
        return np.stack([down, right], axis=-1) / depth[:, None], depth


@dataclass(frozen=True)
class Points:
    """Points of a scene's surfaces, each with the area that it stands for.

    `surface`, int64 (N,), is the index of the one on which a point lies; positions float64 (N, 3),
    areas (N,), and the lower clamp of squared distances between points are in scene units.
    """

    surfaces: tuple[Surface, ...]
    surface: NDArray[np.int64]
    positions: Double
    areas: Double
    least_squared_distance: float

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
    """Find the point, surface and area that every pixel of the camera sees, in image order.

    A position is where a pixel's central ray meets the nearest surface (of several at one distance,
    as in the column x = 0 of a wedge of odd width, the first), an area what the pixel covers:
    ``A = d^2 w / cos(angle)``, w being its solid angle.

    Raises
    ------
    InputError
        If a pixel sees none of the surfaces.
    """
    sight = sight_of(Pinhole(shape), surfaces)
    if (sight.surface < 0).any():
        row, column = np.unravel_index(int(np.argmin(sight.surface)), shape)
        raise InputError(
            f"pixel ({row}, {column}) of a {shape[0]} x {shape[1]} image sees none of the surfaces "
            f"{', '.join(surface.name for surface in surfaces)}; close the room with another plane"
        )
    least = least_squared(surfaces, float(sight.areas.mean()))
    return Points(tuple(surfaces), sight.surface, sight.positions, sight.areas, least)


@dataclass(frozen=True)
class Sight:
    """Where the rays of a pinhole's pixels, cut into `parts` x `parts`, meet surfaces.

    Parameters
    ----------
    rays
        float64 (n, 3): as long as to distance 1 from the pinhole.
    surface
        int64 (n,): the surface that each ray meets first, -1 where it meets none.
    positions, normals, areas
        float64 (n, 3), (n, 3), (n,): where it does, the unit normal there, and what its share of a
        pixel covers, scene units (squared); zero where it meets none.
    """

    pinhole: Pinhole
    parts: int
    rays: Double
    surface: NDArray[np.int64]
    positions: Double
    normals: Double
    areas: Double

    def moves(self, chosen: NDArray[np.int64] | slice = slice(None)) -> Double:
        """How far it is from chosen (k,) places to those of the next parts: float64 (k, 2, 3).

        Of the part to the right and the one below, on the tangent plane; scene units.
        """
        rays, points, normals = self.rays[chosen], self.positions[chosen], self.normals[chosen]
        depth = (points - self.pinhole.origin) @ self.pinhole.axes[2]
        steps = self.pinhole.axes[:2] * self.pinhole.pitch / self.parts  # on the image plane
        # a ray that turns by a step meets the tangent plane so much farther on
        farther = (normals @ steps.T) / (rays * normals).sum(1)[:, None]
        return np.asarray(depth[:, None, None] * (steps - farther[..., None] * rays[:, None]))


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
    normals, squared_length = np.zeros_like(rays), (rays**2).sum(1)
    cosine = np.ones(len(rays))
    for index, each in enumerate(surfaces):
        on = surface == index
        normals[on] = each.normals(positions[on])
        cosine[on] = -(rays[on] * normals[on]).sum(1) / np.sqrt(squared_length[on])
        if isinstance(each, Sphere):
            # the mean over the outermost pixel of a disc, whose central ray may run along the limb
            cosine[on] = np.maximum(cosine[on], np.sqrt(pitch * depth[on] / (2 * each.radius)))
    areas = pitch**2 / squared_length**1.5 * squared_length * depth**2 / cosine
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
