"""The images of a level as a method reads them: merged, then normalized on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.patterns import Schedule
from rfpipe.photometry.normalize import Mode, Normalization, apply, level_gain

Float = NDArray[np.float32]


class MergedImages(Protocol):
    """Radiance and variance of a level's patterns, wherever they lie."""

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return both of patterns ``first:last``, float32 ``(last - first, *camera_shape, C)``."""


@dataclass(frozen=True)
class ImagesInMemory:
    """Merged images held in memory."""

    radiance: Float
    variance: Float

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return radiance and variance of patterns ``first:last``."""
        return self.radiance[first:last], self.variance[first:last]


@dataclass(frozen=True)
class NormalizedImages:
    """The images of a level, scaled to add up to the floodlit image as they are read (B.2)."""

    schedule: Schedule
    merged: MergedImages
    normalization: Normalization

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return normalized radiance and its variance of patterns ``first:last``."""
        return apply(*self.merged.read(first, last), self.normalization)


def normalize_level(
    schedule: Schedule,
    merged: MergedImages,
    floodlit: Float,
    mode: Mode,
    significance: float,
    batch: int = 16,
) -> Normalization:
    """Compare the sum of a level's images with the floodlit image (thesis B.2).

    Parameters
    ----------
    schedule : Schedule
    merged : MergedImages
    floodlit : ndarray of float32, shape (*camera_shape, C)
    mode : {"none", "per_channel", "total_energy"}
    significance : float
        Standard deviations that make a sum significant.
    batch : int
        Images read at a time.
    """
    total = np.zeros(floodlit.shape)
    total_variance = np.zeros(floodlit.shape)
    if mode != "none" and schedule.complete:
        for first in range(0, schedule.count, batch):
            radiance, variance = merged.read(first, min(first + batch, schedule.count))
            total += radiance.sum(axis=0, dtype=np.float64)
            total_variance += variance.sum(axis=0, dtype=np.float64)
    return level_gain(floodlit, total, total_variance, mode, schedule.complete, significance)
