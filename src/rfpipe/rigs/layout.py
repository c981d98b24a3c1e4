"""Layout of rays in a picture: homographies, and the ray of each pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float
from rfpipe.blocks import RayDomain, ray_shape
from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint

Quadrilateral = Sequence[tuple[float, float]]
"""(x, y) of the upper left, upper right, lower right and lower left corner of a view's rays, in
pixels from the picture's upper left corner: the first pixel's centre is at (0.5, 0.5)."""

DARK = -1
"""Index in a layout for a pixel that belongs to no ray."""

_TILT = np.array([(0.020, -0.010), (0.012, 0.018), (-0.016, 0.012), (-0.024, -0.020)])
"""Displacement of corners, in fractions of width and height; less than the margin."""


def pixel_middles(shape: tuple[int, ...]) -> Double:
    """Coordinates (x, y) of the pixels' centres, from the picture's corner, (H, W, 2)."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.stack([x, y], axis=-1)


def lie_within(points: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Test which points (x, y), shape (..., 2), lie on a picture (H, W); False for NaN."""
    return np.asarray(((points >= 0) & (points < np.array(shape[::-1]))).all(axis=-1))


def apply_homography(matrix: NDArray[Any], points: NDArray[Any]) -> Double:
    """Map points (..., 2); points behind the plane become NaN or infinite."""
    x, y, w = np.moveaxis(points @ matrix[:, :2].T + matrix[:, 2], -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([x / w, y / w], axis=-1)


def homography(shape: tuple[int, ...], corners: Quadrilateral) -> Double:
    """Compute the matrix (3, 3) from a view's rays, of a domain `shape`, to a picture.

    InputError when the corners don't span a quadrilateral.
    """
    plane = _rectangle((0, 0), RayDomain(shape).image_shape[::-1])
    rows = []
    for (x, y), (u, v) in zip(plane, corners, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y, u])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y, v])
    system = np.array(rows, np.float64)
    try:
        matrix = np.append(np.linalg.solve(system[:, :8], system[:, 8]), 1.0).reshape(3, 3)
        np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise InputError(
            f"the corners {list(corners)} don't span a quadrilateral",
            remedy="give four corners, no three of them on a line",
        ) from None
    return matrix


def centred_corners(
    shape: tuple[int, ...], picture_shape: tuple[int, int], views: tuple[int, int] = (1, 1)
) -> list[Quadrilateral]:
    """Place views side by side in the centre, each ray a square of a whole number of pixels.

    Parameters
    ----------
    shape : tuple of int
        Ray domain of each view.
    picture_shape : (int, int)
    views : (int, int)
        Rows and columns of views.

    Returns
    -------
    list of Quadrilateral
        Corners of each view, row by row.

    Raises
    ------
    InputError
        When a ray would be smaller than a pixel.
    """
    image = RayDomain(shape).image_shape
    height, width = (extent * count for extent, count in zip(image, views, strict=True))
    side = min(picture_shape[0] // height, picture_shape[1] // width)
    if side < 1:
        raise InputError(
            f"layout: {(height, width)} rays don't fit into a picture of {picture_shape} pixels; "
            "a ray needs at least one pixel"
        )
    first = (picture_shape[1] - side * width) // 2, (picture_shape[0] - side * height) // 2
    size = side * image[1], side * image[0]
    return [_rectangle(place, size) for place in _places(views, first, size)]


def tilted_corners(
    shape: tuple[int, ...], picture_shape: tuple[int, int], views: tuple[int, int] = (1, 1)
) -> list[Quadrilateral]:
    """Place views side by side, slightly rotated and distorted; otherwise as `centred_corners`."""
    height, width = RayDomain(shape).image_shape
    cell = picture_shape[1] / views[1], picture_shape[0] / views[0]
    side = 0.9 * min(cell[0] / width, cell[1] / height)
    size = side * width, side * height
    first = (cell[0] - size[0]) / 2, (cell[1] - size[1]) / 2
    moved = [np.array(_rectangle(at, size)) + _TILT * size for at in _places(views, first, cell)]
    return [[(float(x), float(y)) for x, y in corners] for corners in moved]


def _rectangle(first: tuple[float, float], size: Sequence[float]) -> Quadrilateral:
    """Corners of an upright rectangle, from its upper left corner (x, y) and its size."""
    (x0, y0), (x1, y1) = first, (first[0] + size[0], first[1] + size[1])
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _places(
    views: tuple[int, int], first: tuple[float, float], step: tuple[float, float]
) -> list[tuple[float, float]]:
    """Upper left corners (x, y) of cells in rows and columns, row by row."""
    return [
        (first[0] + column * step[0], first[1] + row * step[1])
        for row in range(views[0])
        for column in range(views[1])
    ]


@dataclass(frozen=True, eq=False)
class ProjectorLayout:
    """Assignment of projector pixels to rays, by which a pattern becomes a picture.

    Parameters
    ----------
    shape : tuple of int
        Ray domain.
    ray_of_pixel : ndarray of int32, shape (Hp, Wp)
        Index of each pixel's ray, in row-major order of the domain; `DARK` without a ray.

    Raises
    ------
    InputError
        When an index is out of range.
    """

    shape: tuple[int, ...]
    ray_of_pixel: NDArray[np.int32]

    def __post_init__(self) -> None:
        shape = ray_shape(self.shape, "a layout's ray domain")
        rays = np.ascontiguousarray(self.ray_of_pixel)
        if rays.min() < DARK or rays.max() >= prod(shape):
            raise InputError(
                f"layout: ray_of_pixel has {rays.min()} to {rays.max()}; expected {DARK} (dark) "
                f"to {prod(shape) - 1}, the last ray of {shape}"
            )
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "ray_of_pixel", rays.astype(np.int32, copy=False))

    @classmethod
    def grid(cls, display_shape: tuple[int, int], domain_shape: tuple[int, ...]) -> Self:
        """Create a centred grid: each ray is the largest possible square of whole pixels.

        InputError when the domain is larger than the picture, or has views, whose positions need a
        calibration.
        """
        if RayDomain(domain_shape).is_stack:
            raise InputError(
                f"layout: the ray domain {domain_shape} has views; a grid has one image (H, W)",
                remedy="Calibrate the rig to measure the positions of the views on the projector",
            )
        return cls.within(centred_corners(domain_shape, display_shape), domain_shape, display_shape)

    @classmethod
    def within(
        cls,
        corners: Sequence[Quadrilateral],
        shape: tuple[int, ...],
        display_shape: tuple[int, int],
    ) -> Self:
        """Create a layout of rectified views: a pixel belongs to the ray at its centre.

        Parameters
        ----------
        corners : sequence of Quadrilateral
            Corners of each view on the projector.
        shape : tuple of int
            Ray domain.
        display_shape : (int, int)
            Height and width of the projector's picture.
        """
        rays = np.full(display_shape, DARK, np.int32)
        middles = pixel_middles(display_shape)
        height, width = RayDomain(shape).image_shape
        for view, quad in enumerate(corners):
            # edges of a grid are integers, which must not be affected by rounding errors
            place = apply_homography(np.linalg.inv(homography(shape, quad)), middles).round(9)
            inside = lie_within(place, (height, width))
            x, y = np.floor(place[inside]).astype(np.int32).T
            rays[inside] = (view * height + y) * width + x
        return cls(shape, rays)

    @property
    def display_shape(self) -> tuple[int, int]:
        """Height and width of the projector's picture in pixels."""
        height, width = self.ray_of_pixel.shape
        return height, width

    @property
    def pixels_of_ray(self) -> NDArray[np.int64]:
        """Number of projector pixels of each ray, (N,)."""
        lit = self.ray_of_pixel[self.ray_of_pixel != DARK]
        return np.bincount(lit, minlength=prod(self.shape))

    def picture(self, pattern: NDArray[Any]) -> Float:
        """Convert a pattern to a picture of weights, float32 (Hp, Wp); 0 for pixels without ray."""
        weights = np.append(np.asarray(pattern, np.float32).ravel(), np.float32(0))
        return np.asarray(weights[self.ray_of_pixel])  # DARK is the last index

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return {"shape": list(self.shape), "ray_of_pixel": fingerprint(self.ray_of_pixel)}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays for storage; see `from_arrays`."""
        return {"shape": np.array(self.shape, np.int64), "ray_of_pixel": self.ray_of_pixel}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Restore a layout from its `arrays`."""
        return cls(tuple(int(extent) for extent in arrays["shape"]), arrays["ray_of_pixel"])
