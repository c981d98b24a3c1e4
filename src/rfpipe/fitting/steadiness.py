"""Motion between pictures, and flicker of the lamp, from sums of pictures and complements.

A picture y and its complement y' add up to the white picture w, up to gains of the lamp and a
shift:

    y + y' = a w(x - s) + b (y - y').

====== =========== ====== ====================================================
symbol code        shape  meaning
====== =========== ====== ====================================================
a      gains       (S,)   mean of the two pictures' gains, 1 for a steady lamp
s      shifts      (S, 2) shift along rows and columns, in camera pixels
b      differences (S,)   half of the difference of the two gains
====== =========== ====== ====================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rfpipe.array_types import Double, Float
from rfpipe.fitting.known_sums import BRIGHTEST, LIT, KnownSums, PictureFault

_BLUR = 1.0  # camera pixels: standard deviation of the filter before derivatives
_MOVED, _STEADY = 0.1, 5.0  # camera pixels, and standard errors, above which a shift is motion
_FLICKER = 0.02  # relative standard deviation of pictures' light from which it is listed
_FEWEST = 4  # sums of pictures and complements from which motion and flicker are estimated


@dataclass(frozen=True)
class _Steadiness:
    """Gains and shifts of sums of pictures and complements against white.

    Attributes
    ----------
    pictures : list of tuple of int
        Pictures of each sum, in the order in which they were taken.
    gains : ndarray of float64, shape (S,)
        Mean of the gains of a picture and its complement.
    shifts : ndarray of float64, shape (S, 2)
        Along rows and columns, in camera pixels.
    differences : ndarray of float64, shape (S,)
        Half of the difference of these gains.
    errors : ndarray of float64, shape (S, 4)
        Standard errors of gains, shifts and differences.
    """

    pictures: list[tuple[int, int]]
    gains: Double
    shifts: Double
    differences: Double
    errors: Double


def unsteady(
    patterns: Float,
    pictures: Float,
    shape: tuple[int, int],
    projector_shape: tuple[int, int],
    sums: KnownSums,
    names: Sequence[str],
) -> list[PictureFault]:
    """Find motion and flicker in pictures that are in their right order."""
    if len(sums.pairs) < _FEWEST or min(shape) < 16:
        return []
    steadiness = _measure_steadiness(pictures, shape, sums)
    stripes = _stripes(patterns, projector_shape, steadiness.pictures)
    return [*_motion(steadiness, names), *_flicker(steadiness, stripes)]


def _measure_steadiness(pictures: Float, shape: tuple[int, int], sums: KnownSums) -> _Steadiness:
    """Fit gains and shift to each sum of a picture and its complement."""
    images = pictures.reshape(len(pictures), *shape)
    if sums.white:
        white = images[list(sums.white)].mean(axis=0)
    else:
        white = np.median([images[a] + images[b] for a, b in sums.pairs], axis=0)
    fits = [_gains_and_shift(images[a], images[b], white) for a, b in sums.pairs]
    values, errors = (np.array(part) for part in zip(*fits, strict=True))
    return _Steadiness([*sums.pairs], values[:, 0], values[:, 1:3], values[:, 3], errors)


def _gains_and_shift(picture: Float, complement: Float, white: Float) -> tuple[Double, Double]:
    """Fit the sum of a picture and its complement by white, moved, and by their difference.

    ``y + y' = a w(x - s) + b (y - y')``, where the picture's gain is a + b and the complement's
    a - b: light flickers from one to the other. Gauss-Newton on blurred images: white is moved by
    the current shift s, and the rest of the shift follows from a linear regression on white and
    its derivatives.

    Returns
    -------
    values, errors : ndarray of float64, shape (4,)
        a, s along rows and columns, and b; their standard errors, infinite where the scene has
        too few lit pixels or too little texture.
    """
    from scipy.ndimage import gaussian_filter, shift

    margin = 6
    inside = (slice(margin, -margin),) * 2
    smooth, total, difference = (
        gaussian_filter(image, _BLUR)
        for image in (white, picture + complement, picture - complement)
    )
    lit = smooth[inside] > LIT * np.percentile(smooth, BRIGHTEST)
    target = total[inside][lit]
    values, errors = np.array([1.0, 0, 0, 0]), np.full(4, np.inf)
    for _ in range(4):
        source = shift(smooth, values[1:3], order=1, mode="nearest")
        images = (source, *np.gradient(source), difference)
        terms = np.stack([image[inside][lit] for image in images])
        normal = np.asarray(terms @ terms.T, np.float64)
        if lit.sum() < 100 or np.linalg.cond(normal) > 1e8:
            return values, np.full(4, np.inf)
        inverse = np.linalg.inv(normal)
        solution = inverse @ np.asarray(terms @ target, np.float64)
        # blur makes about 4 pi blur^2 neighbouring pixels share their noise
        variance = (target - solution @ terms).var() * 4 * np.pi * _BLUR**2
        gain = solution[0]
        errors = np.sqrt(variance * np.diag(inverse)) / np.array([1, gain, gain, 1])
        step = np.clip(-solution[1:3] / gain, -2, 2)
        moved = np.clip(values[1:3] + step, -margin / 2, margin / 2)
        values = np.array([gain, *moved, solution[3]])
        if np.abs(step).max() < 0.1:
            break
    return values, errors


def _stripes(patterns: Float, shape: tuple[int, int], groups: Iterable[tuple[int, int]]) -> Double:
    """Return the mean contrast of neighbouring rays of each group's patterns."""
    contrast = []
    for first, *_ in groups:
        image = patterns[first].reshape(shape)
        steps = (np.abs(np.diff(image, axis=axis)) for axis in (0, 1))
        contrast.append(sum(float(step.mean()) if step.size else 0.0 for step in steps))
    return np.array(contrast)


def _motion(steadiness: _Steadiness, names: Sequence[str]) -> list[PictureFault]:
    """Find the picture from which the camera's view is shifted against the previous pictures."""
    shifts, count = steadiness.shifts, len(steadiness.shifts)
    usable = np.isfinite(steadiness.errors[:, :3]).all()
    splits = range(2, count - 1) if usable else range(0)
    best, leap, error = 0, np.zeros(2), np.inf
    for split in splits:
        groups = shifts[:split], shifts[split:]
        within = sum(((group - group.mean(axis=0)) ** 2).sum() for group in groups)
        noise = max(within / (2 * count - 4), float((steadiness.errors[:, 1:3] ** 2).mean()))
        deviation = np.sqrt(noise * (1 / split + 1 / (count - split)))
        change = groups[1].mean(axis=0) - groups[0].mean(axis=0)
        if np.hypot(*change) / deviation > np.hypot(*leap) / error:
            best, leap, error = split, change, deviation
    distance = float(np.hypot(*leap))
    if distance < _MOVED or distance < _STEADY * error:
        return []
    earlier, later = (
        sorted(picture for group in part for picture in group)
        for part in (steadiness.pictures[:best], steadiness.pictures[best:])
    )
    message = (
        f"pictures {names[later[0]]} to {names[later[-1]]} are shifted by {distance:.1f} pixels "
        f"({leap[0]:+.1f} rows, {leap[1]:+.1f} columns) against {names[earlier[0]]} to "
        f"{names[earlier[-1]]}: camera, projector or scene moved. Fix them and take the pictures "
        "again, or bin the camera's pixels so that the shift is small"
    )
    return [PictureFault("motion", tuple(later), message)]


def _flicker(steadiness: _Steadiness, stripes: Double) -> list[PictureFault]:
    """Find flicker: gains that scatter, apart from what the fineness of stripes takes."""
    # fine stripes are darker than white, where a projector's pixels affect their neighbours
    terms = np.stack([np.ones_like(stripes), stripes, stripes**2], axis=1)
    gains, errors = steadiness.gains, steadiness.errors
    if not np.isfinite(errors[:, 0]).all():
        return []
    residual = gains - terms @ np.linalg.lstsq(terms, gains, rcond=None)[0]
    # uncertain where the camera sees one side of the stripes, or stripes finer than its blur
    certain = errors[:, 3] < 2 * np.median(errors[:, 3])
    scatter = np.concatenate([residual, steadiness.differences[certain]])
    noise = np.concatenate([errors[:, 0], errors[certain, 3]])
    variance = float((scatter**2).sum()) / max(1, scatter.size - terms.shape[1])
    variance -= float((noise**2).mean())
    # half of the sum and half of the difference of two pictures have half of their variance
    flicker = np.sqrt(2 * max(variance, 0.0)) / max(float(np.median(gains)), 1e-6)
    if flicker < _FLICKER:
        return []
    pictures = tuple(sorted(picture for group in steadiness.pictures for picture in group))
    message = (
        f"lamp flicker of {100 * flicker:.0f} %: the light of the pictures has this standard "
        "deviation against white. Expose for a whole number of the lamp's periods, let the "
        "projector warm up, and switch off the camera's automatic exposure"
    )
    return [PictureFault("flicker", pictures, message)]
