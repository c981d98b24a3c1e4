"""From brackets to radiance: what the merge of every level of an acquisition shares."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, islice
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.photometry.defects import (
    DarkFrames,
    DefectMap,
    check_floodlit,
    find_defects,
)
from rfpipe.photometry.resampling import ResampledSensor
from rfpipe.photometry.sensor import BracketMerge, ExactSensor, Merged, Sensor
from rfpipe.references.exposure_advice import REMEDIES, FloodlitFault, Kind, kind_of
from rfpipe.storage.files import (
    REFERENCE_BRACKETS,
    REFERENCE_IMAGES,
    AcquisitionFolder,
)
from rfpipe.units import RADIANCE

Frames = NDArray[Any]
Double = NDArray[np.float64]

# A chunk of merged images; two images of 62 x 70 RGB rays make 100 kB.
_CHUNK_BYTES = 2 * 2**20
# Enough that handing a run to a thread or a cluster costs nothing beside its work. A run is also a
# file, a shard of as many chunks, so that no two workers ever write the same one.
_CHUNKS_PER_RUN = 8
# Share of the floodlit image that may be saturated at every exposure: glints, but no surfaces.
_MOST_SATURATED = 0.01

_HELD = ("black", "floodlit", "floodlit_variance")

_log = logging.getLogger(__name__)


def chunk_patterns(image_shape: tuple[int, ...]) -> int:
    """Return how many patterns' radiance and variance (*camera_shape, C) make a chunk."""
    return max(1, _CHUNK_BYTES // (2 * prod(image_shape) * np.dtype(RADIANCE).itemsize))


def runs(count: int, image_shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Cut a level's patterns into the runs that are merged, and summed, as one piece of work.

    Whole files, and the same whatever the memory, the threads or the cluster: the sum of a level
    is that of its runs, and has the same bits everywhere.
    """
    step = _CHUNKS_PER_RUN * chunk_patterns(image_shape)
    return [(first, min(first + step, count)) for first in range(0, count, step)]


@dataclass(eq=False)
class LevelSum:
    """Sum of images and of their variance, added up one by one in float64.

    Attributes
    ----------
    radiance, variance : ndarray of float64, shape (*camera_shape, C)
    count, saturated : int
        Images, and their samples that were saturated in every exposure.
    """

    radiance: Double
    variance: Double
    count: int = 0
    saturated: int = 0

    @classmethod
    def zero(cls, image_shape: tuple[int, ...]) -> LevelSum:
        """Return the sum of no images."""
        return cls(np.zeros(image_shape), np.zeros(image_shape))

    def add(self, merged: Merged) -> None:
        """Add images, in their order."""
        for radiance, variance in zip(merged.radiance, merged.variance, strict=True):
            self.join(LevelSum(radiance, variance, 1))
        self.saturated += merged.saturated

    def join(self, later: LevelSum) -> None:
        """Add the sum of a later run."""
        self.radiance += later.radiance
        self.variance += later.variance
        self.count += later.count
        self.saturated += later.saturated


@dataclass(frozen=True)
class Merger:
    """Merges the brackets of one acquisition, with its black level and its defective pixels.

    Attributes
    ----------
    sensor : Sensor
    black : ndarray of float32, shape (E, ...)
        Mean of the all-off brackets, subtracted before the merge (thesis B.2).
    black_count : int
        How many they are.
    defects : DefectMap or None
        The camera's pixels to leave out; None where that is not wanted.
    floodlit : ndarray of float32, shape (*camera_shape, C)
        Radiance under the all-on pattern, the mean of several brackets: the images of each level
        are made to add up to it, so that its noise is the noise of the direct light.
    floodlit_variance : ndarray of float32, same shape
        Its variance.
    """

    sensor: Sensor
    black: NDArray[np.float32]
    black_count: int
    defects: DefectMap | None
    floodlit: NDArray[np.float32]
    floodlit_variance: NDArray[np.float32]

    @classmethod
    def from_references(
        cls,
        sensor: Sensor,
        black_frames: Iterable[Frames],
        floodlit_frames: Iterable[Frames],
        mask_defects: bool = True,
        kind: Kind = Kind.DEVICES,
    ) -> Merger:
        """Learn black level and defects from the first brackets of an acquisition.

        Parameters
        ----------
        black_frames, floodlit_frames : iterable of ndarray, shape (B, E, ...)
            Brackets of the all-off pattern, used up first, and of the all-on one, a few at a time.
        mask_defects : bool
            Whether to look for dead and hot pixels. Exact radiance has none.
        kind : Kind
            Kind of the rig, which remedies of too much or too little light depend on.

        Raises
        ------
        CaptureError
            If a camera sees no light under the all-on pattern, or less than under the all-off
            one, if more than a hundredth of the floodlit image is saturated at every exposure, or
            if every pixel is defective. Exact radiance may be zero.
        """
        dark = DarkFrames()
        for frames in black_frames:
            dark.add(frames)
        batches = iter(floodlit_frames)
        first = next(batches)
        is_camera = not isinstance(sensor, ExactSensor)
        defects = None
        if mask_defects and is_camera:
            defects = find_defects(dark, first[0], sensor)
            _check_defects(defects)
        nothing = np.zeros(0, np.float32)
        black = dark.mean.astype(np.float32)
        merger = cls(sensor, black, dark.count, defects, nothing, nothing)
        total: LevelSum | None = None
        for frames in chain([first], batches):
            merged = merger.merge(frames, total.count if total else 0)
            total = total or LevelSum.zero(merged.radiance.shape[1:])
            total.add(merged)
        assert total is not None
        count = total.count
        _check_saturation(total.saturated / (count * first[0, 0].size), sensor, kind)
        if is_camera:
            known = np.isfinite(total.variance)
            remedy = REMEDIES[FloodlitFault.DARK][kind]
            check_floodlit(total.radiance[known], total.variance[known], remedy)
        return replace(
            merger,
            floodlit=(total.radiance / count).astype(np.float32),
            floodlit_variance=(total.variance / count**2).astype(np.float32),
        )

    def merge(self, frames: Frames, first_index: int) -> Merged:
        """Merge brackets ``(B, E, ...)``, the first of them that of pattern `first_index`.

        What the camera doesn't know has a radiance of 0 and an infinite variance.
        """
        merged = self._merge_bracket(frames, first_index)
        if self._masked is not None:
            merged.radiance[:, self._masked] = 0
            merged.variance[:, self._masked] = np.inf
        return merged

    @cached_property
    def _merge_bracket(self) -> BracketMerge:
        return self._trusted.merging(self.black, self.black_count)

    @cached_property
    def _trusted(self) -> Sensor:
        """The sensor, whose rays take nothing from a camera's defective pixels."""
        if self.defects is None or not isinstance(self.sensor, ResampledSensor):
            return self.sensor
        return self.sensor.without(self.defects.mask)

    @cached_property
    def _masked(self) -> NDArray[np.bool_] | None:
        """Where images are unknown: at defective pixels, or at rays that see none but those."""
        if self.defects is None or not self.defects.mask.any():
            return None
        if not isinstance(self.sensor, ResampledSensor):
            return self.defects.mask
        assert isinstance(self._trusted, ResampledSensor)
        return self.sensor.resampling.seen & ~self._trusted.resampling.seen


def _check_defects(defects: DefectMap) -> None:
    if defects.mask.all():
        raise CaptureError(
            f"all {defects.mask.size} camera pixels are dead or hot; check the camera and its "
            "exposures, or set merge.mask_defects to false"
        )
    if defects.mask.any():
        _log.warning(
            "%d hot and %d dead pixels: %d camera pixels are left out of all images",
            defects.hot, defects.dead, np.count_nonzero(defects.mask),
        )  # fmt: skip


def _check_saturation(share: float, sensor: Sensor, kind: Kind) -> None:
    if share > _MOST_SATURATED:
        full = ""
        if isinstance(sensor, CameraModel):
            full = f", at which radiance {sensor.full_scale_radiance:.3g} is full scale"
        raise CaptureError(
            f"{share:.1%} of the floodlit image is saturated even at the shortest exposure, "
            f"{sensor.exposures[0]:.3g} s{full}: its light would come out too dark. "
            f"{REMEDIES[FloodlitFault.BRIGHT][kind]}"
        )
    if share:
        text = "%.2g%% of the floodlit image is saturated at the shortest exposure, and clipped"
        _log.warning(text, 100 * share)


def learn_references(sensor: Sensor, folder: AcquisitionFolder, mask_defects: bool) -> Merger:
    """Learn black level, defects and floodlit image from the reference brackets."""
    off, on = _reference_counts(folder).values()
    with folder.frames(0, "capture", REFERENCE_BRACKETS) as frames:
        brackets = (frames.read(index, index + 1) for index in range(off + on))
        black = islice(brackets, off)
        kind = kind_of(folder.read_manifest(0, "capture")["rig"])
        return Merger.from_references(sensor, black, brackets, mask_defects, kind)


def _reference_counts(folder: AcquisitionFolder) -> dict[str, int]:
    captured = folder.read_manifest(0, "capture")[REFERENCE_BRACKETS]
    return {name: captured[name] for name in ("black_frames", "floodlit_frames")}


def write_references(folder: AcquisitionFolder, merger: Merger) -> dict[str, Any]:
    """Write what was learnt from the reference brackets; return its entry for the manifest."""
    counted = _reference_counts(folder)
    arrays = {name: getattr(merger, name) for name in _HELD}
    if merger.defects is not None:
        arrays["defects"] = merger.defects.mask
        counted |= {"hot": merger.defects.hot, "dead": merger.defects.dead}
    return {**folder.write_part(0, REFERENCE_IMAGES, arrays, counted=counted), **counted}


def read_merger(sensor: Sensor, folder: AcquisitionFolder) -> Merger:
    """Read what level 0 learnt."""
    arrays, attributes = folder.read(0, "merge", REFERENCE_IMAGES)
    counted = attributes["counted"]
    defective = "defects" in arrays
    defects = DefectMap(arrays["defects"], counted["hot"], counted["dead"]) if defective else None
    held = {name: arrays[name] for name in _HELD}
    return Merger(sensor, black_count=counted["black_frames"], defects=defects, **held)


def read_floodlit(folder: AcquisitionFolder) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Read the floodlit image that level 0 measured, and its variance: (*camera_shape, C)."""
    arrays, _ = folder.read(0, "merge", REFERENCE_IMAGES)
    return arrays["floodlit"], arrays["floodlit_variance"]
