"""Points of pictures, homographies between them, and the rays that lie under one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError

Double = NDArray[np.float64]
Quadrilateral = Sequence[tuple[float, float]]
"""(x, y) of the upper left, upper right, lower right and lower left corner of a view's rays, in
pixels from the picture's upper left corner: a pixel's middle lies at halves."""


def pixel_middles(shape: tuple[int, ...]) -> Double:
    """Return (x, y) of the pixels' middles, from the picture's corner: (H, W, 2)."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.stack([x, y], axis=-1)


def lie_within(points: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether points (..., 2), as (x, y), lie on a picture (H, W); NaN doesn't."""
    return np.asarray(((points >= 0) & (points < np.array(shape[::-1]))).all(axis=-1))


def apply_homography(matrix: NDArray[Any], points: NDArray[Any]) -> Double:
    """Map points (..., 2); the ones behind the plane are NaN or infinite."""
    x, y, w = np.moveaxis(points @ matrix[:, :2].T + matrix[:, 2], -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([x / w, y / w], axis=-1)


def rectangle(left: float, top: float, width: float, height: float) -> Quadrilateral:
    """Return the corners of an upright rectangle."""
    right, bottom = left + width, top + height
    return [(left, top), (right, top), (right, bottom), (left, bottom)]


def homography(shape: tuple[int, ...], corners: Quadrilateral) -> Double:
    """Return the matrix (3, 3) from a view's plane of rays to a picture.

    Parameters
    ----------
    shape : tuple of int
        The ray domain, see `RayDomain`.
    corners : Quadrilateral
        Of the view's rays in the picture.

    Raises
    ------
    InputError
        When the corners don't span a quadrilateral.
    """
    height, width = RayDomain(shape).image_shape
    equations, values = [], []
    for (x, y), (u, v) in zip(rectangle(0, 0, width, height), corners, strict=True):
        equations.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        equations.append([0, 0, 0, x, y, 1, -v * x, -v * y])
        values += [u, v]
    try:
        solution = np.linalg.solve(np.array(equations, np.float64), np.array(values, np.float64))
        matrix = np.append(solution, 1.0).reshape(3, 3)
        np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise InputError(f"the corners {list(corners)} span no quadrilateral") from None
    return matrix


def centred_corners(
    shape: tuple[int, ...], picture_shape: tuple[int, int], views: tuple[int, int] = (1, 1)
) -> list[Quadrilateral]:
    """Return the corners of views side by side in the middle, each ray a square of whole pixels.

    Parameters
    ----------
    shape : tuple of int
        The ray domain.
    picture_shape : (int, int)
        Height and width in pixels.
    views : (int, int)
        Rows and columns of views.

    Raises
    ------
    InputError
        When a ray doesn't get a pixel.
    """
    image = RayDomain(shape).image_shape
    height, width = (extent * count for extent, count in zip(image, views, strict=True))
    side = min(picture_shape[0] // height, picture_shape[1] // width)
    if side < 1:
        raise InputError(
            f"bench: {height} x {width} rays don't fit into a display of {picture_shape} pixels"
        )
    top, left = (picture_shape[0] - side * height) // 2, (picture_shape[1] - side * width) // 2
    size = side * image[1], side * image[0]
    return _rectangles(views, (left, top), size, size)


def tilted_corners(
    shape: tuple[int, ...], picture_shape: tuple[int, int], views: tuple[int, int] = (1, 1)
) -> list[Quadrilateral]:
    """Return the corners of views in cells side by side, turned and distorted a little.

    Parameters as `centred_corners`; the rays keep their aspect.
    """
    height, width = RayDomain(shape).image_shape
    cell = picture_shape[1] / views[1], picture_shape[0] / views[0]
    side = 0.9 * min(cell[0] / width, cell[1] / height)
    size = side * width, side * height
    first = (cell[0] - size[0]) / 2, (cell[1] - size[1]) / 2
    moved = [np.array(upright) + _TILT * size for upright in _rectangles(views, first, cell, size)]
    return [[(float(x), float(y)) for x, y in corners] for corners in moved]


_TILT = np.array([(0.020, -0.010), (0.012, 0.018), (-0.016, 0.012), (-0.024, -0.020)])
"""How far corners are moved, in fractions of the width and the height: less than the margin."""


def _rectangles(
    views: tuple[int, int],
    first: tuple[float, float],
    step: tuple[float, float],
    size: tuple[float, float],
) -> list[Quadrilateral]:
    """Corners of rectangles in rows and columns, row by row; (x, y) of all else."""
    return [
        rectangle(first[0] + column * step[0], first[1] + row * step[1], *size)
        for row in range(views[0])
        for column in range(views[1])
    ]
