"""The images of a level, read a few at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Float, LevelImages
from rfpipe.patterns import Schedule

__all__ = [
    "FloodlitImage",
    "RenumberedImages",
    "batches",
    "planar_batches",
    "read_planar",
    "renumbered",
    "rounding",
]

# Images read at a time.
_BATCH_BYTES = 32 * 2**20


@dataclass(frozen=True)
class RenumberedImages:
    """Images of a level under the number that another method has for it."""

    schedule: Schedule
    images: LevelImages

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return radiance and variance of some patterns."""
        return self.images.read(first, last)


@dataclass(frozen=True)
class FloodlitImage:
    """A floodlit image that is there already, as the images of level 0."""

    schedule: Schedule
    image: tuple[Float, Float]

    @classmethod
    def of(
        cls, camera: RayDomain, projector: RayDomain, radiance: Float, variance: Float
    ) -> FloodlitImage:
        """Take radiance and variance, float32 (C, pixels)."""
        shape = (1, *camera.shape, len(radiance))
        one, other = (np.ascontiguousarray(each.T).reshape(shape) for each in (radiance, variance))
        return cls(Schedule.floodlit(projector.shape), (one, other))

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return radiance and variance."""
        radiance, variance = self.image
        return radiance[first:last], variance[first:last]


def renumbered(images: LevelImages, level: int) -> RenumberedImages:
    """Return a level's images under another number."""
    return RenumberedImages(replace(images.schedule, level=level), images)


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


def read_planar(images: LevelImages, channels: int, rays: int, count: int) -> tuple[Float, Float]:
    """Read the first images of a level, radiance and variance, float32 (count, C, rays).

    As `planar_batches`.
    """
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
