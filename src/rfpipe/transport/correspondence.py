"""Place of the projector that lights each camera pixel directly, computed from a transport.

Direct light comes from few rays that lie together, indirect light from all around. Relit stripes
locate the former to a ray: each coarse pattern of a Gray code is combined with the finest one, so
that all have fine stripes, and indirect light is the same under either half of them [Gupta et al.,
A practical approach to 3D scanning in the presence of interreflections, subsurface scattering and
defocus, IJCV 2013]. Relit dots, spaced so that one alone is near the place, then give single
entries of the transport around it, whose mean place is taken.

The confidence is a logistic model of the probability that a place is within one ray of the truth:

    log(c / (1 - c)) = b + m log(a) + n log(s)

| symbol | code name | shape | meaning |
|---|---|---|---|
| c | ``confidence`` | camera | probability, 0 to 1 |
| a | ``agreement`` | camera | share of neighbours whose affine trend agrees within one ray |
| s | ``share`` | camera | share of the floodlit light that comes from around the place |
| b, m, n | `_WITH_NOISE` or `_WITHOUT_NOISE` | 1 | coefficients, by whether the noise is known |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.gray_code import gray_bits, gray_code, gray_number
from rfpipe.transport.algebra import MatrixAlgebra

_APART = 8  # pixels between dots; entries are read up to half as many around the place
_NEAR = 2  # pixels around the brightest entry whose mean place is taken

# Maximum likelihood on simulated captures of seven scenes: Gray code at whites of 5 to 100 standard
# deviations, and acquisitions. Where the noise is known, few wrong places are left to recognise.
# Further terms (light over noise, light of a second place, extent of the light, distance from the
# picture's edge, squares) lower the loss on scenes left out by at most 6 %.
_WITH_NOISE = (7.08, 2.07, 2.54)
_WITHOUT_NOISE = (6.98, 2.65, 3.43)
_LEAST_SHARE = 0.03  # smaller shares count as this

_LEAST_CONFIDENCE = 0.5  # in the mask
_DARK = 1e-3  # of the brightest pixel's light
_DEVIATIONS = 8  # lit pixels exceed this number of standard deviations of a picture's noise

# Steps (rows, columns) to one of each two opposite neighbours in a window of 5 x 5 pixels, and to
# the eight neighbours of a window of 3 x 3.
_WINDOW = [(down, right) for down in range(-2, 3) for right in range(-2, 3)]
_OPPOSITE = [step for step in _WINDOW if step > (0, 0)]
_ADJACENT = [step for step in _WINDOW if max(map(abs, step)) == 1]


@dataclass(frozen=True)
class Correspondence:
    """Places of the projector's picture that light camera pixels directly.

    Attributes
    ----------
    places : ndarray of float32, shape (*camera_shape, 2)
        Row and column in the projector's picture, in pixels from its upper left corner: the first
        pixel's middle is at one half.
    confidence : ndarray of float32, shape (*camera_shape)
        Probability, 0 to 1, that a place is within one pixel of the true one; 0 where the pixel is
        dark. See the module's equation.
    mask : ndarray of bool, shape (*camera_shape)
        True where the confidence is at least one half. Dark pixels are outside: those with less
        than a thousandth of the brightest pixel's light under full light or, where
        `Relightable.noise` is known, with at most eight standard deviations of it.
    """

    places: Float
    confidence: Float
    mask: Bools


def correspondence_of(transport: MatrixAlgebra, noise: Float | None = None) -> Correspondence:
    """Compute the place of the projector that lights each camera pixel directly.

    Parameters
    ----------
    transport : MatrixAlgebra
        Its projector has one picture.
    noise : ndarray of float32, shape (*camera_shape), optional
        Standard deviation of one picture, see `Relightable.noise`; separates lit from dark pixels.

    Raises
    ------
    InputError
        If the projector is a stack of views, or no light arrives.
    """
    shape = transport.projector_shape
    if RayDomain(shape).views > 1:
        raise InputError(f"the projector's rays {shape} are several views; crop one of them first")
    floodlit = _relit(transport, np.ones((1, *shape), np.float32))[0]
    if not floodlit.max() > 0:
        raise InputError("no camera pixel receives light from the projector; there are no places")
    coarse = [_coordinate(transport, floodlit, axis) for axis in (0, 1)]
    places, light = _mean_places(_around(transport, coarse), coarse)
    lit, coefficients = (floodlit > _DARK * floodlit.max()) & (light > 0), _WITHOUT_NOISE
    if noise is not None:
        lit &= floodlit > _DEVIATIONS * noise.ravel()
        coefficients = _WITH_NOISE
    share = np.divide(light, floodlit, out=np.zeros_like(light), where=lit)
    camera, stack = transport.camera_shape, RayDomain(transport.camera_shape).stack_shape
    agreement = _agreement(places.reshape(*stack, 2), lit.reshape(stack)).ravel()
    confidence = np.where(lit, _probability(agreement, share, coefficients), 0)
    return Correspondence(
        places.astype(np.float32).reshape(*camera, 2),
        confidence.astype(np.float32).reshape(camera),
        (confidence >= _LEAST_CONFIDENCE).reshape(camera),
    )


def _mean_places(entries: Float, coarse: list[Index]) -> tuple[Double, Double]:
    """Compute the mean place of the light near the brightest entry, and that light.

    Parameters
    ----------
    entries : ndarray of float32, shape (rows, columns, camera rays)
        Radiance from each pixel around the coarse places, see `_around`.
    coarse : list of two ndarrays of int64, shape (camera rays,)
        Rows and columns of the coarse places.

    Returns
    -------
    places, light : ndarray of float64, shapes (camera rays, 2) and (camera rays,)
    """
    # light from everywhere is equal in all dots
    contrast = entries - np.median(entries, axis=(0, 1))
    offset = np.arange(_APART) - _APART // 2
    best = np.argmax(contrast.reshape(_APART**2, -1), axis=0)
    brightest = [offset[index] for index in np.unravel_index(best, (_APART, _APART))]
    near = [np.abs(offset[:, None] - index) <= _NEAR for index in brightest]
    weight = np.maximum(contrast, 0) * near[0][:, None] * near[1][None]
    light = weight.sum(axis=(0, 1), dtype=np.float64)
    places = [
        middle + 0.5 + np.tensordot(offset, weight.sum(axis=1 - axis), 1) / np.maximum(light, 1e-30)
        for axis, middle in enumerate(coarse)
    ]
    return np.stack(places, axis=-1), light


def _probability(
    agreement: Double, share: Double, coefficients: tuple[float, float, float]
) -> Double:
    """Evaluate the module's equation for a and s of shape (camera rays,) and (b, m, n)."""
    base, per_agreement, per_share = coefficients
    logit = (
        base
        + per_agreement * np.log(agreement)
        + per_share * np.log(np.clip(share, _LEAST_SHARE, 1))
    )
    return 1 / (1 + np.exp(-logit))


def _agreement(places: Double, lit: Bools) -> Double:
    """Compute the share of affine predictions from neighbours that agree with each place.

    Predictions are the means of the 12 pairs of opposite neighbours within 5 x 5 pixels, and the
    extrapolations along 8 lines of two neighbours; they agree if at most one ray off. With k of n
    predictions inside the picture agreeing, the share is (k + 1/2) / (n + 1). Dark neighbours
    disagree.

    Parameters
    ----------
    places : ndarray of float64, shape (views, height, width, 2)
    lit : ndarray of bool, shape (views, height, width)

    Returns
    -------
    ndarray of float64, shape (views, height, width)
    """
    _, height, width = lit.shape
    border = ((0, 0), (2, 2), (2, 2))
    known = np.where(lit[..., None], places, np.nan)
    padded = np.pad(known, (*border, (0, 0)), constant_values=np.nan)
    within = np.pad(np.ones_like(lit), border)
    agreeing, available = np.zeros(lit.shape), np.zeros(lit.shape)

    def moved(array: NDArray[Any], step: tuple[int, int]) -> NDArray[Any]:
        down, right = step
        return array[:, 2 + down : 2 + down + height, 2 + right : 2 + right + width]

    # prediction = first weight * first neighbour + second weight * second neighbour
    interpolations = [((0.5, step), (0.5, (-step[0], -step[1]))) for step in _OPPOSITE]
    extrapolations = [((2.0, step), (-1.0, (2 * step[0], 2 * step[1]))) for step in _ADJACENT]
    for (first_weight, first), (second_weight, second) in (*interpolations, *extrapolations):
        prediction = first_weight * moved(padded, first) + second_weight * moved(padded, second)
        residual = prediction - known
        agreeing += (residual**2).sum(axis=-1) <= 1
        available += moved(within, first) & moved(within, second)
    return (agreeing + 0.5) / (available + 1)


def _relit(transport: MatrixAlgebra, patterns: Float) -> Float:
    """Relight with patterns (P, *projector_shape); pictures (P, camera rays), channels summed."""
    channels = range(transport.channels)
    planar = patterns.reshape(len(patterns), 1, -1).repeat(len(channels), axis=1)
    images: Float = transport.forward(planar, channels).sum(axis=1)
    return images


def _coordinate(transport: MatrixAlgebra, floodlit: Float, axis: int) -> Index:
    """Decode rows (axis 0) or columns (axis 1) of the places to one pixel, (camera rays,)."""
    shape = transport.projector_shape[-2:]
    code = gray_code(np.arange(shape[axis] + 1), max(1, gray_bits(shape[axis])))
    candidates = []
    # pixels at an edge of the finest stripes are decoded from the stripes moved by one pixel
    for fine in (code[-1, :-1], code[-1, 1:]):
        lines = np.stack([fine, *(code[:, :-1] ^ fine)])
        along = np.expand_dims(lines, 2 - axis)
        images = _relit(transport, np.broadcast_to(along, (len(lines), *shape)).astype(np.float32))
        above = images - floodlit / 2
        lit = (above[1:] > 0) ^ (above[0] > 0)
        candidates.append((np.abs(above[0]), gray_number(lit)))
    (clear, first), (clearer, second) = candidates
    place_of: Index = np.where(clearer > clear, second, first)
    return np.minimum(place_of, shape[axis] - 1)


def _around(transport: MatrixAlgebra, coarse: list[Index]) -> Float:
    """Read the transport's entries around each coarse place, (rows, columns, camera rays)."""
    shape = transport.projector_shape[-2:]
    row, column = np.indices(shape)
    entries = np.empty((_APART, _APART, len(coarse[0])), np.float32)
    # position in the window of the dots of each offset
    shift = np.arange(_APART)[:, None] - (coarse[0] - _APART // 2)
    across = np.arange(_APART)[:, None] - (coarse[1] - _APART // 2)
    pixel = np.arange(len(coarse[0]))
    for first in range(_APART):
        lit = (row % _APART == first) & (column % _APART == np.arange(_APART)[:, None, None])
        images = _relit(transport, lit.astype(np.float32))
        for second, image in enumerate(images):
            entries[shift[first] % _APART, across[second] % _APART, pixel] = image
    return entries
