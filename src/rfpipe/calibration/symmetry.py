"""Symmetry test: deviation of the transport of a coaxial rig from ``T = T^T`` (2.10).

It is estimated from pictures of random patterns.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.calibration.context import StepContext
from rfpipe.calibration.verdicts import Findings, with_error
from rfpipe.photometry.resampling import ResampledSensor, Resampling
from rfpipe.photometry.sensor import Sensor
from rfpipe.provenance import generator
from rfpipe.rigs.layout import ProjectorLayout

CONFIDENCE = 2.0
"""Standard errors on either side of the estimate within which a verdict is uncertain."""

_LEAST = float(np.finfo(np.float64).tiny)  # avoids dividing by zero without any light


class SignPictures(NamedTuple):
    """Pictures under patterns of random signs; a ray is lit where its sign is 1.

    Attributes
    ----------
    signs : ndarray of float64, shape (count, N)
        -1 or 1.
    radiance, variance : ndarray of float32 or float64, shape (count, N, C)
    """

    signs: Double
    radiance: NDArray[Any]
    variance: NDArray[Any]


SymmetryImages = tuple[Double, Double, SignPictures]
"""The floodlit image and its variance, (N, C), and pictures under random signs."""


def random_signs(shape: tuple[int, ...], count: int, seed: int) -> Double:
    """Draw patterns of random signs, float64 (count, *shape), values -1 and 1."""
    return np.asarray(generator(seed, 1).integers(0, 2, (count, *shape)) * 2.0 - 1, np.float64)


def measure_symmetry(
    floodlit: Double, variance: Double, pictures: SignPictures
) -> tuple[float, float]:
    """Estimate the relative error of relit pictures due to asymmetry, and its standard error.

    Notes
    -----
    With signs s and pictures ``c(s) = T s = 2 T p - T 1``, each pair gives
    ``s2^T T s1 - s1^T T s2 = s2^T K s1`` with ``K = T - T^T``. With independent signs for each ray
    in s2, its mean square is ``||K s1||^2`` for any s1: random, or all ones. Symmetric photography
    stores ``T - K / 2``, so that a picture under ``p = (1 + s1) / 2`` has the error
    ``K p / 2 = (K 1 + K s1) / 4``, whose mean square is ``(||K 1||^2 + ||K s1||^2) / 16``. Relative
    to ``||T p||^2`` it is the squared result. The expected mean square of the noise is subtracted.
    """
    count, channels = len(pictures.signs), floodlit.shape[1]
    of_floodlit = variance.sum(axis=0)
    noise = 4 * pictures.variance.sum(axis=1, dtype=np.float64) + of_floodlit
    total, light = np.empty((2, count, channels))
    forward = np.empty((count, count, channels))
    # picture by picture, to save memory
    for index, picture in enumerate(pictures.radiance):
        light[index] = np.einsum("nc,nc->c", picture, picture, dtype=np.float64)
        image = 2 * picture - floodlit
        total[index] = image.sum(axis=0)
        forward[:, index] = pictures.signs @ image
    ahead = pictures.signs @ floodlit - total
    of_ones = _mean_square(ahead, noise + of_floodlit, count)
    first, second = np.triu_indices(count, 1)
    difference = forward[first, second] - forward[second, first]
    of_signs = _mean_square(difference, noise[first] + noise[second], count)
    light -= pictures.variance.sum(axis=1, dtype=np.float64)
    unit = max(16 * float(light.sum(axis=1).mean()), _LEAST)
    square = (of_ones[0] + of_signs[0]) / unit
    error = float(np.hypot(of_ones[1], of_signs[1])) / unit
    # standard error of the square root: error / (2 root) for a large root, sqrt(error) near zero
    predicted = float(np.sqrt(max(square, 0.0)))
    return predicted, min(float(np.sqrt(error)), error / max(2 * predicted, _LEAST))


def _mean_square(difference: Double, noise: Double, count: int) -> tuple[float, float]:
    """Mean square of differences (n, C) less their variance `noise`, and its standard error.

    `count` is the number of independent patterns in the pairs.
    """
    squares = (difference**2 - noise).sum(axis=1)
    # the square of pure noise has twice the squared variance of the noise as its variance
    least = np.sqrt(2 * np.square(noise).sum(axis=1).mean())
    spread = max(float(squares.std(ddof=1)), float(least))
    return float(squares.mean()), spread / float(np.sqrt(min(len(squares), count)))


def symmetry_test_patterns(signs: Double, references: int) -> NDArray[np.bool_]:
    """Lit rays of each picture of the test, bool (n, *shape).

    First `references` black patterns, then the random patterns, with white ones before, between and
    after them (see `is_white_picture`), which measure the drift of the lamp.
    """
    is_white = is_white_picture(len(signs), references)
    lit = np.ones((len(is_white), *signs.shape[1:]), bool)
    lit[~is_white] = signs > 0
    return np.concatenate([np.zeros((references, *signs.shape[1:]), bool), lit])


def is_white_picture(count: int, references: int) -> NDArray[np.bool_]:
    """Positions of the white pictures, evenly distributed among `count` random ones, bool (n,).

    There are `references` white pictures, and at least two.
    """
    whites = max(2, references)
    positions = np.rint(np.linspace(0, count + whites - 1, whites)).astype(np.int64)
    return np.isin(np.arange(count + whites), positions)


def merged_pictures(
    brackets: Iterable[NDArray[Any]], sensor: Sensor, signs: Double, references: int
) -> tuple[SymmetryImages, float]:
    """Merge the brackets (E, ...) of `symmetry_test_patterns` for `measure_symmetry`.

    The change of the lamp since the first white picture, interpolated between white pictures, is
    divided out. The largest relative change is returned, too.
    """
    remaining = iter(brackets)
    black = np.mean([next(remaining) for _ in range(references)], axis=0).astype(np.float32)
    merge = sensor.bracket_merge(black, references)
    merged = [merge(frames[None]) for frames in remaining]
    radiance, variance = (
        np.concatenate(images).astype(np.float64).reshape(len(merged), -1, images[0].shape[-1])
        for images in ([m.radiance for m in merged], [m.variance for m in merged])
    )
    is_white = is_white_picture(len(signs), references)
    light = lamp_light(radiance[is_white].sum(axis=(1, 2)), np.flatnonzero(is_white), len(is_white))
    radiance /= light[:, None, None]
    variance /= np.square(light)[:, None, None]
    floodlit = radiance[is_white].mean(axis=0), variance[is_white].mean(axis=0) / is_white.sum()
    pictures = SignPictures(signs.reshape(len(signs), -1), radiance[~is_white], variance[~is_white])
    return (*floodlit, pictures), float(np.abs(light - 1).max())


def lamp_light(white: Double, places: NDArray[np.int64], count: int) -> Double:
    """Interpolate the lamp's light at each of `count` pictures, relative to the first white one.

    Parameters
    ----------
    white : ndarray of float64, shape (n,)
        Light of the white pictures.
    places : ndarray of int64, shape (n,)
        Positions of the white pictures, ascending.
    count : int
    """
    if white[0] <= 0:
        return np.ones(count)
    light: Double = np.interp(np.arange(count), places, white / white[0])
    return np.asarray(np.maximum(light, _LEAST))


def measure_rig(context: StepContext) -> Findings:
    """Show random patterns on the calibrated rays, and test the symmetry of the transport."""
    arrays, settings = context.findings["rays"].arrays, context.settings
    layout, resampling = ProjectorLayout.from_arrays(arrays), Resampling.from_arrays(arrays)
    signs = random_signs(layout.shape, settings.symmetry_patterns, 0)
    lit = symmetry_test_patterns(signs, settings.dark_frames)
    brackets = context.brackets(map(layout.picture, lit), len(lit), linear=True)
    sensor = ResampledSensor(context.model, resampling)
    images, drift = merged_pictures(brackets, sensor, signs, settings.dark_frames)
    return symmetry_findings(images, drift, settings.tolerance)


def symmetry_findings(images: SymmetryImages, drift: float, tolerance: float) -> Findings:
    """Compare the error of relit pictures due to asymmetry with `tolerance`.

    `drift` is the largest relative change of the lamp's light, which was divided out.
    """
    error, standard_error = measure_symmetry(*images)
    facts = {
        "tolerance": tolerance,
        "drift": drift,
        "error": error,
        "standard_error": standard_error,
        "error_range": with_error(error, standard_error, "{:.2%}"),
        "least_error": error - CONFIDENCE * standard_error,
        "most_error": error + CONFIDENCE * standard_error,
    }
    return Findings.of("symmetry", facts, {})
