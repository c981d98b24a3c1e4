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
    """Return what is lit, (n, *shape): `references` times nothing, and all, then random rays."""
    ones = np.ones((references, *signs.shape[1:]), bool)
    return np.concatenate([~ones, ones, signs > 0])


def merged_pictures(
    brackets: Iterable[NDArray[Any]], sensor: Sensor, signs: Double, references: int
) -> Taken:
    """Merge brackets (E, ...) under the patterns of `symmetry_patterns`, for `measure_symmetry`."""
    remaining = iter(brackets)
    black = np.mean([next(remaining) for _ in range(references)], axis=0).astype(np.float32)
    merge = sensor.merging(black, references)
    merged = [merge(frames[None]) for frames in remaining]
    radiance, variance = (
        np.concatenate(images).astype(np.float64).reshape(len(merged), -1, images[0].shape[-1])
        for images in ([one.radiance for one in merged], [one.variance for one in merged])
    )
    floodlit = radiance[:references].mean(axis=0)
    pictures = signs.reshape(len(signs), -1), radiance[references:], variance[references:]
    return floodlit, variance[:references].mean(axis=0) / references, Pictures(*pictures)


def measure_rig(bench: Bench) -> Findings:
    """Show random patterns on the rays; judge their pictures."""
    arrays, settings = bench.found["rays"].arrays, bench.settings
    layout, resampling = ProjectorLayout.from_arrays(arrays), Resampling.from_arrays(arrays)
    signs = random_signs(layout.shape, settings.symmetry_patterns, 0)
    lit = list(symmetry_patterns(signs, settings.dark_frames))
    brackets = bench.take(lit, linear=True, drawn=layout.picture)
    sensor = ResampledSensor(bench.model, resampling)
    taken = merged_pictures(brackets, sensor, signs, settings.dark_frames)
    return symmetry_findings(taken, settings.tolerance)


def symmetry_findings(taken: Taken, tolerance: float) -> Findings:
    """Predict the error that asymmetry makes in relit pictures, which `tolerance` is for."""
    error, standard_error = measure_symmetry(*taken)
    facts = {
        "tolerance": tolerance,
        "error": error,
        "standard_error": standard_error,
        "error_range": with_error(error, standard_error, "{:.2%}"),
        "least_error": error - CONFIDENCE * standard_error,
        "most_error": error + CONFIDENCE * standard_error,
    }
    return Findings.of("symmetry", facts, {})
