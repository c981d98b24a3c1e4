"""Resampling a coaxial camera onto the projector's rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.mapping import SmoothMap
from rfpipe.errors import CaptureError
from rfpipe.photometry.resampling import Resampling, normalised
from rfpipe.rigs.layout import DARK, ProjectorLayout

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["RayFit", "coverage", "fit_rays"]

Double = NDArray[np.float64]

LEAST_SEEN = 0.5
"""Share of a ray's projector pixels that the camera must see."""

WHOLE = 1e-3
"""Share of a camera pixel that may look past the rays: dark there, it would see too little."""

DOUBT = 0.02
"""Mixing of a camera pixel, as the share of it that looks at other rays, at which its error by an
imperfect map equals that of pixels that look at one ray."""

RADIUS = 2
"""Rays on each side that a ray's weights are solved together with."""

RIDGE = 1e-4
"""Of the mean diagonal; keeps what rays can't be told apart from amplifying noise without end."""

LEAST_WEIGHT = 1e-4
"""Of a ray's largest weight; smaller ones are dropped."""

CHUNK = 4096


@dataclass(frozen=True, eq=False)
class RayFit:
    """A resampling, with how well it tells rays apart.

    Attributes
    ----------
    layout : ProjectorLayout
        As given, but dark where the camera doesn't see the ray.
    resampling : Resampling
    leak : ndarray of float64, shape (N,)
        Light of other rays in each ray, as the sum of magnitudes per unit of their light, if the
        map is right.
    noise : ndarray of float64, shape (N,)
        Standard deviation of a ray over that of a camera pixel.
    pixels : ndarray of float64, shape (N,)
        Camera pixels a ray.
    """

    layout: ProjectorLayout
    resampling: Resampling
    leak: Double
    noise: Double
    pixels: Double


def coverage(
    maps: Sequence[SmoothMap], layout: ProjectorLayout, camera_shape: tuple[int, int]
) -> csr_array[Any]:
    """Return the share of each camera pixel that looks at each ray.

    Parameters
    ----------
    maps : sequence of SmoothMap
        From the camera to the projector, one for each view of the layout.
    layout : ProjectorLayout
    camera_shape : (int, int)

    Returns
    -------
    csr_array of float64, shape (camera pixels, rays)
        Exact areas: each pixel's outline, cut by the projector pixels of each ray.
    """
    from scipy.sparse import coo_array

    from rfpipe.calibration.kernels import overlaps

    height, width = camera_shape
    y, x = np.mgrid[: height + 1, : width + 1].astype(np.float64)
    views = layout.shape[0] if len(layout.shape) == 3 else 1
    if len(maps) != views:
        raise CaptureError(f"{len(maps)} maps for a layout of {views} views; expected one each")
    per_view = prod(layout.shape[-2:])
    rays = layout.ray_of_pixel.ravel()
    found: list[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]] = []
    for view, to_projector in enumerate(maps):
        corners = to_projector(np.stack([x, y], axis=-1))
        chosen = _near(corners, layout.ray_of_pixel // per_view == view)
        pixel, target, share = overlaps(corners, chosen, *layout.display_shape)
        ray = rays[target.astype(np.int64)]
        own = (ray != DARK) & (ray // per_view == view)
        found.append((pixel[own].astype(np.int64), ray[own].astype(np.int64), share[own]))
    pixel, ray, share = (np.concatenate(part) for part in zip(*found, strict=True))
    return coo_array((share, (pixel, ray)), shape=(height * width, prod(layout.shape))).tocsr()


def fit_rays(
    maps: Sequence[SmoothMap], layout: ProjectorLayout, camera_shape: tuple[int, int]
) -> RayFit:
    """Find the weights with which camera pixels make up rays.

    Parameters as `coverage`.

    Returns
    -------
    RayFit

    Raises
    ------
    CaptureError
        When the camera sees none of the rays.

    Notes
    -----
    A camera pixel that looks at two rays sees light of both. Averaged by area, the light of a lit
    ray would leak into its neighbours; direct light is so strong that a leak of a few per cent
    drowns what there is to measure. So the weights R invert the coverage A, ``R A = 1``: of all
    that do, those of least error, ``R = (A^T W A)^-1 A^T W``. W is small for pixels that look at
    several rays, whose shares an imperfect map gets wrong; where each ray has pixels of its own,
    the weights are their mean, to within little. Rays are solved together with their neighbours
    alone.
    """
    from scipy.sparse import csr_array, diags_array

    shares = coverage(maps, layout, camera_shape)
    outlines = _areas(maps, layout, camera_shape, shares)
    pixels_of_ray = np.bincount(layout.ray_of_pixel[layout.ray_of_pixel != DARK],
                                minlength=prod(layout.shape))  # fmt: skip
    seen_pixels: Double = np.asarray(shares.T @ outlines)
    seen = seen_pixels > LEAST_SEEN * np.maximum(pixels_of_ray, 1)
    if not seen.any():
        raise CaptureError(
            "the camera sees none of the rays; check their place on the projector, and the "
            "correspondence"
        )
    whole = np.asarray(shares.sum(axis=1)) > 1 - WHOLE
    used = csr_array(diags_array(whole.astype(np.float64)) @ shares)
    largest = used.max(axis=1).toarray().ravel()
    weight = np.where(whole, 1 / (1 - np.minimum(largest, 1) + DOUBT) ** 2, 0) * DOUBT**2
    weighted = csr_array(used.T @ diags_array(weight))
    seen = seen & (np.asarray(weighted.sum(axis=1)) > 0)
    inverse = _local_inverse(csr_array(weighted @ used), seen, layout.shape)
    matrix = _pruned(csr_array(inverse @ weighted))
    unseen = ~seen.reshape(layout.shape)
    dark = np.append(unseen.ravel(), True)[layout.ray_of_pixel]
    ray_of_pixel = np.where(dark, DARK, layout.ray_of_pixel).astype(np.int32)
    mixing = csr_array(matrix @ shares)
    own = mixing.diagonal()
    leak = np.asarray(abs(mixing).sum(axis=1)) - np.abs(own) + np.abs(1 - own) * seen
    return RayFit(
        replace(layout, ray_of_pixel=ray_of_pixel),
        Resampling(layout.shape, camera_shape, normalised(matrix)),
        np.where(seen, leak, 0),
        np.sqrt(np.asarray(matrix.power(2).sum(axis=1))),
        np.asarray(shares.sum(axis=0)),
    )


def _near(corners: Double, region: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Choose the camera pixels whose outline touches the bounding box of a region."""
    rows, columns = np.flatnonzero(region.any(axis=1)), np.flatnonzero(region.any(axis=0))
    if not rows.size:
        return np.zeros((corners.shape[0] - 1, corners.shape[1] - 1), bool)
    low = np.array([columns[0], rows[0]])
    high = np.array([columns[-1] + 1, rows[-1] + 1])
    with np.errstate(invalid="ignore"):
        inside = np.asarray(((corners > low - 1) & (corners < high + 1)).all(axis=-1))
    return np.asarray(inside[:-1, :-1] | inside[:-1, 1:] | inside[1:, :-1] | inside[1:, 1:])


def _areas(
    maps: Sequence[SmoothMap],
    layout: ProjectorLayout,
    camera_shape: tuple[int, int],
    shares: csr_array[Any],
) -> Double:
    """Return the area of each camera pixel on the projector, in projector pixels, (Hc Wc,)."""
    height, width = camera_shape
    y, x = np.mgrid[: height + 1, : width + 1].astype(np.float64)
    view_of_pixel = np.zeros(height * width, np.int64)
    rows, rays = shares.nonzero()
    view_of_pixel[rows] = rays // prod(layout.shape[-2:])
    areas = np.zeros(height * width)
    for view, to_projector in enumerate(maps):
        corner = to_projector(np.stack([x, y], axis=-1))
        first, second = corner[1:, 1:] - corner[:-1, :-1], corner[1:, :-1] - corner[:-1, 1:]
        cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
        own = view_of_pixel == view
        areas[own] = np.abs(cross).ravel()[own] / 2
    return areas


def _local_inverse(
    normal: csr_array[Any], seen: NDArray[np.bool_], shape: tuple[int, ...]
) -> csr_array[Any]:
    """Return the inverse of ``A^T W A``, each row solved on a patch of rays around its own."""
    from scipy.sparse import coo_array, csr_array, diags_array

    diagonal = normal.diagonal()
    ridge = RIDGE * float(diagonal[seen].mean())
    regular = csr_array(normal + diags_array(np.where(seen, ridge, 1.0)))
    height, width = shape[-2:]
    index = np.arange(prod(shape)).reshape(-1, height, width)
    padded = np.pad(index, ((0, 0), (RADIUS, RADIUS), (RADIUS, RADIUS)), constant_values=-1)
    side = 2 * RADIUS + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side), axis=(1, 2))
    patches = windows.reshape(-1, side * side)[seen]
    rows, columns, values = [], [], []
    for first in range(0, len(patches), CHUNK):
        patch = patches[first : first + CHUNK]
        there = patch >= 0
        both = there[:, :, None] & there[:, None, :]
        row, column = np.broadcast_arrays(patch[:, :, None], patch[:, None, :])
        local = np.zeros(both.shape)
        local[both] = np.asarray(regular[row[both], column[both]]).ravel()
        local[:, np.arange(side * side), np.arange(side * side)] += ~there
        target = np.zeros((len(patch), side * side, 1))
        target[:, side * side // 2] = 1
        solved = np.linalg.solve(local, target)[..., 0]
        own = np.broadcast_to(patch[:, side * side // 2, None], patch.shape)
        rows.append(own[there])
        columns.append(patch[there])
        values.append(solved[there])
    at = np.concatenate(rows), np.concatenate(columns)
    return coo_array((np.concatenate(values), at), shape=normal.shape).tocsr()


def _pruned(matrix: csr_array[Any]) -> csr_array[Any]:
    """Drop a row's smallest weights."""
    largest = abs(matrix).max(axis=1).toarray().ravel()
    least = LEAST_WEIGHT * np.repeat(largest, np.diff(matrix.indptr))
    matrix.data[np.abs(matrix.data) < least] = 0
    matrix.eliminate_zeros()
    sums = np.asarray(matrix.sum(axis=1))
    matrix.data /= np.repeat(np.where(sums, sums, 1), np.diff(matrix.indptr))
    return matrix
