"""Footprints of piecewise smooth surfaces: neighbouring camera pixels see neighbouring rays.

A code of few pictures determines the place of a camera pixel in the projector only up to the width
of its finest stripes, and noise misplaces single pixels. Over a small window of the camera's image
the place ``q`` of pixel ``x`` is nearly affine,

    q(x) = a + B x,

and a robust fit of a and B to all places in the window gives each pixel its expected footprint: a
box at ``q(x)`` as wide as the pixel's image B. Weights are then estimated again, with these
expected weights in place of zero: they follow the pictures where these determine them,
and the surface elsewhere.

====== ========= ============== ==========================================================
symbol code      shape          meaning
====== ========= ============== ==========================================================
q      places    (2, H, W)      row and column in the projector's image, in rays; the first
                                ray's middle is at 1/2
B      slopes    (2, 2, H, W)   change of q per camera row and column, in rays
====== ========= ============== ==========================================================
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import Candidates, unique_keys
from rfpipe.methods.footprints.pictures import ViewPictures
from rfpipe.methods.footprints.weights import non_negative_weights

# Width in rays over which a surface is affine; least and largest window in camera pixels.
_RAYS, _LEAST, _LARGEST = 6.0, 5, 31
# Rays around the brightest one whose mean place is a pixel's place.
_NEAR = 2.0
# Rounds of the robust fit, and distance in rays at which a place has half its weight.
_ROUNDS, _HALF = 5, 1.0
# Least share of a window's pixels that agree with its fit, within a distance in rays.
_AGREEING, _WITHIN = 0.5, 1.0
# Blurs in rays, beside a pixel's own width, of which the pictures choose one.
_BLURS = (0.3, 0.7, 1.2, 2.0, 3.0)
# Standard deviations of weights from their expectation: of expected rays, and of others, relative
# to the pixel's direct light.
_EXPECTED, _OTHER = 0.15, 0.05
# Least error of the model relative to the floodlit image.
_LEAST_MISFIT = 0.003


@dataclass(frozen=True)
class Surfaces:
    """Smooth map from a camera's image to a projector's.

    Attributes
    ----------
    places : ndarray of float64, shape (2, H, W)
        Row and column in the projector's image, in rays.
    slopes : ndarray of float64, shape (2, 2, H, W)
        Change of the row and column per camera row and column, in rays.
    smooth : ndarray of bool, shape (H, W)
        Pixels in whose window most places agree with the fit.
    """

    places: Double
    slopes: Double
    smooth: Bools


def surfaces_of(footprints: Candidates, camera: RayDomain, projector: RayDomain) -> Surfaces:
    """Fit an affine map to the places of footprints in a window around each camera pixel.

    Parameters
    ----------
    footprints : Candidates
        Footprints, with their weights.
    camera, projector : RayDomain
        Of one view each.
    """
    from scipy.ndimage import median_filter

    places, light = _places(footprints, camera, projector)
    lit = light > 0
    if not lit.any():
        return Surfaces(places, np.zeros((2, *places.shape)), lit)
    side = _window(places, lit)
    typical = np.stack([median_filter(axis, side) for axis in places])
    distance = np.linalg.norm(places - typical, axis=0)
    weight = lit * _cauchy(distance / 3)
    for _ in range(_ROUNDS):
        smooth, slopes = _affine(places, weight, side)
        distance = np.linalg.norm(places - smooth, axis=0)
        weight = lit * _cauchy(distance / _HALF)
    agreeing = _mean(lit & (distance < _WITHIN), side)
    present = _mean(lit, side)
    return Surfaces(smooth, slopes, lit & (agreeing > _AGREEING * present))


@dataclass(frozen=True)
class Boxes:
    """Expected footprints.

    Attributes
    ----------
    keys : ndarray of int64, shape (n,)
        ``i N + j`` for ray j of N of the projector in the footprint of camera pixel i; ascending.
    share : ndarray of float64, shape (n,)
        Part of the pixel's direct light.
    """

    keys: NDArray[np.int64]
    share: Double


def smoothed(
    pictures: ViewPictures, footprints: Candidates, indirect: NDArray[np.float32], boxes: Boxes
) -> Candidates:
    """Estimate the weights of footprints again, about the expected ones.

    Parameters
    ----------
    pictures : ViewPictures
        Pictures of one channel, or of the channels' sum.
    footprints : Candidates
        Footprints before.
    indirect : ndarray of float32, shape (camera pixels, pictures)
        Indirect light of the pictures.
    boxes : Boxes
        Of `expected_boxes`. A pixel without any keeps its footprint, up to what pictures say.
    """
    rays, pixels = footprints.projector_size, footprints.camera_size
    direct = np.bincount(footprints.camera_pixels, footprints.weights, pixels)
    keys = unique_keys(np.concatenate([footprints.keys, boxes.keys]))
    expected, weights = np.zeros((2, len(keys)), np.float32)
    expected[np.searchsorted(keys, boxes.keys)] = boxes.share * direct[boxes.keys // rays]
    weights[np.searchsorted(keys, footprints.keys)] = footprints.weights
    pixel = keys // rays
    is_smooth = np.bincount(boxes.keys // rays, minlength=pixels)[pixel] > 0
    deviation = np.where(expected > 0, _EXPECTED, _OTHER) * direct[pixel]
    deviation = np.where(is_smooth, deviation, np.maximum(weights, 0.03 * direct[pixel]))
    variance = np.square(deviation).astype(np.float32)
    candidates = Candidates(pixels, rays, keys, variance, weights)
    residual = (pictures.radiance - indirect).astype(np.float32)
    start = replace(candidates, weights=expected)
    wrong = _misfit(pictures, residual - start.matrix() @ pictures.patterns)
    return non_negative_weights(
        candidates,
        pictures.floodlit,
        pictures.patterns,
        residual,
        pictures.inverse_variance(wrong),
        expected,
    )


def _misfit(pictures: ViewPictures, residual: NDArray[np.float32]) -> float:
    """Return the residual of pictures beyond their noise, relative to the floodlit image."""
    lit = pictures.lit_pixels
    if not lit.any():
        return _LEAST_MISFIT
    power = np.square(residual[lit], dtype=np.float64).mean() - pictures.variance[lit].mean()
    light = np.square(pictures.floodlit[lit], dtype=np.float64).mean()
    return max(float(np.sqrt(max(power, 0) / light)), _LEAST_MISFIT)


def _places(
    footprints: Candidates, camera: RayDomain, projector: RayDomain
) -> tuple[Double, Double]:
    """Return the mean place of the light near the brightest ray, (2, H, W), and that light."""
    rays, width = projector.size, projector.image_shape[1]
    pixel, ray = np.divmod(footprints.keys, rays)
    order = np.argsort(footprints.weights, kind="stable")
    brightest = np.zeros(camera.size, np.int64)
    brightest[pixel[order]] = ray[order]
    place = np.stack(np.divmod(ray, width)) + 0.5
    middle = np.stack(np.divmod(brightest, width)) + 0.5
    near = (np.abs(place - middle[:, pixel]) <= _NEAR).all(axis=0)
    weight = footprints.weights * near
    light = np.asarray(np.bincount(pixel, weight, camera.size), np.float64)
    mean = [np.bincount(pixel, weight * axis, camera.size) for axis in place]
    places = np.stack(mean) / np.where(light > 0, light, 1)
    return places.reshape(2, *camera.image_shape), light.reshape(camera.image_shape)


def _window(places: Double, lit: Bools) -> int:
    """Return the side of a window that spans `_RAYS` rays, in camera pixels, odd."""
    # over a distance of four pixels, since neighbours may have the very same place
    steps = []
    for axis in (1, 2):
        pair_lit = np.delete(lit, range(4), axis - 1) & np.delete(lit, range(-4, 0), axis - 1)
        change = np.delete(places, range(4), axis) - np.delete(places, range(-4, 0), axis)
        steps.append(np.linalg.norm(change, axis=0)[pair_lit] / 4)
    changes = np.concatenate(steps)
    pixels = _RAYS / max(float(np.median(changes)) if changes.size else 1.0, 1e-3)
    return int(np.clip(pixels, _LEAST, _LARGEST)) // 2 * 2 + 1


def _cauchy(distance: Double) -> Double:
    """Return weights of robust least squares, 1 at distance 0, one half at 1."""
    return 1 / (1 + np.square(distance))


def _mean(image: NDArray[np.generic], side: int) -> Double:
    """Return the means of windows of an image, 0 beyond its border."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(image.astype(np.float64), side, mode="constant"))


def _affine(places: Double, weight: Double, side: int) -> tuple[Double, Double]:
    """Fit ``a + B x`` to the places in each pixel's window by weighted least squares.

    Returns
    -------
    places : ndarray of float64, shape (2, H, W)
        The fit at the pixel itself.
    slopes : ndarray of float64, shape (2, 2, H, W)
    """
    row, column = np.indices(weight.shape).astype(np.float64)
    total, total_row, total_column = (_mean(weight * term, side) for term in (1, row, column))
    # moments about the pixel itself, from those about the image's corner
    first_row, first_column = total_row - row * total, total_column - column * total
    normal = np.empty((*weight.shape, 3, 3))
    normal[..., 0, 0] = total
    normal[..., 0, 1] = normal[..., 1, 0] = first_row
    normal[..., 0, 2] = normal[..., 2, 0] = first_column
    normal[..., 1, 1] = _mean(weight * row**2, side) - row * (total_row + first_row)
    normal[..., 2, 2] = _mean(weight * column**2, side) - column * (total_column + first_column)
    normal[..., 1, 2] = normal[..., 2, 1] = (
        _mean(weight * row * column, side) - row * total_column - column * first_row
    )
    right = []
    for axis in places:
        moment = _mean(weight * axis, side)
        along_row = _mean(weight * axis * row, side) - row * moment
        along_column = _mean(weight * axis * column, side) - column * moment
        right.append(np.stack([moment, along_row, along_column], axis=-1))
    scale = np.array([1e-9, 1e-4, 1e-4]) * np.maximum(total, 1e-6)[..., None]
    solution: Double = np.linalg.solve(
        normal + scale[..., None] * np.eye(3), np.stack(right, axis=-1)
    ).astype(np.float64)
    slopes = np.moveaxis(solution[..., 1:, :], (-1, -2), (0, 1))
    return np.moveaxis(solution[..., 0, :], -1, 0), slopes


def expected_boxes(
    surfaces: Surfaces,
    footprints: Candidates,
    projector: RayDomain,
    pictures: ViewPictures,
    indirect: NDArray[np.float32],
) -> Boxes:
    """Return the footprints that smooth surfaces have, with the blur that fits pictures best."""
    residual = (pictures.radiance - indirect).astype(np.float32)
    choices = [_boxes(surfaces, footprints, projector, blur) for blur in _BLURS]
    direct = np.bincount(footprints.camera_pixels, footprints.weights, surfaces.smooth.size)
    misfits = []
    for boxes in choices:
        pixel = boxes.keys // projector.size
        weights = (boxes.share * direct[pixel]).astype(np.float32)
        part = Candidates(len(direct), projector.size, boxes.keys, weights, weights)
        misfits.append(_misfit(pictures, residual - part.matrix() @ pictures.patterns))
    return choices[int(np.argmin(misfits))]


def _boxes(surfaces: Surfaces, footprints: Candidates, projector: RayDomain, blur: float) -> Boxes:
    """Return the footprints that smooth surfaces have, of pixels with footprints."""
    height, width = projector.image_shape
    direct = np.bincount(footprints.camera_pixels, footprints.weights, surfaces.smooth.size)
    pixel = np.flatnonzero(surfaces.smooth.ravel() & (direct > 0))
    places = surfaces.places.reshape(2, -1)[:, pixel]
    extent = np.abs(surfaces.slopes).sum(axis=1).reshape(2, -1)[:, pixel]
    half = np.minimum((extent + blur) / 2, _NEAR)
    reach = int(np.ceil(half.max(initial=0.5))) + 1
    offset = np.arange(-reach, reach + 1)
    first = np.floor(places).astype(np.int64)
    overlaps = []
    for axis in (0, 1):
        ray = first[axis, :, None] + offset
        upper = np.minimum(ray + 1, (places[axis] + half[axis])[:, None])
        lower = np.maximum(ray, (places[axis] - half[axis])[:, None])
        overlap = np.maximum(upper - lower, 0) / (2 * half[axis])[:, None]
        inside = (ray >= 0) & (ray < (height, width)[axis])
        overlaps.append((ray, overlap * inside))
    (rows, down), (columns, across) = overlaps
    share = down[:, :, None] * across[:, None, :]
    ray = rows[:, :, None] * width + columns[:, None, :]
    keys = pixel[:, None, None] * projector.size + ray
    used = share > 0.01
    order = np.argsort(keys[used], kind="stable")
    return Boxes(keys[used][order], share[used][order])
