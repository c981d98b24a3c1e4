"""Black level, defective pixels and floodlit image, estimated from the reference brackets [B.2].

The reference brackets are the first of an acquisition: all-off, then all-on. Brackets of all levels
are merged with the black level and the defects.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.photometry.defects import (
    DarkFrames,
    DefectMap,
    FrameRange,
    check_floodlit,
    find_defects,
)
from rfpipe.photometry.resampling import ResampledSensor
from rfpipe.photometry.sensor import BracketMerge, ExactSensor, MergedImages, Sensor
from rfpipe.references.exposure_advice import REMEDIES, FloodlitFault, RigKind, kind_of_rig
from rfpipe.references.image_sum import ImageSum
from rfpipe.references.reference_brackets import open_reference_brackets, reference_counts
from rfpipe.storage.base import REFERENCE_IMAGES, SYMMETRY, Storage

Brackets = NDArray[Any]

_MAX_SATURATED = 0.01
"""Share of the floodlit image that may be saturated at every exposure: highlights, no surfaces."""

_MOST_FURTHER = 8
"""Pictures of the symmetry test, and of level 0, in which dead pixels are searched for."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DefectMaskingMerge:
    """Merge of brackets with black level and defective pixels; a `BracketMerge`.

    Attributes
    ----------
    sensor : Sensor
    black : ndarray of float32, shape (E, ...)
        Mean of the all-off brackets in counts, subtracted before the merge [B.2].
    black_count : int
        Number of all-off brackets.
    defects : DefectMap or None
        Camera pixels to leave out; None when defects aren't masked.
    """

    sensor: Sensor
    black: Float
    black_count: int
    defects: DefectMap | None

    def __call__(self, frames: Brackets, first_index: int = 0) -> MergedImages:
        """Merge brackets.

        Parameters
        ----------
        frames : ndarray, shape (B, E, ...)
        first_index : int
            Number of the first bracket's pattern, for messages.

        Returns
        -------
        MergedImages
            Masked rays have a radiance of 0 and an infinite variance.
        """
        merged = self._merge_unmasked(frames, first_index)
        if self._masked is not None:
            merged.radiance[:, self._masked] = 0
            merged.variance[:, self._masked] = np.inf
        return merged

    @cached_property
    def _merge_unmasked(self) -> BracketMerge:
        return self._sensor_without_defects.bracket_merge(self.black, self.black_count)

    @cached_property
    def _sensor_without_defects(self) -> Sensor:
        """The sensor; a resampled one computes rays from good pixels only."""
        if self.defects is None or not isinstance(self.sensor, ResampledSensor):
            return self.sensor
        return self.sensor.without(self.defects.mask)

    @cached_property
    def _masked(self) -> NDArray[np.bool_] | None:
        """Mask of defective pixels, or of the rays that are covered by defective pixels only."""
        if self.defects is None or not self.defects.mask.any():
            return None
        if not isinstance(self.sensor, ResampledSensor):
            return self.defects.mask
        assert isinstance(self._sensor_without_defects, ResampledSensor)
        return self.sensor.resampling.visible & ~self._sensor_without_defects.resampling.visible


@dataclass(frozen=True)
class ReferenceImages:
    """Black level, defective pixels and floodlit image of an acquisition.

    Attributes
    ----------
    merge : DefectMaskingMerge
        Merge of brackets with the black level and the defects:
        ``references.merge(brackets, first_index)``.
    floodlit : ndarray of float32, shape (*camera_shape, C)
        Radiance under the all-on pattern, the mean of all all-on brackets. Levels are normalized to
        it, so that its noise becomes the noise of the direct light.
    floodlit_variance : ndarray of float32, shape (*camera_shape, C)
        Its variance; infinite at masked rays.
    """

    merge: DefectMaskingMerge
    floodlit: Float
    floodlit_variance: Float


def estimate_references(
    sensor: Sensor,
    black_brackets: Iterable[Brackets],
    floodlit_brackets: Iterable[Brackets],
    mask_defects: bool = True,
    rig_kind: RigKind = RigKind.DEVICES,
    further_lit: Iterable[Brackets] = (),
) -> ReferenceImages:
    """Estimate black level, defects and floodlit image from the reference brackets.

    Parameters
    ----------
    sensor : Sensor
    black_brackets, floodlit_brackets : iterable of ndarray, shape (B, E, ...)
        Batches of all-off and of all-on brackets. The all-on ones are read twice.
    mask_defects : bool
        Whether dead and hot pixels are searched for; exact radiance has none.
    rig_kind : RigKind
        Kind of the rig, for the remedies in messages.
    further_lit : iterable of ndarray, shape (B, E, ...)
        Batches of brackets of other patterns, in which dead pixels are constant, too.

    Raises
    ------
    CaptureError
        If a camera receives no light under the all-on pattern, or less than under the all-off one;
        if more than 1 % of the floodlit image is saturated at every exposure; or if every pixel is
        defective. Exact radiance may be zero.
    """
    dark = DarkFrames()
    for brackets in black_brackets:
        dark.add(brackets)
    is_camera = not isinstance(sensor, ExactSensor)
    defects = None
    if mask_defects and is_camera:
        lit = FrameRange()
        for brackets in chain(floodlit_brackets, further_lit):
            lit.add(brackets)
        defects = find_defects(dark, lit, sensor)
        _check_defects(defects)
    merge = DefectMaskingMerge(sensor, dark.mean.astype(np.float32), dark.count, defects)
    total = _sum_of(merge, floodlit_brackets)
    samples = total.count * dark.mean[0].size
    _check_saturation(total.saturated / samples, sensor, rig_kind)
    if is_camera:
        known = np.isfinite(total.variance)
        remedy = REMEDIES[FloodlitFault.DARK][rig_kind]
        check_floodlit(total.radiance[known], total.variance[known], remedy)
    floodlit = (total.radiance / total.count).astype(np.float32)
    variance = (total.variance / total.count**2).astype(np.float32)
    return ReferenceImages(merge, floodlit, variance)


def _sum_of(merge: BracketMerge, batches: Iterable[Brackets]) -> ImageSum:
    """Sum up the merged images of batches of brackets."""
    total: ImageSum | None = None
    for brackets in batches:
        merged = merge(brackets, total.count if total else 0)
        total = total or ImageSum.zero(merged.radiance.shape[1:])
        total.add_images(merged)
    assert total is not None
    return total


def _check_defects(defects: DefectMap) -> None:
    if defects.mask.all():
        raise CaptureError(
            f"all {defects.mask.size} camera pixels are dead or hot",
            remedy="check the camera and its exposures, or set merge.mask_defects to false",
        )
    if defects.mask.any():
        _log.warning(
            "%d hot and %d dead pixels: %d camera pixels are masked in all images",
            defects.hot, defects.dead, np.count_nonzero(defects.mask),
        )  # fmt: skip


def _check_saturation(share: float, sensor: Sensor, rig_kind: RigKind) -> None:
    if share > _MAX_SATURATED:
        full_scale = ""
        if isinstance(sensor, CameraModel):
            full_scale = f", at which radiance {sensor.full_scale_radiance:.3g} is full scale"
        raise CaptureError(
            f"{share:.1%} of the floodlit image is saturated even at the shortest exposure, "
            f"{sensor.exposures[0]:.3g} s{full_scale}: its light would be underestimated. "
            f"{REMEDIES[FloodlitFault.BRIGHT][rig_kind]}"
        )
    if share:
        text = "%.2g%% of the floodlit image is saturated at the shortest exposure, and clipped"
        _log.warning(text, 100 * share)


def measure_references(sensor: Sensor, storage: Storage, mask_defects: bool) -> ReferenceImages:
    """Estimate the reference images from the captured reference brackets."""
    rig_kind = kind_of_rig(storage.read_manifest(0, "capture")["rig"])
    with open_reference_brackets(storage) as brackets:
        return estimate_references(
            sensor, brackets.all_off, brackets.all_on, mask_defects, rig_kind, _further_lit(storage)
        )


def _further_lit(storage: Storage) -> Iterator[Brackets]:
    """Read the random patterns of the symmetry test, and the first patterns of level 0."""
    has_symmetry = SYMMETRY in storage.read_manifest(0, "capture")
    for part in (SYMMETRY, None) if has_symmetry else (None,):
        with storage.pictures(0, "capture", part) as store:
            count = min(store.shape[0], _MOST_FURTHER)
            yield from (store.read(index, index + 1) for index in range(count))


def write_references(storage: Storage, references: ReferenceImages) -> dict[str, Any]:
    """Write the reference images; return their entry for the manifest of level 0's merge."""
    all_off, all_on = reference_counts(storage.read_manifest(0, "capture"))
    counts = {"all_off_brackets": all_off, "all_on_brackets": all_on}
    arrays: dict[str, NDArray[Any]] = {
        "black": references.merge.black,
        "floodlit": references.floodlit,
        "floodlit_variance": references.floodlit_variance,
    }
    defects = references.merge.defects
    if defects is not None:
        arrays["defects"] = defects.mask
        counts |= {"hot": defects.hot, "dead": defects.dead}
    return {**storage.write_part(0, REFERENCE_IMAGES, arrays, counts=counts), **counts}


def read_references(sensor: Sensor, storage: Storage) -> ReferenceImages:
    """Read the reference images of an acquisition; raises the errors of `Storage.read`."""
    arrays, attributes = storage.read(0, "merge", REFERENCE_IMAGES)
    counts = attributes["counts"]
    defects = None
    if "defects" in arrays:
        defects = DefectMap(arrays["defects"], counts["hot"], counts["dead"])
    merge = DefectMaskingMerge(sensor, arrays["black"], counts["all_off_brackets"], defects)
    return ReferenceImages(merge, arrays["floodlit"], arrays["floodlit_variance"])


def read_floodlit(storage: Storage) -> tuple[Float, Float]:
    """Read the floodlit image of an acquisition and its variance, (*camera_shape, C) each."""
    arrays, _ = storage.read(0, "merge", REFERENCE_IMAGES)
    return arrays["floodlit"], arrays["floodlit_variance"]
