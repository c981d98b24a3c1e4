"""Patterns of random signs, as light, and their images."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float, LevelImages
from rfpipe.provenance import generator

__all__ = ["as_light", "planar_batches", "random_signs", "rounding", "trimmed_mean"]

# Images read at a time.
_BATCH_BYTES = 32 * 2**20
# The share of a picture's pixels whose variance is taken: a few saturated ones have a huge one.
_TRIMMED = 0.99


def random_signs(count: int, rays: int, seed: int, level: int) -> Float:
    """Return signs, float32 (count, rays), -1 or 1, that depend on seed and level alone."""
    drawn = [generator(seed, level, n).integers(0, 2, rays) for n in range(count)]
    signs: Float = 2 * np.array(drawn, np.float32).reshape(count, rays) - 1
    return signs


def as_light(signs: Float, shape: tuple[int, ...]) -> Float:
    """Return patterns of signs q as what is shown for them, ``(1 + q) / 2``, (count, *shape).

    With the floodlit image, ``T q = 2 T (1 + q) / 2 - T 1``.
    """
    return ((1 + signs) / np.float32(2)).reshape(len(signs), *shape)


def planar_batches(
    images: LevelImages, channels: int, rays: int
) -> Iterator[tuple[slice, Float, Float]]:
    """Read a level's images a few at a time, channel by channel.

    Yields
    ------
    slice, ndarray of float32 (C, k, rays), ndarray of float32 (C, k, rays)
        Which images; their radiance; its variance, with that of `rounding`, above 0.
    """
    count = images.schedule.count
    step = max(1, _BATCH_BYTES // (channels * rays * np.dtype(np.float32).itemsize))
    for first in range(0, count, step):
        last = min(first + step, count)
        radiance, variance = (
            np.moveaxis(part.reshape(last - first, rays, channels), -1, 0)
            for part in images.read(first, last)
        )
        yield slice(first, last), radiance, variance + rounding(radiance)


def rounding(radiance: Float) -> Float:
    """Return the variance of float32's rounding, which exact radiance has, too; at least tiny."""
    least = np.finfo(np.float32).tiny
    spread: Float = np.maximum(np.square(np.finfo(np.float32).eps * radiance), least)
    return spread


def trimmed_mean(variance: Float) -> NDArray[np.float64]:
    """Average over the last axis, without pixels that are infinite and the largest few values."""
    variance = variance[..., np.isfinite(variance).all(axis=tuple(range(variance.ndim - 1)))]
    kept = ceil(_TRIMMED * variance.shape[-1])
    smallest = np.partition(variance, kept - 1, axis=-1)[..., :kept]
    mean: NDArray[np.float64] = smallest.mean(axis=-1, dtype=np.float64)
    return mean
