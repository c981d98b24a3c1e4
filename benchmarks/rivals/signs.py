"""Patterns of random signs, as light, and the noise of their images."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.provenance import generator

__all__ = ["as_light", "random_signs", "trimmed_mean"]

# The share of a picture's pixels whose variance is taken: a few saturated ones have a huge one.
_TRIMMED = 0.99


def random_signs(count: int, rays: int, seed: int, level: int) -> Float:
    """Return signs, float32 (count, rays), -1 or 1, that depend on seed and level alone."""
    drawn = [generator(seed, level, n).integers(0, 2, rays) for n in range(count)]
    signs: Float = 2 * np.array(drawn, np.float32).reshape(count, rays) - 1
    return signs


def as_light(signs: Float, shape: tuple[int, ...]) -> Float:
    """Return the displayed patterns of signs q, ``(1 + q) / 2``, (count, *shape).

    With the floodlit image, ``T q = 2 T (1 + q) / 2 - T 1``.
    """
    return ((1 + signs) / np.float32(2)).reshape(len(signs), *shape)


def trimmed_mean(variance: Float) -> NDArray[np.float64]:
    """Average over the last axis, without pixels that are infinite and the largest few values."""
    variance = variance[..., np.isfinite(variance).all(axis=tuple(range(variance.ndim - 1)))]
    kept = ceil(_TRIMMED * variance.shape[-1])
    smallest = np.partition(variance, kept - 1, axis=-1)[..., :kept]
    mean: NDArray[np.float64] = smallest.mean(axis=-1, dtype=np.float64)
    return mean
