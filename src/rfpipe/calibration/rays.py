"""The rays of a coaxial rig: where they lie on the projector, and which camera pixels make them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.calibration.bench import Bench
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

Double = NDArray[np.float64]
Mask = NDArray[np.bool_]

_DOUBT = 0.02
# Mixing of a camera pixel, as the share of it that looks at other rays, at which its error by an
# imperfect map equals that of pixels that look at one ray.

_RIDGE = 1e-4  # of the mean diagonal: what rays can't be told apart from is not amplified for ever
_LEAST_SHARE = 1e-3  # of a camera pixel that rays must have for it to be looked at
_CHUNK = 4096  # patches solved at once


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


def measure_rays(bench: Bench) -> Findings:
    """Find the rays of a rig; of the tolerance, half is for light that leaks.

    Returns
    -------
    Findings
        Arrays of layout and resampling; ``leak``, ``noise`` and ``pixels`` over the rays.

    Raises
    ------
    CaptureError
        When the camera sees none of the rays, or a ray has no projector pixel.
    """
    correspondence, settings = bench.found["correspondence"], bench.settings
    display, rays = bench.projector.shape, bench.rays
    valid, corners = correspondence["valid"], settings.corners
    if settings.views is not None and corners is None:
        corners = tuple(find_views(correspondence, settings.views))  # type: ignore[arg-type]
    if corners is None:
        layout = ProjectorLayout.grid(display, rays or display)
        maps = [map_of_pixels(correspondence, valid)]
    else:
        # as many rays a view as the smallest view has projector pixels a side
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - np.array(corners), axis=-1)
        wide, tall = np.maximum(sides.reshape(-1, 2).min(axis=0).astype(int), 1)
        shape = (len(corners), *(rays or (int(tall), int(wide))))
        layout = ProjectorLayout.within(corners, shape, display)
        maps = maps_of_views(correspondence, corners)
    if unlit := np.count_nonzero(layout.pixels_of_ray == 0):
        raise CaptureError(
            f"{unlit} of {layout.pixels_of_ray.size} rays have no projector pixel; "
            f"{layout.shape[-2:]} rays a view are too many for its place on the projector"
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
        "map_rms_pixels": max(one.rms for one in maps),
        "map_error_pixels": max(one.error for one in maps),
        **_judged(fit, blur, settings.tolerance),
    }
    return Findings.of("rays", facts, arrays)


def _judged(fit: RayFit, blur: float, tolerance: float) -> dict[str, Any]:
    """Return how rays are seen and mixed, by a blur of so many pixels or by their size."""
    seen, leak = fit.resampling.seen, float(np.percentile(fit.leak, 99))
    pixels = float(np.median(fit.pixels[seen.ravel()]))
    # a ray that few pixels see alone has up to twice a pixel's noise; four times is too much
    mixed = max(leak / (tolerance / 2), float(fit.noise.max()) / 4)
    return {
        "count": seen.size,
        "unseen_rays": int((~seen).sum()),
        "unseen_share": float((~seen).mean()),
        "pixels_a_ray": pixels,
        "blur_pixels": blur,
        "leak": leak,
        "largest_noise": float(fit.noise.max()),
        "mixed": mixed,
    }


def coverage(
    maps: Sequence[SmoothMap], layout: ProjectorLayout, camera_shape: tuple[int, int]
) -> tuple[csr_array[Any], Double]:
    """Return the share of each camera pixel that looks at each ray, and what is seen of each.

    Returns
    -------
    shares : csr_array of float64, shape (camera pixels, rays)
        Exact areas: each pixel's outline, cut by the projector pixels of each ray.
    seen : ndarray of float64, shape (rays,)
        Area of each ray that camera pixels look at, in projector pixels.
    """
    from scipy.sparse import coo_array

    domain, count = RayDomain(layout.shape), prod(layout.shape)
    y, x = np.mgrid[: camera_shape[0] + 1, : camera_shape[1] + 1].astype(np.float64)
    rays = layout.ray_of_pixel.ravel()
    found = []
    for view, to_projector in zip(range(domain.views), maps, strict=True):
        corners = to_projector(np.stack([x, y], axis=-1))
        for row in range(camera_shape[0]):
            # around the pixel: upper left, upper right, lower right, lower left
            above, below = corners[row], corners[row + 1]
            outlines = np.stack([above[:-1], above[1:], below[1:], below[:-1]], axis=1)
            column, target, share, area = overlaps(outlines, layout.display_shape)
            ray = rays[target]
            own = (ray != DARK) & (domain.view_of(ray) == view)
            pixel = row * camera_shape[1] + column
            found.append([part[own] for part in (pixel, ray, share, area)])
    pixel, ray, share, area = (np.concatenate(part) for part in zip(*found, strict=True))
    shape = (prod(camera_shape), count)
    shares = coo_array((share, (pixel, ray)), shape=shape).tocsr()
    return shares, np.asarray(np.bincount(ray, area, count), np.float64)


def overlaps(
    outlines: Double, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Double, Double]:
    """Cut outlines on a picture by its pixels.

    Parameters
    ----------
    outlines : ndarray of float64, shape (n, 4, 2)
        (x, y) of corners, in turn; those that aren't finite are left out.
    shape : (int, int)

    Returns
    -------
    outline, pixel : ndarray of int64, shape (m,)
        Indices of outlines and pixels that overlap.
    share, area : ndarray of float64, shape (m,)
        Of the overlap, over the outline's area, and in pixels.

    Notes
    -----
    The area left of u and above v is the integral of ``min(y, v) dx`` along the outline up to
    ``x = u``, by its sides; that of a pixel is made of those at its four corners.
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
    left = first[:, 0, None, None] + np.arange(wide + 1)[None, None]
    top = first[:, 1, None, None] + np.arange(tall + 1)[None, :, None]
    sums = np.zeros((len(chosen), tall + 1, wide + 1))
    for side in range(4):
        (x0, y0), (x1, y1) = (
            outlines[chosen, at % 4].T[..., None, None] for at in (side, side + 1)
        )
        run = np.where(x1 == x0, 1, x1 - x0)
        begin, end = np.minimum(x0, left), np.minimum(x1, left)
        a, b = (y0 + (x - x0) * (y1 - y0) / run - top for x in (begin, end))
        under, over = np.minimum(a, 0), np.minimum(b, 0)
        # of the way from a to b, the part below zero
        part = np.divide(over - under, b - a, out=np.ones_like(a), where=b != a)
        sums += (end - begin) * (top + part * (under + over) / 2)
    areas = np.abs(np.diff(np.diff(sums, axis=1), axis=2))
    (x, y), (u, v) = outlines[chosen].T, np.roll(outlines[chosen], -1, axis=1).T
    whole = np.abs((x * v - u * y).sum(axis=0)) / 2
    within = (left[..., :-1] < last[:, 0, None, None]) & (top[:, :-1] < last[:, 1, None, None])
    index, row, column = np.nonzero(within & (areas > 1e-9 * whole[:, None, None]))
    area = areas[index, row, column]
    pixel = (first[index, 1] + row) * shape[1] + first[index, 0] + column
    return chosen[index], pixel, area / whole[index], area


def fit_rays(
    maps: Sequence[SmoothMap],
    layout: ProjectorLayout,
    camera_shape: tuple[int, int],
    blur: float = 0.0,
) -> RayFit:
    """Find the weights with which camera pixels make up rays.

    Parameters
    ----------
    maps : sequence of SmoothMap
        From the camera to the projector, one for each view of the layout.
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
    seen = area > 0.5 * np.maximum(layout.pixels_of_ray, 1)
    if not seen.any():
        raise CaptureError(
            "the camera sees none of the rays; check their place on the projector, and the "
            "correspondence"
        )
    if blur > 0:
        shares = csr_array(blurring(camera_shape, blur) @ shares)
    used, past_of_ray = _with_past(shares)
    largest = used.max(axis=1).toarray().ravel()
    weight = np.where(largest > 0, _DOUBT**2 / (1 - np.minimum(largest, 1) + _DOUBT) ** 2, 0)
    weighted = csr_array(used.T @ diags_array(weight))
    patches = _patches(layout.shape, seen, 3 if blur > 0 else 2)
    inverse = _local_inverse(csr_array(weighted @ used), patches, past_of_ray)
    matrix = csr_array(inverse @ weighted)
    # a ten-thousandth of a row's largest weight is none
    least = 1e-4 * np.repeat(abs(matrix).max(axis=1).toarray().ravel(), np.diff(matrix.indptr))
    matrix.data[np.abs(matrix.data) < least] = 0
    matrix = normalised(matrix)
    dark = np.append(~seen, True)[layout.ray_of_pixel]
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


def blurring(shape: tuple[int, int], blur: float) -> csr_array[Any]:
    """Return a Gaussian blur of a picture as a matrix (H W, H W); past its edge all is dark."""
    from scipy.linalg import toeplitz
    from scipy.sparse import csr_array, kron
    from scipy.special import ive

    reach = 1 + int(np.ceil(4 * blur))
    # Lindeberg's discrete Gaussian: its variance is exact, where sampled ones' is less
    weights = ive(np.arange(reach + 1), blur**2)
    weights /= 2 * weights.sum() - weights[0]
    rows, columns = (toeplitz(np.pad(weights, (0, extent))[:extent]) for extent in shape)
    return csr_array(kron(csr_array(rows), csr_array(columns), format="csr"))


def _with_past(shares: csr_array[Any]) -> tuple[csr_array[Any], NDArray[np.int64]]:
    """Add what lies past the rays as unknowns: one beside each ray at the edge, and its column.

    Without them, rays at the edge would be taken for darker than they are, by what the pixels that
    they share with the dark outside see of it. Columns are -1 of rays without, and after the last.
    """
    from scipy.sparse import coo_array, csr_array, diags_array, hstack

    total = np.asarray(shares.sum(axis=1))
    looking = total > _LEAST_SHARE
    kept = csr_array(diags_array(looking.astype(np.float64)) @ shares)
    mixed = np.flatnonzero(looking & (total < 1 - _LEAST_SHARE))
    nearest = np.asarray(kept[mixed].argmax(axis=1)).ravel()
    edge, column = np.unique(nearest, return_inverse=True)
    past = coo_array((1 - total[mixed], (mixed, column)), shape=(len(total), len(edge)))
    of_ray = np.full(shares.shape[1] + 1, -1)
    of_ray[edge] = shares.shape[1] + np.arange(len(edge))
    return csr_array(hstack([kept, past.tocsr()], format="csr")), of_ray


def _patches(shape: tuple[int, ...], seen: Mask, radius: int) -> NDArray[np.int64]:
    """Return the rays around each seen one, itself first; -1 past the edge or where not seen."""
    index = np.where(seen, np.arange(seen.size), -1).reshape(RayDomain(shape).stack_shape)
    padded = np.pad(index, ((0, 0), (radius, radius), (radius, radius)), constant_values=-1)
    side = 2 * radius + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side), axis=(1, 2))
    return np.roll(windows.reshape(-1, side * side)[seen], -(side * side // 2), axis=1)


def _local_inverse(
    normal: csr_array[Any], patches: NDArray[np.int64], past_of_ray: NDArray[np.int64]
) -> csr_array[Any]:
    """Return the rays' rows of the inverse of ``A^T W A``, each solved on a patch of rays."""
    from scipy.sparse import coo_array

    ridge = _RIDGE * float(normal.diagonal()[patches[:, 0]].mean())
    past = past_of_ray[patches]
    at_edge = (past >= 0).any(axis=1)
    rows, columns, values = [], [], []
    for group in (patches[~at_edge], np.hstack([patches, past])[at_edge]):
        for patch in np.array_split(group, 1 + len(group) // _CHUNK):
            there, size = patch >= 0, patch.shape[1]
            both = there[:, :, None] & there[:, None, :]
            row, column = np.broadcast_arrays(patch[:, :, None], patch[:, None, :])
            local = np.zeros(both.shape)
            local[both] = np.asarray(normal[row[both], column[both]]).ravel()
            local[:, range(size), range(size)] += np.where(there, ridge, 1.0)
            solved = np.linalg.solve(local, np.eye(size)[:, :1])
            rows.append(np.broadcast_to(patch[:, :1], patch.shape)[there])
            columns.append(patch[there])
            values.append(solved[..., 0][there])
    at = np.concatenate(rows), np.concatenate(columns)
    shape = (len(past_of_ray) - 1, normal.shape[1])
    return coo_array((np.concatenate(values), at), shape=shape).tocsr()
