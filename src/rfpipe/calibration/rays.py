"""Resampling a coaxial camera onto the projector's rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.calibration.blur import blurring
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

LEAST_SHARE = 1e-3
"""Of a camera pixel that rays must have for it to be looked at."""

DOUBT = 0.02
"""Mixing of a camera pixel, as the share of it that looks at other rays, at which its error by an
imperfect map equals that of pixels that look at one ray."""

RADIUS = 2
BLURRED_RADIUS = 3
"""Rays on each side that a ray's weights are solved together with, without and with blur."""

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
) -> tuple[csr_array[Any], Double]:
    """Return the share of each camera pixel that looks at each ray, and what is seen of each.

    Parameters
    ----------
    maps : sequence of SmoothMap
        From the camera to the projector, one for each view of the layout.
    layout : ProjectorLayout
    camera_shape : (int, int)

    Returns
    -------
    shares : csr_array of float64, shape (camera pixels, rays)
        Exact areas: each pixel's outline, cut by the projector pixels of each ray.
    seen : ndarray of float64, shape (rays,)
        Area of each ray that camera pixels look at, in projector pixels.
    """
    from scipy.sparse import coo_array

    from rfpipe.calibration.kernels import overlaps

    height, width = camera_shape
    y, x = np.mgrid[: height + 1, : width + 1].astype(np.float64)
    domain = RayDomain(layout.shape)
    if len(maps) != domain.views:
        raise CaptureError(
            f"{len(maps)} maps for a layout of {domain.views} views; expected one each"
        )
    rays = layout.ray_of_pixel.ravel()
    found: list[list[NDArray[Any]]] = []
    for view, to_projector in enumerate(maps):
        corners = to_projector(np.stack([x, y], axis=-1))
        chosen = _near(corners, domain.view_of(layout.ray_of_pixel) == view)
        pixel, target, *areas = overlaps(corners, chosen, *layout.display_shape)
        ray = rays[target.astype(np.int64)]
        own = (ray != DARK) & (domain.view_of(ray) == view)
        found.append([part[own] for part in (pixel.astype(np.int64), ray, *areas)])
    pixel, ray, share, area = (np.concatenate(part) for part in zip(*found, strict=True))
    count = prod(layout.shape)
    shares = coo_array((share, (pixel, ray)), shape=(height * width, count)).tocsr()
    return shares, np.asarray(np.bincount(ray, area, count), np.float64)


def fit_rays(
    maps: Sequence[SmoothMap],
    layout: ProjectorLayout,
    camera_shape: tuple[int, int],
    blur: float = 0.0,
) -> RayFit:
    """Find the weights with which camera pixels make up rays.

    Parameters
    ----------
    maps, layout, camera_shape
        As for `coverage`.
    blur : float
        Standard deviation of the picture's blur in camera pixels, at least 0.

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

    shares, area = coverage(maps, layout, camera_shape)
    seen = area > LEAST_SEEN * np.maximum(layout.pixels_of_ray, 1)
    if not seen.any():
        raise CaptureError(
            "the camera sees none of the rays; check their place on the projector, and the "
            "correspondence"
        )
    if blur > 0:
        shares = csr_array(blurring(camera_shape, blur) @ shares)
    used, past_of_ray = _with_past(shares)
    largest = used.max(axis=1).toarray().ravel()
    weight = np.where(largest > 0, DOUBT**2 / (1 - np.minimum(largest, 1) + DOUBT) ** 2, 0)
    weighted = csr_array(used.T @ diags_array(weight))
    radius = BLURRED_RADIUS if blur > 0 else RADIUS
    patches = _patches(layout.shape, seen, radius)
    inverse = _local_inverse(csr_array(weighted @ used), patches, past_of_ray)
    matrix = _pruned(csr_array(inverse @ weighted))
    unseen = ~seen.reshape(layout.shape)
    dark = np.append(unseen.ravel(), True)[layout.ray_of_pixel]
    ray_of_pixel = np.where(dark, DARK, layout.ray_of_pixel).astype(np.int32)
    mixing = csr_array(matrix @ shares)
    own = mixing.diagonal()
    leak = np.asarray(abs(mixing).sum(axis=1)) - np.abs(own) + np.abs(1 - own) * seen
    return RayFit(
        replace(layout, ray_of_pixel=ray_of_pixel),
        Resampling(layout.shape, camera_shape, matrix),
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


def _with_past(shares: csr_array[Any]) -> tuple[csr_array[Any], NDArray[np.int64]]:
    """Add what lies past the rays as unknowns: one beside each ray at the edge.

    Without them, rays at the edge would be taken for darker than they are, by what the pixels that
    they share with the dark outside see of it.

    Returns
    -------
    csr_array of float64, shape (camera pixels, rays + unknowns past them)
        Rows of pixels that see rays sum to 1, others are empty.
    ndarray of int64, shape (rays + 1,)
        Column of the unknown beside each ray, -1 where there is none; the last is always -1.
    """
    from scipy.sparse import coo_array, csr_array, diags_array, hstack

    total = np.asarray(shares.sum(axis=1))
    looking = total > LEAST_SHARE
    kept = csr_array(diags_array(looking.astype(np.float64)) @ shares)
    mixed = np.flatnonzero(looking & (total < 1 - LEAST_SHARE))
    nearest = np.asarray(kept[mixed].argmax(axis=1)).ravel()
    edge, column = np.unique(nearest, return_inverse=True)
    past = coo_array((1 - total[mixed], (mixed, column)), shape=(len(total), len(edge)))
    of_ray = np.full(shares.shape[1] + 1, -1)
    of_ray[edge] = shares.shape[1] + np.arange(len(edge))
    return csr_array(hstack([kept, past.tocsr()], format="csr")), of_ray


def _patches(shape: tuple[int, ...], seen: NDArray[np.bool_], radius: int) -> NDArray[np.int64]:
    """Return the rays around each seen one, itself first; -1 past the edge or where not seen."""
    index = np.where(seen, np.arange(seen.size), -1).reshape(RayDomain(shape).stack_shape)
    padded = np.pad(index, ((0, 0), (radius, radius), (radius, radius)), constant_values=-1)
    side = 2 * radius + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side), axis=(1, 2))
    around = windows.reshape(-1, side * side)[seen]
    middle = side * side // 2
    return np.roll(around, -middle, axis=1)


def _local_inverse(
    normal: csr_array[Any], patches: NDArray[np.int64], past_of_ray: NDArray[np.int64]
) -> csr_array[Any]:
    """Return the rays' rows of the inverse of ``A^T W A``, each solved on a patch of rays."""
    from scipy.sparse import coo_array

    count = len(past_of_ray) - 1
    ridge = RIDGE * float(normal.diagonal()[patches[:, 0]].mean())
    past = past_of_ray[patches]
    at_edge = (past >= 0).any(axis=1)
    rows, columns, values = [], [], []
    for group in (patches[~at_edge], np.hstack([patches, past])[at_edge]):
        for first in range(0, len(group), CHUNK):
            patch = group[first : first + CHUNK]
            there = patch >= 0
            solved = np.linalg.solve(_local(normal, patch, ridge), np.eye(patch.shape[1])[:, :1])
            rows.append(np.broadcast_to(patch[:, :1], patch.shape)[there])
            columns.append(patch[there])
            values.append(solved[..., 0][there])
    at = np.concatenate(rows), np.concatenate(columns)
    shape = (count, normal.shape[1])
    return coo_array((np.concatenate(values), at), shape=shape).tocsr()


def _local(normal: csr_array[Any], patch: NDArray[np.int64], ridge: float) -> Double:
    """Return the part of a matrix that each patch (n, P) sees, (n, P, P), made regular."""
    there = patch >= 0
    both = there[:, :, None] & there[:, None, :]
    row, column = np.broadcast_arrays(patch[:, :, None], patch[:, None, :])
    local = np.zeros(both.shape)
    local[both] = np.asarray(normal[row[both], column[both]]).ravel()
    diagonal = np.arange(patch.shape[1])
    local[:, diagonal, diagonal] += np.where(there, ridge, 1.0)
    return local


def _pruned(matrix: csr_array[Any]) -> csr_array[Any]:
    """Drop a row's smallest weights, and scale the others to sum to 1."""
    largest = abs(matrix).max(axis=1).toarray().ravel()
    least = LEAST_WEIGHT * np.repeat(largest, np.diff(matrix.indptr))
    matrix.data[np.abs(matrix.data) < least] = 0
    return normalised(matrix)
