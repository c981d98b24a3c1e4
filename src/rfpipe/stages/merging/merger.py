"""From brackets to radiance: what the merge of every level of an acquisition shares."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.checks import check_floodlit, warn_if_dim
from rfpipe.photometry.defects import DarkFrames, DefectMap, Repair, find_defects
from rfpipe.photometry.resampling import ResampledSensor
from rfpipe.photometry.sensor import BracketMerge, ExactSensor, Merged, MergeOptions, Sensor
from rfpipe.rigs import BLACK_LEVEL_KEY, FLOODLIT_KEY
from rfpipe.units import RADIANCE

Frames = NDArray[Any]
Double = NDArray[np.float64]
Keys = list[tuple[int, ...]]

# A file of merged images; two images of 62 x 70 RGB rays make 100 kB.
_CHUNK_BYTES = 2 * 2**20
# Enough that handing a run to a thread or a cluster costs nothing beside its work.
_CHUNKS_PER_RUN = 8
# Share of the floodlit image that may be saturated at every exposure: glints, but no surfaces.
_MOST_SATURATED = 0.01

_log = logging.getLogger(__name__)


def chunk_patterns(image_shape: tuple[int, ...]) -> int:
    """Return how many patterns' radiance and variance (*camera_shape, C) lie in one file."""
    return max(1, _CHUNK_BYTES // (2 * prod(image_shape) * np.dtype(RADIANCE).itemsize))


def runs(count: int, image_shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Cut a level's patterns into the runs that are merged, and summed, as one piece of work.

    Whole files, and the same whatever the memory, the threads or the cluster: the sum of a level
    is that of its runs, and has the same bits everywhere.
    """
    step = _CHUNKS_PER_RUN * chunk_patterns(image_shape)
    return [(first, min(first + step, count)) for first in range(0, count, step)]


@dataclass(frozen=True, eq=False)
class LevelSum:
    """Sum of images and of their variance, added up one by one in float64.

    Attributes
    ----------
    radiance, variance : ndarray of float64, shape (*camera_shape, C)
    """

    radiance: Double
    variance: Double

    @classmethod
    def zero(cls, image_shape: tuple[int, ...]) -> LevelSum:
        """Return the sum of no images."""
        return cls(np.zeros(image_shape), np.zeros(image_shape))

    def add(self, merged: Merged) -> None:
        """Add images, in their order."""
        for radiance, variance in zip(merged.radiance, merged.variance, strict=True):
            np.add(self.radiance, radiance, out=self.radiance)
            np.add(self.variance, variance, out=self.variance)

    def join(self, later: LevelSum) -> None:
        """Add the sum of a later run."""
        np.add(self.radiance, later.radiance, out=self.radiance)
        np.add(self.variance, later.variance, out=self.variance)


@dataclass(frozen=True)
class Merger:
    """Merges the brackets of one acquisition, with its black level and its defective pixels.

    Attributes
    ----------
    sensor : Sensor
    black : ndarray of float32, shape (E, ...)
        Mean of the all-off brackets, subtracted before the merge (thesis B.2).
    options : MergeOptions
    defects : DefectMap or None
        Pixels to fill in from their neighbours; None where that is not wanted.
    floodlit : ndarray of float32, shape (*camera_shape, C)
        Radiance under the all-on pattern, the mean of several brackets: the images of each level
        are made to add up to it, so that its noise is the noise of the direct light.
    floodlit_variance : ndarray of float32, same shape
        Its variance.
    """

    sensor: Sensor
    black: NDArray[np.float32]
    options: MergeOptions
    defects: DefectMap | None
    floodlit: NDArray[np.float32]
    floodlit_variance: NDArray[np.float32]

    @classmethod
    def from_references(
        cls,
        sensor: Sensor,
        black_frames: Iterable[Frames],
        floodlit_frames: Iterable[Frames],
        saturation_fraction: float = 0.98,
        repair_defects: bool = True,
    ) -> Merger:
        """Learn black level and defects from the first brackets of an acquisition.

        Parameters
        ----------
        sensor : Sensor
        black_frames : iterable of ndarray, shape (B, E, ...)
            Brackets of the all-off pattern, a few at a time; used up before the others.
        floodlit_frames : iterable of ndarray, shape (B, E, ...)
            Brackets of the all-on pattern, likewise.
        saturation_fraction : float
            Counts from this fraction of full scale on are not used.
        repair_defects : bool
            Whether to look for dead and hot pixels. Exact radiance has none.

        Raises
        ------
        CaptureError
            If a camera sees no light under the all-on pattern, or less than under the all-off
            one, or if more than a hundredth of the floodlit image is saturated at every
            exposure. Exact radiance may be zero.
        """
        dark = DarkFrames()
        for frames in black_frames:
            dark.add(frames)
        options = MergeOptions(dark.count, saturation_fraction)
        batches = iter(floodlit_frames)
        first = next(batches)
        is_camera = not isinstance(sensor, ExactSensor)
        defects = None
        if repair_defects and is_camera:
            defects = find_defects(dark, first[0], sensor)
        nothing = np.zeros(0, np.float32)
        merger = cls(sensor, dark.mean.astype(np.float32), options, defects, nothing, nothing)
        total: LevelSum | None = None
        count = saturated = samples = 0
        for frames in chain([first], batches):
            merged = merger.merge(frames, count)
            total = total or LevelSum.zero(merged.radiance.shape[1:])
            total.add(merged)
            count += len(frames)
            saturated += merged.saturated
            samples += frames[:, 0].size
        assert total is not None
        _check_saturation(saturated / samples, sensor)
        if is_camera:
            check_floodlit(total.radiance, total.variance)
            warn_if_dim(total.radiance / count, total.variance / count)
        return replace(
            merger,
            floodlit=(total.radiance / count).astype(np.float32),
            floodlit_variance=(total.variance / count**2).astype(np.float32),
        )

    def merge(self, frames: Frames, first_index: int) -> Merged:
        """Merge brackets ``(B, E, ...)``, the first of them that of pattern `first_index`."""
        merged = self._merge_bracket(frames, first_index)
        if self._repair is None:
            return merged
        radiance, variance = self._repair(merged.radiance, merged.variance)
        return Merged(radiance, variance, merged.saturated)

    @cached_property
    def _merge_bracket(self) -> BracketMerge:
        sensor = self.sensor
        if self._has_defects and isinstance(sensor, ResampledSensor):
            assert self.defects is not None
            sensor = sensor.without(self.defects.mask)
        return sensor.merging(self.black, self.options)

    @property
    def _has_defects(self) -> bool:
        return self.defects is not None and bool(self.defects.mask.any())

    @cached_property
    def _repair(self) -> Repair | None:
        # rays take nothing from defective pixels of a camera behind a resampling
        if (
            self.defects is None
            or not self._has_defects
            or isinstance(self.sensor, ResampledSensor)
        ):
            return None
        return Repair(self.defects.mask)


def _check_saturation(share: float, sensor: Sensor) -> None:
    if share > _MOST_SATURATED:
        raise CaptureError(
            f"{share:.1%} of the floodlit image is saturated even at the shortest exposure, "
            f"{sensor.exposures[0]:.3g} s: its light would come out too dark. Add a shorter "
            "exposure, close the aperture, or dim the projector"
        )
    if share:
        _log.warning(
            "%.2g%% of the floodlit image is saturated even at the shortest exposure; these "
            "pixels are clipped",
            100 * share,
        )


def reference_patterns(
    projector_shape: tuple[int, ...], black_frames: int, first: int, last: int
) -> tuple[NDArray[np.float32], Keys]:
    """Return some of the patterns that an acquisition begins with, and their keys for the rig.

    They are `black_frames` times all off, then all on: what `Merger.from_references` learns from.
    """
    indices = range(first, last)
    patterns = np.zeros((len(indices), *projector_shape), np.float32)
    patterns[max(0, black_frames - first) :] = 1
    keys: Keys = [
        (BLACK_LEVEL_KEY, index) if index < black_frames else (FLOODLIT_KEY, index - black_frames)
        for index in indices
    ]
    return patterns, keys
