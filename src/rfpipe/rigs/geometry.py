"""Points of pictures, homographies between them, and the rays that lie under one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.rigs.layout import DARK, ProjectorLayout

__all__ = [
    "Quadrilateral",
    "apply_homography",
    "homography",
    "layout_within",
    "lie_within",
    "pixel_middles",
    "rectangle",
]

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


def layout_within(
    corners: Sequence[Quadrilateral], shape: tuple[int, ...], display_shape: tuple[int, int]
) -> ProjectorLayout:
    """Return the layout of rectified views: a pixel belongs to the ray that its middle lies on.

    Parameters
    ----------
    corners : sequence of Quadrilateral
        Of each view on the projector.
    shape : tuple of int
        The ray domain.
    display_shape : (int, int)
        Of the projector in pixels.
    """
    rays = np.full(display_shape, DARK, np.int32)
    middles = pixel_middles(display_shape)
    height, width = RayDomain(shape).image_shape
    for view, quad in enumerate(corners):
        # a grid's edges fall on whole numbers, which must not depend on rounding
        place = apply_homography(np.linalg.inv(homography(shape, quad)), middles).round(9)
        inside = lie_within(place, (height, width))
        x, y = np.floor(place[inside]).astype(np.int32).T
        rays[inside] = (view * height + y) * width + x
    return ProjectorLayout(shape, rays)
