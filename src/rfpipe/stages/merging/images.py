"""The images of a level as a method reads them: merged, then normalized on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Method
from rfpipe.patterns import Schedule
from rfpipe.photometry.normalize import Mode, Normalization, apply, level_gain
from rfpipe.stages.merging.merger import LevelSum
from rfpipe.transport import Transport

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


def no_images(schedule: Schedule, normalization: Normalization) -> NormalizedImages:
    """Return the images of a level without patterns; `normalization` tells their shape."""
    nothing = np.empty((0, *normalization.gain.shape), np.float32)
    return NormalizedImages(schedule, ImagesInMemory(nothing, nothing), normalization)


def masked_rays(floodlit_variance: Float) -> NDArray[np.bool_]:
    """Return the camera rays that no image knows, (*camera_shape), of a variance with channels."""
    return np.asarray(np.isinf(floodlit_variance).any(axis=-1))


def known_light(method: Method[Any], state: Any, schedule: Schedule) -> Float | None:
    """Predict the light of the rays that a level no longer lights.

    Returns
    -------
    ndarray of float32, shape (*camera_shape, C), or None
        None where the level lights every ray that can send light.
    """
    if schedule.complete or not schedule.count or schedule.pattern_of_ray is None:
        return None
    transport: Transport = method.known(state)
    return transport.relight(schedule.pattern_of_ray < 0)


def normalize_level(
    schedule: Schedule,
    level_sum: LevelSum,
    floodlit: tuple[Float, Float],
    known: Float | None,
    mode: Mode,
    significance: float,
) -> Normalization:
    """Compare the sum of a level's images with the floodlit image (thesis B.2).

    Where the level leaves rays dark whose light is known already, that light is taken off the
    floodlit image first. A pixel that has most of its light from such rays is left as it is: the
    difference would be all noise.

    Parameters
    ----------
    schedule : Schedule
    level_sum : LevelSum
        Sum of the level's images and of their variance.
    floodlit : tuple of two ndarrays of float32, shape (*camera_shape, C)
        The floodlit image and its variance.
    known : ndarray of float32, shape (*camera_shape, C), or None
        Light of the rays that the level does not light, see `known_light`.
    mode : {"none", "per_channel", "total_energy"}
    significance : float
        Standard deviations that make a sum significant.
    """
    radiance, spread = floodlit
    wanted = mode != "none" and (schedule.complete or known is not None)
    expected = radiance if known is None else radiance - known
    found = level_gain(
        expected, level_sum.radiance, level_sum.variance, mode, wanted, significance, spread
    )
    if known is None:
        return found
    covered = found.covered & (known < expected)
    gain = np.where(covered, found.gain, np.float32(1))
    return Normalization(gain, covered, mode)
