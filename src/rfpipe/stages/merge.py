"""Stage: brackets to radiance images with their variance."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.jobs.job import Progress
from rfpipe.photometry.sensor import MergedImages, Sensor
from rfpipe.provenance import fingerprint, versions
from rfpipe.ranges import ranges
from rfpipe.references.drift import measure_drift
from rfpipe.references.image_sum import ImageSum
from rfpipe.references.initial_brightness import divide_floodlit, measure_initial_brightness
from rfpipe.references.needless_exposures import needless_exposures
from rfpipe.references.reference_brackets import REFERENCE_PARTS
from rfpipe.references.reference_images import (
    ReferenceImages,
    measure_references,
    read_references,
    write_references,
)
from rfpipe.references.steadiness import camera_model_of
from rfpipe.references.symmetry import measure_asymmetry
from rfpipe.stages.capture import read_sensor
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.schedule import read_schedule
from rfpipe.storage.base import (
    CHECK_PICTURES,
    LAMP,
    REFERENCE_IMAGES,
    SUMS,
    SYMMETRY,
    VERIFICATION,
    Facts,
    Storage,
    level_name,
    scheduled_levels,
)
from rfpipe.units import RADIANCE, RADIANCE_UNIT

_CHUNK_BYTES = 2 * 2**20
"""Size of a chunk of merged images; radiance and variance of 62 x 70 RGB rays make 100 kB."""

_CHUNKS_PER_FILE = 8
"""Chunks of a file, whose patterns a worker merges at a time: no two workers write the same file.
Large enough that the overhead of a thread or a cluster is negligible."""

_log = logging.getLogger(__name__)


def run(context: CaptureContext, level: int) -> None:
    """Merge the brackets of a level and write the manifest.

    Level 0 also measures the black level, the defects and the floodlit image, and the rig's
    symmetry if random patterns were captured for it.

    Raises
    ------
    StaleStoreError
        When settings changed and the brackets to be merged again were dropped.
    CaptureError
        When the floodlit image is black or below the black level, or a frame can't be one of the
        sensor's; names the pattern.
    IntegrityError
        When captured brackets are damaged.
    """
    storage, settings = context.storage, context.settings
    sensor = context.sensor or read_sensor(storage)
    inputs = _inputs(context, level, sensor)
    inputs_fingerprint = fingerprint([inputs, settings.code])
    if storage.current_manifest(level, "merge", inputs_fingerprint) is None:
        facts = storage.images_without_raw(level, inputs, inputs_fingerprint)
        if facts is None:
            facts = _merged_facts(context, level, sensor, inputs, inputs_fingerprint)
        storage.write_manifest(level, "merge", facts)
    if not settings.keep_raw:
        storage.drop_raw(level)


def _inputs(context: CaptureContext, level: int, sensor: Sensor) -> Facts:
    """Describe the inputs of the merge of a level, for its fingerprint."""
    storage, settings = context.storage, context.settings
    captured = storage.read_manifest(level, "capture")
    if level == 0:
        references = [captured[part]["digest"] for part in REFERENCE_PARTS if part in captured]
    else:
        references = storage.read_manifest(0, "merge")[REFERENCE_IMAGES]["digest"]
    inputs: Facts = {
        "settings": {"sensor": sensor.describe(), "mask_defects": settings.mask_defects},
        "captured": captured["digest"],
        "references": references,
    }
    if SYMMETRY in captured:
        inputs[SYMMETRY] = captured[SYMMETRY]["digest"]
    if CHECK_PICTURES in captured:
        inputs[CHECK_PICTURES] = [captured[CHECK_PICTURES]["digest"], settings.divide_out_drift]
    return inputs


def _merged_facts(
    context: CaptureContext, level: int, sensor: Sensor, inputs: Facts, inputs_fingerprint: str
) -> Facts:
    """Merge a level's brackets, write its images, and return the manifest."""
    storage, settings = context.storage, context.settings
    facts: Facts = {
        "stage": "merge",
        "level": level,
        "units": RADIANCE_UNIT,
        "inputs": inputs,
        "fingerprint": inputs_fingerprint,
        "versions": versions(),
    }
    if level == 0:
        divides = settings.divide_out_drift and CHECK_PICTURES in storage.read_manifest(
            0, "capture"
        )
        references, measured = _measure_and_write_references(context, sensor, divides)
        facts |= measured
        lamp = measured
    else:
        references = read_references(sensor, storage)
        lamp = storage.read_manifest(0, "merge")
    drift = measure_drift(
        storage, references, level, divide_out=settings.divide_out_drift,
        is_steady=lamp.get(LAMP, {}).get("steady", True),
    )  # fmt: skip
    facts |= drift.facts
    return facts | _merge_images(context, level, references, drift.gains, facts)


def chunk_patterns(image_shape: tuple[int, ...]) -> int:
    """Return the number of patterns whose radiance and variance (*camera_shape, C) make a chunk."""
    return max(1, _CHUNK_BYTES // (2 * prod(image_shape) * np.dtype(RADIANCE).itemsize))


def file_ranges(count: int, image_shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Divide a level's patterns into the ranges ``(first, last + 1)`` of its files of images.

    A worker merges and sums up the patterns of a file at a time. The ranges don't depend on memory,
    threads or cluster, so that a level's sum, the sum over its files, has the same bits everywhere.
    """
    step = _CHUNKS_PER_FILE * chunk_patterns(image_shape)
    return ranges(count, step)


def _measure_and_write_references(
    context: CaptureContext, sensor: Sensor, divide_out_drift: bool
) -> tuple[ReferenceImages, Facts]:
    """Estimate and write the reference images of an acquisition.

    Also returns the entries of reference images, lamp and symmetry test for the manifest.
    """
    storage = context.storage
    references = measure_references(sensor, storage, context.settings.mask_defects)
    facts: Facts = {}
    random_brightness = None
    if divide_out_drift and camera_model_of(sensor) is not None:
        schedule = read_schedule(storage, 0)
        is_floodlit = schedule.count == 1 and bool((schedule.batch(0, 1) == 1).all())
        brightness = measure_initial_brightness(
            storage, references, level_0_is_floodlit=is_floodlit
        )
        references = divide_floodlit(references, brightness.floodlit)
        random_brightness = brightness.random_patterns
        facts |= brightness.facts()
    facts[REFERENCE_IMAGES] = write_references(storage, references)
    _advise_on_exposures(sensor, references)
    return references, facts | measure_asymmetry(storage, references, random_brightness)


def _advise_on_exposures(sensor: Sensor, references: ReferenceImages) -> None:
    """Log the exposures that the rig could leave out."""
    camera = camera_model_of(sensor)
    needless = needless_exposures(camera, references.floodlit) if camera is not None else ()
    if needless:
        _log.info(
            "%d of %d exposures add nothing: without %s s (camera.exposures) no picture is over "
            "5 %% noisier, and no pixel more is saturated",
            len(needless), len(sensor.exposures), ", ".join(f"{t:.3g}" for t in needless),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _FileMerge:
    """Merges the brackets of a file and writes their images, in any thread or process.

    Attributes
    ----------
    references : ReferenceImages
    gains : ndarray of float64, shape (patterns, C), or None
        Brightness of the lamp at each pattern, divided out.
    store : StoredPictures
        Brackets of the level.
    images : ItemWriter
        Writer of the level's images.
    chunk : int
        Patterns per chunk.
    """

    references: ReferenceImages
    gains: NDArray[np.float64] | None
    store: Any
    images: Any
    chunk: int

    def __call__(self, first: int, last: int) -> tuple[int, list[str], ImageSum]:
        """Merge patterns ``first:last``; return `first`, and digests and sum of their images."""
        digests: list[str] = []
        total = ImageSum.zero(self.references.floodlit.shape)
        with self.images.adding(first) as add:
            for start in range(first, last, self.chunk):
                stop = min(start + self.chunk, last)
                merged = self.references.merge(self.store.read(start, stop), start)
                if self.gains is not None:
                    merged = _divided(merged, self.gains[start:stop])
                total.add_images(merged)
                digests += add(np.stack([merged.radiance, merged.variance], axis=1))
        return first, digests, total

    @property
    def memory_bytes(self) -> int:
        """Memory that the merge of a file takes."""
        image = 2 * self.references.floodlit.nbytes
        # The merge by NumPy has up to five float32 copies of a bracket; images exist as such, as
        # a block and compressed.
        brackets = self.references.merge.black.nbytes * 5
        return brackets + self.chunk * (self.references.merge.black.nbytes + 3 * image) + 2 * image


def _divided(merged: MergedImages, gains: NDArray[np.float64]) -> MergedImages:
    """Divide images (B, *camera_shape, C) by gains (B, C), whose noise is negligible."""
    divisor = gains.reshape(len(gains), *[1] * (merged.radiance.ndim - 2), -1)
    radiance = (merged.radiance / divisor).astype(np.float32)
    variance = (merged.variance / divisor**2).astype(np.float32)
    return MergedImages(radiance, variance, merged.saturated)


def _merge_images(
    context: CaptureContext,
    level: int,
    references: ReferenceImages,
    gains: NDArray[np.float64] | None,
    facts: Facts,
) -> Facts:
    """Merge a level; return the manifest's entries of the images and their sum."""
    storage = context.storage
    image_shape = references.floodlit.shape
    chunk = chunk_patterns(image_shape)
    total = ImageSum.zero(image_shape)
    with ExitStack() as stack:
        store = stack.enter_context(storage.pictures(level, "capture"))
        count = store.shape[0]
        ranges = file_ranges(count, image_shape)
        chunks_per_file = max(-(-(last - first) // chunk) for first, last in ranges or [(0, 1)])
        layout, shape = (chunk, chunks_per_file), (count, 2, *image_shape)
        images, writer = stack.enter_context(
            storage.record_images(level, shape, facts["fingerprint"], layout)
        )
        progress = Progress(
            f"{level_name(level)} merge", count, is_visible=context.settings.progress
        )
        bar = stack.enter_context(progress)
        work = _FileMerge(references, gains, store, writer, chunk)
        workers = stack.enter_context(
            context.resources.workers(work.memory_bytes, storage.folder(level))
        )
        for first, digests, file_sum in workers.results(work, ranges):
            images.enter(first, digests)
            total.add_sum(file_sum)
            bar.advance(file_sum.count)
        entry = images.entry()
    samples = count * int(np.prod(image_shape))
    if total.saturated:
        _log.warning(
            "%s: %d of %d samples are saturated in every exposure; their radiance is a "
            "lower bound. Add a shorter exposure",
            level_name(level), total.saturated, samples,
        )  # fmt: skip
    counts = {"patterns": count, **entry, "saturated": total.saturated, "samples": samples}
    arrays = {"radiance": total.radiance, "variance": total.variance}
    # stored with the sums, too: without brackets, a manifest that was removed is restored from them
    attributes = {
        "facts": facts | counts, "fingerprint": facts["fingerprint"], "units": RADIANCE_UNIT,
    }  # fmt: skip
    return {**counts, SUMS: storage.write_part(level, SUMS, arrays, **attributes)}


def drop_raw(storage: Storage) -> None:
    """Remove the brackets of all merged levels, and of the verification pictures."""
    for level in (*scheduled_levels(storage), VERIFICATION):
        if storage.exists(level, "merge"):
            storage.drop_raw(level)


def read_level_sum(storage: Storage, level: int) -> ImageSum:
    """Read the sum of a level's images and of their variance."""
    arrays, _ = storage.read(level, "merge", SUMS)
    return ImageSum(arrays["radiance"], arrays["variance"])
