"""The images of a level, read a few at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Float
from rfpipe.methods.base import SIGNIFICANCE, LevelImages
from rfpipe.patterns import Schedule
from rfpipe.photometry.camera import are_saturated
from rfpipe.ranges import ranges
from rfpipe.transport.base import Transport

_BATCH_BYTES = 32 * 2**20
"""Memory of the images that are read at a time."""


class ScheduledImages(NamedTuple):
    """`LevelImages` made of a schedule and a function that reads images of its patterns."""

    schedule: Schedule
    read: Callable[[int, int], tuple[Float, Float]]


def batches(count: int, image_size: int) -> list[tuple[int, int]]:
    """List the ranges ``first, last + 1`` of patterns whose images fit into a batch.

    `image_size` is the number of values of an image.
    """
    step = max(1, _BATCH_BYTES // (image_size * np.dtype(np.float32).itemsize))
    return ranges(count, step)


def planar_batches(
    images: LevelImages, channels: int, rays: int, first: int = 0, last: int | None = None
) -> Iterator[tuple[slice, Float, Float]]:
    """Read images ``first:last`` of a level, all by default, a few at a time, in planar form.

    Yields
    ------
    slice, ndarray of float32 (C, k, rays), ndarray of float32 (C, k, rays)
        Numbers of the images, counted from `first`; their radiance; its variance, including that
        of `rounding`, above 0.
    """
    last = images.schedule.count if last is None else last
    for begin, end in batches(last - first, channels * rays):
        radiance, variance = (
            np.moveaxis(part.reshape(end - begin, rays, channels), -1, 0)
            for part in images.read(first + begin, first + end)
        )
        yield slice(begin, end), radiance, variance + rounding(radiance)


def rounding(radiance: Float, least: float = TINY) -> Float:
    """Variance of the rounding to float32, which exact radiance has, too; at least `least`.

    By default it is above 0, for methods that divide by it.
    """
    variance: Float = np.square(np.finfo(np.float32).eps * radiance)
    return np.maximum(variance, np.float32(least)) if least > 0 else variance


def beyond_noise(
    grid: tuple[int, ...],
    cell: NDArray[np.int64],
    squared_error: NDArray[Any],
    noise: NDArray[Any],
    half_variance: NDArray[Any],
    accepted: NDArray[Any],
) -> NDArray[np.bool_]:
    """Find the cells of a grid whose error exceeds both noise and the accepted error.

    Parameters
    ----------
    grid : tuple of int
        Shape of the grid.
    cell : ndarray of int64, shape (pixels,)
        Number of the cell of each pixel.
    squared_error, noise, half_variance, accepted : ndarray, shape (pixels,)
        Squared error of each pixel; for noise alone, its expectation and half of its variance; the
        accepted squared error. The squared error of a picture with the noise variance v has the
        expectation v and the variance 2 v^2, so that the half is v^2. A chi-square of k degrees of
        freedom has the expectation k and the variance 2 k.

    Returns
    -------
    ndarray of bool, shape `grid`
    """
    error, expected, variance, limit = (
        np.bincount(cell, values.astype(np.float64), prod(grid))
        for values in (squared_error, noise, half_variance, accepted)
    )
    excess = error - expected
    is_beyond = (excess > SIGNIFICANCE * np.sqrt(2 * variance)) & (excess > limit)
    return np.asarray(is_beyond.reshape(grid))


@dataclass(frozen=True)
class Pictures:
    """Pictures of on-off patterns; the first picture of an acquisition is floodlit.

    Attributes
    ----------
    lit : ndarray of bool, shape (P, N)
        The patterns.
    radiance, variance : ndarray of float32, shape (P, C, M)
        The variance of a masked pixel is infinite: no fit, test or estimate uses it.
    """

    lit: NDArray[np.bool_]
    radiance: Float
    variance: Float

    @classmethod
    def read(
        cls, images: LevelImages, channels: int, pixels: int, first: int, last: int
    ) -> Pictures:
        """Read images ``first:last`` of a level."""
        lit = images.schedule.batch(first, last) > 0
        radiance, variance = np.empty((2, len(lit), channels, pixels), np.float32)
        for part, *planar in planar_batches(images, channels, pixels, first, last):
            radiance[part], variance[part] = (np.moveaxis(image, 0, 1) for image in planar)
        return cls(lit.reshape(len(lit), -1), radiance, variance)

    @classmethod
    def batches(
        cls, images: LevelImages, channels: int, pixels: int, first: int
    ) -> Iterator[Pictures]:
        """Read the images of a level from index `first` on, a few at a time."""
        for part, *planar in planar_batches(images, channels, pixels, first):
            lit = images.schedule.batch(first + part.start, first + part.stop) > 0
            radiance, variance = (np.moveaxis(image, 0, 1) for image in planar)
            yield cls(lit.reshape(len(lit), -1), radiance, variance)

    def select(self, pictures: slice | NDArray[np.bool_]) -> Pictures:
        """Select pictures."""
        return Pictures(self.lit[pictures], self.radiance[pictures], self.variance[pictures])

    @property
    def probes(self) -> Pictures:
        """All pictures except the floodlit one."""
        return self.select(slice(1, None))

    @property
    def floodlit(self) -> Float:
        """The floodlit image, (C, M)."""
        return np.asarray(self.radiance[0])

    @property
    def channels(self) -> int:
        """Number of colour channels."""
        return int(self.radiance.shape[1])

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the known pixels, bool (M,)."""
        return np.asarray(np.isfinite(self.variance[0]).all(axis=0))

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Mask of the known pixels that are saturated in no picture, bool (M,)."""
        saturated = are_saturated(self.radiance, self.variance).any(axis=(0, 1))
        return self.known & ~saturated

    @property
    def noise(self) -> float:
        """Noise of the floodlit image over its light; 1 if it has less light than noise."""
        measured = self.measured
        light = np.square(self.radiance[0][:, measured], dtype=np.float64).sum()
        noise = self.variance[0][:, measured].sum(dtype=np.float64)
        return float(np.sqrt(noise / light)) if light > noise else 1.0

    def has_light(self) -> bool:
        """Test whether the sum of the floodlit image is significantly above its noise."""
        known = self.known
        light = float(self.radiance[0][:, known].sum(dtype=np.float64))
        noise = float(np.sqrt(self.variance[0][:, known].sum(dtype=np.float64)))
        return light > SIGNIFICANCE * noise

    def channel(self, index: int) -> Pictures:
        """Select a channel."""
        part = slice(index, index + 1)
        return Pictures(self.lit, self.radiance[:, part], self.variance[:, part])

    def grey(self) -> Pictures:
        """Add up the channels."""
        return Pictures(
            self.lit,
            self.radiance.sum(axis=1, keepdims=True),
            self.variance.sum(axis=1, keepdims=True),
        )

    def with_masked_filled(self, shape: tuple[int, ...]) -> Pictures:
        """Fill masked pixels with the radiance of the nearest known ones.

        Models read from the floodlit image how much light a ray sends; a surface at a pixel that
        the camera doesn't see still lights other surfaces.
        """
        masked = np.asarray(np.isinf(self.variance).any(axis=(0, 1)))
        if not masked.any():
            return self
        pixel = nearest_known(~masked.reshape(shape))
        return Pictures(self.lit, self.radiance[..., pixel], self.variance)


def nearest_known(known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number of the known pixel that is nearest to each pixel of an image, int64 (pixels,)."""
    from scipy.ndimage import distance_transform_edt

    place = distance_transform_edt(~known, return_distances=False, return_indices=True)
    number: NDArray[np.int64] = np.ravel_multi_index(tuple(place), known.shape).ravel()
    return number


def relight_white(transport: Transport, patterns: NDArray[Any]) -> Float:
    """Compute a transport's pictures (P, C, M) of patterns (P, N) of white light."""
    shape = (len(patterns), transport.channels, patterns.shape[1])
    light = np.broadcast_to(patterns[:, None].astype(np.float32), shape)
    return transport.forward(light, range(transport.channels))
