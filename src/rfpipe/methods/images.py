"""The images of a level, read a few at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float, LevelImages
from rfpipe.patterns import Schedule
from rfpipe.photometry.camera import are_saturated
from rfpipe.transport.base import Transport

# Images read at a time.
_BATCH_BYTES = 32 * 2**20


class ImagesAs(NamedTuple):
    """Images of a level for another method than the one that they were taken for."""

    schedule: Schedule
    read: Callable[[int, int], tuple[Float, Float]]


def batches(count: int, image_size: int) -> Iterator[tuple[int, int]]:
    """Cut a level's patterns into runs, first and after the last, whose images fit a batch.

    `image_size` is the number of an image's values.
    """
    step = max(1, _BATCH_BYTES // (image_size * np.dtype(np.float32).itemsize))
    for first in range(0, count, step):
        yield first, min(first + step, count)


def planar_batches(
    images: LevelImages, channels: int, rays: int, first: int = 0, last: int | None = None
) -> Iterator[tuple[slice, Float, Float]]:
    """Read a level's images, all or some, a few at a time, channel by channel.

    Yields
    ------
    slice, ndarray of float32 (C, k, rays), ndarray of float32 (C, k, rays)
        Which images, counted from the first; their radiance; its variance, with that of
        `rounding`, above 0.
    """
    last = images.schedule.count if last is None else last
    for begin, end in batches(last - first, channels * rays):
        radiance, variance = (
            np.moveaxis(part.reshape(end - begin, rays, channels), -1, 0)
            for part in images.read(first + begin, first + end)
        )
        yield slice(begin, end), radiance, variance + rounding(radiance)


def rounding(radiance: Float) -> Float:
    """Return the variance of float32's rounding, which exact radiance has, too; at least tiny."""
    least = np.finfo(np.float32).tiny
    spread: Float = np.maximum(np.square(np.finfo(np.float32).eps * radiance), least)
    return spread


SIGNIFICANT = 3.0
"""What exceeds noise by so many standard deviations is light."""


def beyond_noise(
    grid: tuple[int, ...], cell: NDArray[np.int64], *of_pixels: NDArray[Any]
) -> NDArray[np.bool_]:
    """Find the cells of a grid that are off by more than noise makes, and by more than is allowed.

    Of each pixel, which lies in `cell`: its squared errors, what noise makes of them, half of the
    variance of that, and what is allowed.
    """
    wrong, noise, chance, allowed = (
        np.bincount(cell, each.astype(np.float64), prod(grid)) for each in of_pixels
    )
    excess = wrong - noise
    beyond = (excess > SIGNIFICANT * np.sqrt(2 * chance)) & (excess > allowed)
    return np.asarray(beyond.reshape(grid))


@dataclass(frozen=True)
class Pictures:
    """Pictures of patterns of light and dark; the first of an acquisition is floodlit.

    Attributes
    ----------
    lit : ndarray of bool, shape (P, N)
        The patterns.
    radiance, variance : ndarray of float32, shape (P, C, M)
        The variance is infinite where a pixel is unknown: no fit, test or estimate looks at it.
    """

    lit: NDArray[np.bool_]
    radiance: Float
    variance: Float

    @classmethod
    def read(
        cls, images: LevelImages, channels: int, pixels: int, first: int, last: int
    ) -> Pictures:
        """Read some of a level's images."""
        lit = images.schedule.batch(first, last) > 0
        radiance, variance = np.empty((2, len(lit), channels, pixels), np.float32)
        for part, observed, spread in planar_batches(images, channels, pixels, first, last):
            radiance[part], variance[part] = np.moveaxis(observed, 0, 1), np.moveaxis(spread, 0, 1)
        return cls(lit.reshape(len(lit), -1), radiance, variance)

    def some(self, chosen: slice | NDArray[np.bool_]) -> Pictures:
        """Return some of the pictures."""
        return Pictures(self.lit[chosen], self.radiance[chosen], self.variance[chosen])

    @property
    def probes(self) -> Pictures:
        """All pictures but the floodlit one."""
        return self.some(slice(1, None))

    @property
    def floodlit(self) -> Float:
        """The floodlit image, (C, M)."""
        return np.asarray(self.radiance[0])

    @property
    def channels(self) -> int:
        """Colour channels."""
        return int(self.radiance.shape[1])

    @property
    def known(self) -> NDArray[np.bool_]:
        """Pixels that the pictures show, (M,)."""
        return np.asarray(np.isfinite(self.variance[0]).all(axis=0))

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Pixels that are known and not saturated in any picture, (M,)."""
        saturated = are_saturated(self.radiance, self.variance).any(axis=(0, 1))
        return self.known & ~saturated

    @property
    def noise(self) -> float:
        """The floodlit image's noise over its light; 1 of what is darker than that."""
        measured = self.measured
        light = np.square(self.radiance[0][:, measured], dtype=np.float64).sum()
        noise = self.variance[0][:, measured].sum(dtype=np.float64)
        return float(np.sqrt(noise / light)) if light > noise else 1.0

    def shine(self) -> bool:
        """Tell whether the floodlit image as a whole is brighter than its noise."""
        known = self.known
        light = float(self.radiance[0][:, known].sum(dtype=np.float64))
        noise = float(np.sqrt(self.variance[0][:, known].sum(dtype=np.float64)))
        return light > SIGNIFICANT * noise

    def channel(self, index: int) -> Pictures:
        """Return one channel."""
        part = slice(index, index + 1)
        return Pictures(self.lit, self.radiance[:, part], self.variance[:, part])

    def grey(self) -> Pictures:
        """Return the sum of the channels as one."""
        return Pictures(
            self.lit,
            self.radiance.sum(axis=1, keepdims=True),
            self.variance.sum(axis=1, keepdims=True),
        )

    def completed(self, shape: tuple[int, ...]) -> Pictures:
        """Return pictures whose unknown pixels are as bright as the nearest known one's.

        Models take from the floodlit image how much light a ray sends; a pixel that nobody sees
        still lights others.
        """
        unknown = np.asarray(np.isinf(self.variance).any(axis=(0, 1)))
        if not unknown.any():
            return self
        pixel = nearest(~unknown.reshape(shape))
        return Pictures(self.lit, self.radiance[..., pixel], self.variance)


def nearest(known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return for each pixel of an image the number of the nearest known one, int64 (pixels,)."""
    from scipy.ndimage import distance_transform_edt

    place = distance_transform_edt(~known, return_distances=False, return_indices=True)
    number: NDArray[np.int64] = np.ravel_multi_index(tuple(place), known.shape).ravel()
    return number


def relight_white(transport: Transport, patterns: NDArray[Any]) -> Float:
    """Compute a transport's pictures (P, C, M) of patterns (P, N) of white light."""
    shape = (len(patterns), transport.channels, patterns.shape[1])
    light = np.broadcast_to(patterns[:, None].astype(np.float32), shape)
    return transport.forward(light, range(transport.channels))
