"""How far a rig is from coaxial: whether light goes from camera to projector as it comes (2.10).

By random patterns that are shown for that.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.bench import Bench
from rfpipe.calibration.verdicts import Findings, with_error
from rfpipe.photometry.resampling import ResampledSensor, Resampling
from rfpipe.photometry.sensor import Sensor
from rfpipe.provenance import generator
from rfpipe.rigs.layout import ProjectorLayout

Double = NDArray[np.float64]

CONFIDENCE = 2.0
"""Standard errors that a verdict leaves to chance."""

_LEAST = float(np.finfo(np.float64).tiny)  # where there is no light at all


class Pictures(NamedTuple):
    """Radiance and variance (count, N, C) under random signs (count, N), lit where one is 1."""

    signs: Double
    radiance: Double
    variance: Double


Taken = tuple[Double, Double, Pictures]
"""The floodlit image and its variance, (N, C), and pictures under random signs."""


def random_signs(shape: tuple[int, ...], count: int, seed: int) -> Double:
    """Return patterns of random signs, (count, *shape), values -1 and 1."""
    return np.asarray(generator(seed, 1).integers(0, 2, (count, *shape)) * 2.0 - 1, np.float64)


def measure_symmetry(floodlit: Double, variance: Double, pictures: Pictures) -> tuple[float, float]:
    """Return the relative error that asymmetry brings to a relit picture, and its standard error.

    Notes
    -----
    With signs s and pictures ``c(s) = T s = 2 T p - T 1``, each pair gives
    ``s2^T T s1 - s1^T T s2 = s2^T K s1`` with ``K = T - T^T``. With independent signs for each ray
    in s2 its mean square is ``||K s1||^2``, whatever s1: random, or all ones. Symmetric
    photography stores ``T - K / 2``, so that a picture under ``p = (1 + s1) / 2`` is off by
    ``K p / 2``. The noise's own share of the mean squares is subtracted.
    """
    count = len(pictures.signs)
    images = 2 * pictures.radiance - floodlit
    noise = (4 * pictures.variance + variance).sum(axis=1)
    ahead = np.einsum("in,nc->ic", pictures.signs, floodlit) - images.sum(axis=1)
    of_ones = _mean_square(ahead, noise + variance.sum(axis=0), count)
    forward = np.einsum("jn,inc->ijc", pictures.signs, images)
    one, two = np.triu_indices(count, 1)
    difference = forward[one, two] - forward[two, one]
    of_signs = _mean_square(difference, noise[one] + noise[two], count)
    light = np.square(pictures.radiance).sum(axis=1) - pictures.variance.sum(axis=1)
    unit = max(16 * float(light.sum(axis=1).mean()), _LEAST)
    square = (of_ones[0] + of_signs[0]) / unit
    error = float(np.hypot(of_ones[1], of_signs[1])) / unit
    # a square below zero is noise; far from zero half the relative error of the square, near
    # it what the error alone would be the square of
    predicted = float(np.sqrt(max(square, 0.0)))
    return predicted, min(float(np.sqrt(error)), error / max(2 * predicted, _LEAST))


def _mean_square(difference: Double, noise: Double, count: int) -> tuple[float, float]:
    """Return the mean square of pairs (n, C) without the noise's share, and its standard error.

    `count` independent patterns made the pairs.
    """
    squares = (difference**2 - noise).sum(axis=1)
    # where nothing but noise is left, its squares spread by twice their variance
    least = np.sqrt(2 * np.square(noise).sum(axis=1).mean())
    spread = max(float(squares.std(ddof=1)), float(least))
    return float(squares.mean()), spread / float(np.sqrt(min(len(squares), count)))


def symmetry_patterns(signs: Double, references: int) -> NDArray[np.bool_]:
    """Return the lit rays of each picture, (n, *shape).

    `references` times no ray; then random rays, with all rays before, between and after them, as
    `is_white_picture` says, so that they show the lamp's drift.
    """
    is_white = is_white_picture(len(signs), references)
    lit = np.ones((len(is_white), *signs.shape[1:]), bool)
    lit[~is_white] = signs > 0
    return np.concatenate([np.zeros((references, *signs.shape[1:]), bool), lit])


def is_white_picture(count: int, references: int) -> NDArray[np.bool_]:
    """Test which pictures are white, of `count` random ones and two white ones at least."""
    whites = max(2, references)
    places = np.rint(np.linspace(0, count + whites - 1, whites)).astype(np.int64)
    return np.isin(np.arange(count + whites), places)


def merged_pictures(
    brackets: Iterable[NDArray[Any]], sensor: Sensor, signs: Double, references: int
) -> tuple[Taken, float]:
    """Merge brackets (E, ...) under the patterns of `symmetry_patterns`, for `measure_symmetry`.

    Brightness is that of the first white picture: the change of the lamp until each picture, by the
    white pictures around it, is divided out. Also returns the largest change.
    """
    remaining = iter(brackets)
    black = np.mean([next(remaining) for _ in range(references)], axis=0).astype(np.float32)
    merge = sensor.merging(black, references)
    merged = [merge(frames[None]) for frames in remaining]
    radiance, variance = (
        np.concatenate(images).astype(np.float64).reshape(len(merged), -1, images[0].shape[-1])
        for images in ([one.radiance for one in merged], [one.variance for one in merged])
    )
    is_white = is_white_picture(len(signs), references)
    light = lamp_light(radiance[is_white].sum(axis=(1, 2)), np.flatnonzero(is_white), len(is_white))
    radiance /= light[:, None, None]
    variance /= np.square(light)[:, None, None]
    floodlit = radiance[is_white].mean(axis=0), variance[is_white].mean(axis=0) / is_white.sum()
    pictures = Pictures(signs.reshape(len(signs), -1), radiance[~is_white], variance[~is_white])
    return (*floodlit, pictures), float(np.abs(light - 1).max())


def lamp_light(white: Double, places: NDArray[np.int64], count: int) -> Double:
    """Return the lamp's light at each of `count` pictures, relative to the first white one.

    Parameters
    ----------
    white : ndarray of float64, shape (n,)
        Light of the white pictures.
    places : ndarray of int64, shape (n,)
        Their places, ascending.
    count : int
    """
    if white[0] <= 0:
        return np.ones(count)
    light: Double = np.interp(np.arange(count), places, white / white[0])
    return np.asarray(np.maximum(light, _LEAST))


def measure_rig(bench: Bench) -> Findings:
    """Show random patterns on the rays; judge their pictures."""
    arrays, settings = bench.found["rays"].arrays, bench.settings
    layout, resampling = ProjectorLayout.from_arrays(arrays), Resampling.from_arrays(arrays)
    signs = random_signs(layout.shape, settings.symmetry_patterns, 0)
    lit = list(symmetry_patterns(signs, settings.dark_frames))
    brackets = bench.take(lit, linear=True, drawn=layout.picture)
    sensor = ResampledSensor(bench.model, resampling)
    taken, drift = merged_pictures(brackets, sensor, signs, settings.dark_frames)
    return symmetry_findings(taken, drift, settings.tolerance)


def symmetry_findings(taken: Taken, drift: float, tolerance: float) -> Findings:
    """Predict the error that asymmetry makes in relit pictures, which `tolerance` is for.

    `drift` is the change of the lamp's light that was divided out.
    """
    error, standard_error = measure_symmetry(*taken)
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
