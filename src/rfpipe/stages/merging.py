"""From brackets to radiance: what the merge of every level of an acquisition shares."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.checks import check_floodlit
from rfpipe.photometry.defects import DefectMap, find_defects, repair
from rfpipe.photometry.sensor import ExactSensor, Merged, MergeOptions, Sensor
from rfpipe.rigs import BLACK_LEVEL_KEY, FLOODLIT_KEY

Frames = NDArray[Any]

# Brackets merged at a time.
_BATCH = 16
# Share of the floodlit image that may be saturated at every exposure: glints, but no surfaces.
_MOST_SATURATED = 0.01

_log = logging.getLogger(__name__)


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
    def calibrate(
        cls,
        sensor: Sensor,
        black_frames: Frames,
        floodlit_frames: Frames,
        saturation_fraction: float = 0.98,
        repair_defects: bool = True,
    ) -> Merger:
        """Learn black level and defects from the first brackets of an acquisition.

        Parameters
        ----------
        sensor : Sensor
        black_frames : ndarray, shape (K, E, ...)
            Brackets of the all-off pattern.
        floodlit_frames : ndarray, shape (F, E, ...)
            Brackets of the all-on pattern.
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
        black = black_frames.mean(axis=0, dtype=np.float64).astype(np.float32)
        options = MergeOptions(len(black_frames), saturation_fraction)
        is_camera = not isinstance(sensor, ExactSensor)
        defects = None
        if repair_defects and is_camera:
            defects = find_defects(black_frames, floodlit_frames[0], sensor)
        nothing = np.zeros(0, np.float32)
        merger = cls(sensor, black, options, defects, nothing, nothing)
        count = len(floodlit_frames)
        total: Any = 0.0
        total_variance: Any = 0.0
        saturated = 0
        for first in range(0, count, _BATCH):
            merged = merger.merge(floodlit_frames[first : first + _BATCH], first)
            total = total + merged.radiance.sum(axis=0, dtype=np.float64)
            total_variance = total_variance + merged.variance.sum(axis=0, dtype=np.float64)
            saturated += merged.saturated
        share = saturated / floodlit_frames[:, 0].size
        if share > _MOST_SATURATED:
            raise CaptureError(
                f"{share:.1%} of the floodlit image is saturated even at the shortest exposure, "
                f"{sensor.exposures[0]:.3g} s: its light would come out too dark. Add a shorter "
                "exposure, close the aperture, or dim the projector"
            )
        if saturated:
            _log.warning(
                "%.2g%% of the floodlit image is saturated even at the shortest exposure; these "
                "pixels are clipped",
                100 * share,
            )
        if is_camera:
            check_floodlit(total, total_variance)
        floodlit, variance = total / count, total_variance / count**2
        return replace(
            merger,
            floodlit=floodlit.astype(np.float32),
            floodlit_variance=variance.astype(np.float32),
        )

    def merge(self, frames: Frames, first_index: int) -> Merged:
        """Merge brackets ``(B, E, ...)``, the first of them that of pattern `first_index`."""
        merged = self.sensor.merge(
            frames, self.black, replace(self.options, first_index=first_index)
        )
        if self.defects is None or not self.defects.mask.any():
            return merged
        radiance, variance = repair(merged.radiance, merged.variance, self.defects.mask)
        return Merged(radiance, variance, merged.saturated)


def reference_patterns(
    projector_shape: tuple[int, ...], black_frames: int, floodlit_frames: int
) -> tuple[NDArray[np.float32], list[tuple[int, ...]]]:
    """Return the patterns that an acquisition begins with, and their keys for the rig.

    `black_frames` times all off, then `floodlit_frames` times all on: what `Merger.calibrate`
    learns from.
    """
    patterns = np.zeros((black_frames + floodlit_frames, *projector_shape), np.float32)
    patterns[black_frames:] = 1
    keys: list[tuple[int, ...]] = [(BLACK_LEVEL_KEY, index) for index in range(black_frames)]
    return patterns, keys + [(FLOODLIT_KEY, index) for index in range(floodlit_frames)]
