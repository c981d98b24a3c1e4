"""Rays of a coaxial rig: their pixels on the projector, and their weights of camera pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double
from rfpipe.blocks import RayDomain
from rfpipe.calibration.context import StepContext
from rfpipe.calibration.correspondence import (
    SmoothMap,
    find_views,
    fit_blur,
    map_of_pixels,
    maps_of_views,
)
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.photometry.resampling import Resampling, normalised
from rfpipe.rigs.layout import DARK, ProjectorLayout

if TYPE_CHECKING:
    from scipy.sparse import csr_array


_MIXING = 0.02
# Share of a camera pixel on other rays at which errors of the map double the pixel's error.

_RIDGE = 1e-4  # regularization, relative to the mean diagonal: limits the amplification of noise
_LEAST_SHARE = 1e-3  # smallest area of a camera pixel on rays with which the pixel is used
_CHUNK = 4096  # number of patches in one batch of linear systems


@dataclass(frozen=True, eq=False)
class RayFit:
    """A resampling to rays, and its quality.

    Attributes
    ----------
    layout : ProjectorLayout
        The given layout; rays that the camera doesn't see are dark.
    resampling : Resampling
    leak : ndarray of float64, shape (N,)
        Light of other rays in each ray: sum of magnitudes per unit of light, for an exact map.
    noise : ndarray of float64, shape (N,)
        Standard deviation of a ray, relative to a camera pixel.
    pixels : ndarray of float64, shape (N,)
        Camera pixels per ray.
    """

    layout: ProjectorLayout
    resampling: Resampling
    leak: Double
    noise: Double
    pixels: Double


def measure_rays(context: StepContext) -> Findings:
    """Find the rays of a rig; half of the tolerance is allowed for light that leaks between rays.

    Returns
    -------
    Findings
        Arrays of layout and resampling; ``leak``, ``noise`` and ``pixels`` over the rays.

    Raises
    ------
    CaptureError
        When the camera sees none of the rays, or a ray has no projector pixel.
    """
    correspondence, settings = context.findings["correspondence"], context.settings
    display, rays = context.projector.shape, context.rays
    valid, corners = correspondence["valid"], settings.corners
    if settings.views is not None and corners is None:
        corners = tuple(find_views(correspondence, settings.views))  # type: ignore[arg-type]
    if corners is None:
        layout = ProjectorLayout.grid(display, rays or display)
        maps = [map_of_pixels(correspondence, valid)]
    else:
        # the number of rays along a side is the number of projector pixels of the smallest view
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - np.array(corners), axis=-1)
        wide, tall = np.maximum(sides.reshape(-1, 2).min(axis=0).astype(int), 1)
        shape = (len(corners), *(rays or (int(tall), int(wide))))
        layout = ProjectorLayout.within(corners, shape, display)
        maps = maps_of_views(correspondence, corners)
    if unlit := np.count_nonzero(layout.pixels_of_ray == 0):
        raise CaptureError(
            f"{unlit} of {layout.pixels_of_ray.size} rays have no projector pixel, since "
            f"{layout.shape[-2:]} rays per view are too many for a view's area on the projector",
            remedy="Set fewer rays",
        )
    blur = fit_blur(correspondence, maps)
    fit = fit_rays(maps, layout, valid.shape, blur)
    arrays = {
        **fit.layout.arrays(),
        **fit.resampling.arrays(),
        **{name: getattr(fit, name).reshape(layout.shape) for name in ("leak", "noise", "pixels")},
    }
    facts = {
        "shape": list(layout.shape),
        "corners": None if corners is None else [list(map(list, quad)) for quad in corners],
        "map_rms_pixels": max(smooth.rms for smooth in maps),
        "map_error_pixels": max(smooth.error for smooth in maps),
        **_quality(fit, blur, settings.tolerance),
    }
    return Findings.of("rays", facts, arrays)


def _quality(fit: RayFit, blur: float, tolerance: float) -> dict[str, Any]:
    """Count visible rays, and rate their mixing: ``mixed`` is acceptable up to 1."""
    visible, leak = fit.resampling.visible, float(np.percentile(fit.leak, 99))
    pixels = float(np.median(fit.pixels[visible.ravel()]))
    # a ray with few unshared pixels has up to twice a pixel's noise; four times is too much
    mixed = max(leak / (tolerance / 2), float(fit.noise.max()) / 4)
    return {
        "count": visible.size,
        "unseen_rays": int((~visible).sum()),
        "unseen_share": float((~visible).mean()),
        "pixels_per_ray": pixels,
        "blur_pixels": blur,
        "leak": leak,
        "largest_noise": float(fit.noise.max()),
        "mixed": mixed,
    }


def coverage(
    maps: Sequence[SmoothMap], layout: ProjectorLayout, camera_shape: tuple[int, int]
) -> tuple[csr_array[Any], Double]:
    """Compute the share of each camera pixel's area on each ray.

    Returns
    -------
    shares : csr_array of float64, shape (camera pixels, rays)
        Exact areas: each pixel's outline, clipped by the projector pixels of each ray.
    area : ndarray of float64, shape (rays,)
        Area of each ray inside camera pixels, in projector pixels.
    """
    from scipy.sparse import coo_array

    domain, count = RayDomain(layout.shape), prod(layout.shape)
    y, x = np.mgrid[: camera_shape[0] + 1, : camera_shape[1] + 1].astype(np.float64)
    rays = layout.ray_of_pixel.ravel()
    parts = []
    for view, to_projector in zip(range(domain.views), maps, strict=True):
        corners = to_projector(np.stack([x, y], axis=-1))
        for row in range(camera_shape[0]):
            # around the pixel: upper left, upper right, lower right, lower left
            above, below = corners[row], corners[row + 1]
            outlines = np.stack([above[:-1], above[1:], below[1:], below[:-1]], axis=1)
            column, target, share, area = overlapped_pixels(outlines, layout.display_shape)
            ray = rays[target]
            in_view = (ray != DARK) & (domain.view_of(ray) == view)
            pixel = row * camera_shape[1] + column
            parts.append([values[in_view] for values in (pixel, ray, share, area)])
    pixel, ray, share, area = (np.concatenate(values) for values in zip(*parts, strict=True))
    shape = (prod(camera_shape), count)
    shares = coo_array((share, (pixel, ray)), shape=shape).tocsr()
    return shares, np.asarray(np.bincount(ray, area, count), np.float64)


def overlapped_pixels(
    outlines: Double, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Double, Double]:
    """Intersect quadrilaterals with the pixels of a picture.

    Parameters
    ----------
    outlines : ndarray of float64, shape (n, 4, 2)
        (x, y) of the corners in turn; outlines with corners that aren't finite are ignored.
    shape : (int, int)
        Height and width of the picture.

    Returns
    -------
    outline, pixel : ndarray of int64, shape (m,)
        Indices of outlines and pixels that overlap.
    share, area : ndarray of float64, shape (m,)
        Area of the overlap, relative to the outline, and in pixels.

    Notes
    -----
    ``S(u, v)``, the area of the outline left of u and above v, is the integral of ``min(y, v) dx``
    along the outline up to ``x = u``, summed over its sides. The area in a pixel is the second
    difference of S at the pixel's four corners.
    """
    inside = np.isfinite(outlines).all(axis=(1, 2))
    low, high = outlines.min(axis=1), outlines.max(axis=1)
    inside &= ((high > 0) & (low < shape[::-1])).all(axis=1)
    chosen = np.flatnonzero(inside)
    if not chosen.size:
        none = np.zeros(0, np.int64)
        return none, none, np.zeros(0), np.zeros(0)
    first = np.maximum(np.floor(low[chosen]), 0).astype(np.int64)
    last = np.minimum(np.ceil(high[chosen]), shape[::-1]).astype(np.int64)
    wide, tall = (last - first).max(axis=0)
    u = first[:, 0, None, None] + np.arange(wide + 1)[None, None]
    v = first[:, 1, None, None] + np.arange(tall + 1)[None, :, None]
    areas = np.abs(np.diff(np.diff(_area_before(outlines[chosen], u, v), axis=1), axis=2))
    (x0, y0), (x1, y1) = outlines[chosen].T, np.roll(outlines[chosen], -1, axis=1).T
    total = np.abs((x0 * y1 - x1 * y0).sum(axis=0)) / 2
    within = (u[..., :-1] < last[:, 0, None, None]) & (v[:, :-1] < last[:, 1, None, None])
    index, row, column = np.nonzero(within & (areas > 1e-9 * total[:, None, None]))
    area = areas[index, row, column]
    pixel = (first[index, 1] + row) * shape[1] + first[index, 0] + column
    return chosen[index], pixel, area / total[index], area


def _area_before(outlines: Double, u: NDArray[np.int64], v: NDArray[np.int64]) -> Double:
    """Signed area of outlines (n, 4, 2) left of u (n, 1, w) and above v (n, h, 1): (n, h, w)."""
    sums = np.zeros((len(outlines), v.shape[1], u.shape[2]))
    for side in range(4):
        (x0, y0), (x1, y1) = (
            outlines[:, corner % 4].T[..., None, None] for corner in (side, side + 1)
        )
        run = np.where(x1 == x0, 1, x1 - x0)
        begin, end = np.minimum(x0, u), np.minimum(x1, u)
        a, b = (y0 + (x - x0) * (y1 - y0) / run - v for x in (begin, end))
        a_above, b_above = np.minimum(a, 0), np.minimum(b, 0)
        # fraction of the way from a to b that is below zero
        fraction = np.divide(b_above - a_above, b - a, out=np.ones_like(a), where=b != a)
        sums += (end - begin) * (v + fraction * (a_above + b_above) / 2)
    return sums


def fit_rays(
    maps: Sequence[SmoothMap],
    layout: ProjectorLayout,
    camera_shape: tuple[int, int],
    blur: float = 0.0,
) -> RayFit:
    """Compute the weights of camera pixels in each ray.

    Parameters
    ----------
    maps : sequence of SmoothMap
        Maps from camera to projector, one for each view of the layout.
    layout : ProjectorLayout
    camera_shape : (int, int)
    blur : float
        Standard deviation of the picture's blur in camera pixels, at least 0.

    Raises
    ------
    CaptureError
        When the camera sees none of the rays.

    Notes
    -----
    A camera pixel across two rays receives light of both. If pixels were averaged by area, the
    light of a lit ray would leak into its neighbours, and direct light is so strong that a leak of
    a few percent exceeds the indirect light. Therefore, the weights R invert the coverage A,
    ``R A = 1``; among all inverses, the weighted least-squares solution is
    ``R = (A^T W A)^-1 A^T W``. W is small for pixels across several rays, whose shares depend on
    errors of the map. Where no pixel covers several rays, R is close to a mean. Each ray is
    solved together with its neighbours only.
    """
    from scipy.sparse import csr_array, diags_array

    shares, area = coverage(maps, layout, camera_shape)
    visible = area > 0.5 * np.maximum(layout.pixels_of_ray, 1)
    if not visible.any():
        raise CaptureError(
            "the camera sees none of the rays",
            remedy="check their position on the projector (calibrate.corners), and the step "
            "correspondence",
        )
    if blur > 0:
        shares = csr_array(blurring(camera_shape, blur) @ shares)
    coverage_matrix, outside_of_ray = _with_outside(shares)
    largest = coverage_matrix.max(axis=1).toarray().ravel()
    weight = np.where(largest > 0, _MIXING**2 / (1 - np.minimum(largest, 1) + _MIXING) ** 2, 0)
    weighted = csr_array(coverage_matrix.T @ diags_array(weight))
    patches = _patches(layout.shape, visible, 3 if blur > 0 else 2)
    inverse = _local_inverse(csr_array(weighted @ coverage_matrix), patches, outside_of_ray)
    matrix = csr_array(inverse @ weighted)
    # drop weights below 1e-4 of a row's largest one
    least = 1e-4 * np.repeat(abs(matrix).max(axis=1).toarray().ravel(), np.diff(matrix.indptr))
    matrix.data[np.abs(matrix.data) < least] = 0
    matrix = normalised(matrix)
    dark = np.append(~visible, True)[layout.ray_of_pixel]
    ray_of_pixel = np.where(dark, DARK, layout.ray_of_pixel).astype(np.int32)
    mixing = csr_array(matrix @ shares)
    diagonal = mixing.diagonal()
    off_diagonal = np.asarray(abs(mixing).sum(axis=1)) - np.abs(diagonal)
    leak = off_diagonal + np.abs(1 - diagonal) * visible
    return RayFit(
        replace(layout, ray_of_pixel=ray_of_pixel),
        Resampling(layout.shape, camera_shape, matrix),
        np.where(visible, leak, 0),
        np.sqrt(np.asarray(matrix.power(2).sum(axis=1))),
        np.asarray(shares.sum(axis=0)),
    )


def blurring(shape: tuple[int, int], blur: float) -> csr_array[Any]:
    """Matrix (H W, H W) of a Gaussian blur; the picture is 0 beyond its edges."""
    from scipy.linalg import toeplitz
    from scipy.sparse import csr_array, kron
    from scipy.special import ive

    reach = 1 + int(np.ceil(4 * blur))
    # Lindeberg's discrete Gaussian has the exact variance; a sampled one has less
    weights = ive(np.arange(reach + 1), blur**2)
    weights /= 2 * weights.sum() - weights[0]
    rows, columns = (toeplitz(np.pad(weights, (0, extent))[:extent]) for extent in shape)
    return csr_array(kron(csr_array(rows), csr_array(columns), format="csr"))


def _with_outside(shares: csr_array[Any]) -> tuple[csr_array[Any], NDArray[np.int64]]:
    """Add unknowns for the area outside the rays, one next to each ray at the edge.

    Without them, the light of rays at the edge would be underestimated, since their camera pixels
    extend into the dark outside.

    Returns
    -------
    coverage : csr_array of float64, shape (camera pixels, rays + unknowns)
    outside_of_ray : ndarray of int64, shape (rays + 1,)
        Column of the unknown next to each ray; -1 without one, and as the last entry.
    """
    from scipy.sparse import coo_array, csr_array, diags_array, hstack

    total = np.asarray(shares.sum(axis=1))
    used = total > _LEAST_SHARE
    used_shares = csr_array(diags_array(used.astype(np.float64)) @ shares)
    mixed = np.flatnonzero(used & (total < 1 - _LEAST_SHARE))
    nearest = np.asarray(used_shares[mixed].argmax(axis=1)).ravel()
    edge, column = np.unique(nearest, return_inverse=True)
    outside = coo_array((1 - total[mixed], (mixed, column)), shape=(len(total), len(edge)))
    outside_of_ray = np.full(shares.shape[1] + 1, -1)
    outside_of_ray[edge] = shares.shape[1] + np.arange(len(edge))
    return csr_array(hstack([used_shares, outside.tocsr()], format="csr")), outside_of_ray


def _patches(shape: tuple[int, ...], visible: Bools, radius: int) -> NDArray[np.int64]:
    """Rays in a square around each visible ray, the ray itself first; -1 for no visible ray."""
    index = np.where(visible, np.arange(visible.size), -1).reshape(RayDomain(shape).stack_shape)
    padded = np.pad(index, ((0, 0), (radius, radius), (radius, radius)), constant_values=-1)
    side = 2 * radius + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side), axis=(1, 2))
    return np.roll(windows.reshape(-1, side * side)[visible], -(side * side // 2), axis=1)


def _local_inverse(
    normal: csr_array[Any], patches: NDArray[np.int64], outside_of_ray: NDArray[np.int64]
) -> csr_array[Any]:
    """Rows of the inverse of ``A^T W A`` for all rays, each solved on a patch of rays."""
    from scipy.sparse import coo_array

    ridge = _RIDGE * float(normal.diagonal()[patches[:, 0]].mean())
    outside = outside_of_ray[patches]
    at_edge = (outside >= 0).any(axis=1)
    rows, columns, values = [], [], []
    for group in (patches[~at_edge], np.hstack([patches, outside])[at_edge]):
        for patch in np.array_split(group, 1 + len(group) // _CHUNK):
            exists, size = patch >= 0, patch.shape[1]
            pairs = exists[:, :, None] & exists[:, None, :]
            row, column = np.broadcast_arrays(patch[:, :, None], patch[:, None, :])
            local = np.zeros(pairs.shape)
            local[pairs] = np.asarray(normal[row[pairs], column[pairs]]).ravel()
            local[:, range(size), range(size)] += np.where(exists, ridge, 1.0)
            solution = np.linalg.solve(local, np.eye(size)[:, :1])
            rows.append(np.broadcast_to(patch[:, :1], patch.shape)[exists])
            columns.append(patch[exists])
            values.append(solution[..., 0][exists])
    indices = np.concatenate(rows), np.concatenate(columns)
    shape = (len(outside_of_ray) - 1, normal.shape[1])
    return coo_array((np.concatenate(values), indices), shape=shape).tocsr()
