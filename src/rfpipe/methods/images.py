"""The images of a level, read a few at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rfpipe.methods.base import Float, LevelImages

__all__ = ["batches", "planar", "planar_batches", "rounding"]

# Images read at a time.
_BATCH_BYTES = 32 * 2**20


def batches(count: int, image_size: int) -> Iterator[tuple[int, int]]:
    """Cut a level's patterns into runs, first and after the last, whose images fit a batch.

    `image_size` is the number of an image's values.
    """
    step = max(1, _BATCH_BYTES // (image_size * np.dtype(np.float32).itemsize))
    for first in range(0, count, step):
        yield first, min(first + step, count)


def planar_batches(
    images: LevelImages, channels: int, rays: int, count: int | None = None
) -> Iterator[tuple[slice, Float, Float]]:
    """Read a level's images, or the first `count` of them, a few at a time, channel by channel.

    Yields
    ------
    slice, ndarray of float32 (C, k, rays), ndarray of float32 (C, k, rays)
        Which images; their radiance; its variance, with that of `rounding`, above 0.
    """
    for first, last in batches(images.schedule.count if count is None else count, channels * rays):
        radiance, variance = (
            np.moveaxis(part.reshape(last - first, rays, channels), -1, 0)
            for part in images.read(first, last)
        )
        yield slice(first, last), radiance, variance + rounding(radiance)


def planar(images: LevelImages, channels: int, rays: int, count: int) -> tuple[Float, Float]:
    """Read the first images of a level: radiance and variance, float32 (count, C, rays)."""
    radiance = np.empty((count, channels, rays), np.float32)
    variance = np.empty_like(radiance)
    for part, seen, spread in planar_batches(images, channels, rays, count):
        radiance[part], variance[part] = np.moveaxis(seen, 0, 1), np.moveaxis(spread, 0, 1)
    return radiance, variance


def rounding(radiance: Float) -> Float:
    """Return the variance of float32's rounding, which exact radiance has, too; at least tiny."""
    least = np.finfo(np.float32).tiny
    spread: Float = np.maximum(np.square(np.finfo(np.float32).eps * radiance), least)
    return spread
