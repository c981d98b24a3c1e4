"""Stage: brackets to radiance images with their variance."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import LockedError, StaleStoreError, StoreError
from rfpipe.jobs.job import Progress
from rfpipe.jobs.workers import Resources
from rfpipe.photometry.sensor import Merged, Sensor
from rfpipe.provenance import fingerprint, versions
from rfpipe.references.drift import measure_drift
from rfpipe.references.image_sum import ImageSum
from rfpipe.references.initial_brightness import divide_floodlit, measure_initial_brightness
from rfpipe.references.reference_images import (
    ReferenceImages,
    measure_references,
    read_references,
    write_references,
)
from rfpipe.references.steadiness import camera_model_of
from rfpipe.references.symmetry import measure_asymmetry
from rfpipe.stages.brackets import differing
from rfpipe.stages.capture import read_sensor
from rfpipe.stages.schedule import read_schedule
from rfpipe.storage.files import (
    CHECK_PICTURES,
    LAMP,
    REFERENCE_BRACKETS,
    REFERENCE_IMAGES,
    SUMS,
    SYMMETRY,
    VERIFICATION,
    AcquisitionFolder,
    name_of,
)
from rfpipe.store import FrameStore, drop, open_arrays, to_disk
from rfpipe.units import RADIANCE, RADIANCE_UNIT

_CHUNK_BYTES = 2 * 2**20
"""Size of a chunk of merged images; radiance and variance of 62 x 70 RGB rays make 100 kB."""

_CHUNKS_PER_PIECE = 8
"""Chunks of a piece of work, which is also a file, so that no two workers write the same file.
Large enough that the overhead of a thread or a cluster is negligible."""

_log = logging.getLogger(__name__)


def run(
    folder: AcquisitionFolder,
    level: int,
    *,
    mask_defects: bool,
    code: str,
    divide_out_drift: bool = False,
    keep_raw: bool = True,
    sensor: Sensor | None = None,
    progress: bool = True,
    resources: Resources | None = None,
) -> None:
    """Merge the brackets of a level and write the manifest.

    Parameters
    ----------
    level : int
        Level 0 also learns the black level, the defects and the floodlit image, and whether the
        rig is coaxial, where random patterns were taken for that.
    mask_defects : bool
        Whether dead and hot pixels are left out: of infinite variance in every image.
    code : str
        Digest of the code behind the stage.
    divide_out_drift : bool
        Whether images are divided by the light's brightness at their time, where looks at the
        rig measured it.
    keep_raw : bool
        Whether the brackets stay when they are merged. Where they don't, merged images that other
        code made are kept.
    sensor : Sensor, optional
        The one that took the frames; by default as its capture left it.
    resources : Resources, optional
        Memory and threads; nothing that is written depends on them.

    Raises
    ------
    StaleStoreError
        When settings changed and the brackets to merge anew were dropped.
    CaptureError
        When the floodlit image is black or below the black level, or a frame can't be one of the
        sensor's; names the pattern.
    IntegrityError
        When captured frames are damaged.
    """
    sensor = sensor or read_sensor(folder)
    captured = folder.read_manifest(level, "capture")
    first_manifest = captured if level == 0 else folder.read_manifest(0, "merge")
    references_key = REFERENCE_BRACKETS if level == 0 else REFERENCE_IMAGES
    made_of: dict[str, Any] = {
        "settings": {
            "sensor": sensor.describe() if folder.is_kept else None,
            "mask_defects": mask_defects,
        },
        "captured": captured["digest"],
        "references": first_manifest[references_key]["digest"],
        **({SYMMETRY: captured[SYMMETRY]["digest"]} if SYMMETRY in captured else {}),
    }
    if CHECK_PICTURES in captured:
        made_of[CHECK_PICTURES] = [captured[CHECK_PICTURES]["digest"], divide_out_drift]
    made_from = fingerprint([made_of, code])
    if folder.standing(level, "merge", made_from) is None:
        facts = _kept(folder, level, made_of, made_from)
        if facts is None:
            facts = {
                "stage": "merge", "level": level, "units": RADIANCE_UNIT, "made_of": made_of,
                "fingerprint": made_from, "versions": versions(),
            }  # fmt: skip
            if level == 0:
                divide = divide_out_drift and CHECK_PICTURES in captured
                references, rig_facts = _measure_and_write_references(
                    sensor, folder, mask_defects, divide
                )
                facts |= rig_facts
            else:
                references = read_references(sensor, folder)
            lamp = facts if level == 0 else folder.read_manifest(0, "merge")
            is_steady = lamp.get(LAMP, {}).get("steady", True)
            drift = measure_drift(
                folder, references, level, divide_out=divide_out_drift, is_steady=is_steady
            )
            facts |= drift.facts
            facts |= _merge(
                references, drift.gains, folder, level, facts, resources or Resources(), progress
            )
        folder.write_manifest(level, "merge", facts)
    if not keep_raw:
        _drop_raw(folder, level)


def chunk_patterns(image_shape: tuple[int, ...]) -> int:
    """Return the number of patterns whose radiance and variance (*camera_shape, C) make a chunk."""
    return max(1, _CHUNK_BYTES // (2 * prod(image_shape) * np.dtype(RADIANCE).itemsize))


def merge_pieces(count: int, image_shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Divide a level's patterns into the ranges that are merged and summed as a piece of work.

    The ranges don't depend on memory, threads or cluster, so that a level's sum, which is that of
    its pieces, has the same bits everywhere.
    """
    step = _CHUNKS_PER_PIECE * chunk_patterns(image_shape)
    return [(first, min(first + step, count)) for first in range(0, count, step)]


def _measure_and_write_references(
    sensor: Sensor, folder: AcquisitionFolder, mask_defects: bool, divide_out_drift: bool
) -> tuple[ReferenceImages, dict[str, Any]]:
    """Estimate and write the reference images of an acquisition.

    Also returns the entries of reference images, lamp and symmetry test for the manifest.
    """
    references = measure_references(sensor, folder, mask_defects)
    facts: dict[str, Any] = {}
    random_brightness = None
    if divide_out_drift and camera_model_of(sensor) is not None:
        schedule = read_schedule(folder, 0)
        is_floodlit = schedule.count == 1 and bool((schedule.batch(0, 1) == 1).all())
        brightness = measure_initial_brightness(folder, references, level_0_is_floodlit=is_floodlit)
        references = divide_floodlit(references, brightness.floodlit)
        random_brightness = brightness.random_patterns
        facts |= brightness.facts()
    facts[REFERENCE_IMAGES] = write_references(folder, references)
    return references, facts | measure_asymmetry(folder, references, random_brightness)


@dataclass(frozen=True, eq=False)
class _MergeRun:
    """Merges runs of a level's brackets and writes their images; any thread or process may."""

    references: ReferenceImages
    gains: NDArray[np.float64] | None
    frames: Any
    images: Any
    chunk: int

    def __call__(self, first: int, last: int) -> tuple[int, list[str], ImageSum]:
        """Merge a run; return its first pattern, and the digests and the sum of its images."""
        digests: list[str] = []
        total = ImageSum.zero(self.references.floodlit.shape)
        with self.images.adding(first) as add:
            for start in range(first, last, self.chunk):
                stop = min(start + self.chunk, last)
                merged = self.references.merge(self.frames.read(start, stop), start)
                if self.gains is not None:
                    merged = _divided(merged, self.gains[start:stop])
                total.add_images(merged)
                digests += add(np.stack([merged.radiance, merged.variance], axis=1))
        return first, digests, total

    @property
    def bytes_in_hand(self) -> int:
        """Memory that a run takes while it is worked on."""
        image = 2 * self.references.floodlit.nbytes
        # The merge by NumPy has up to five float32 copies of a bracket; images exist as such, as
        # a block and compressed.
        brackets = self.references.black.nbytes * 5
        return brackets + self.chunk * (self.references.black.nbytes + 3 * image) + 2 * image


def _divided(merged: Merged, gains: NDArray[np.float64]) -> Merged:
    """Return images (B, *camera_shape, C) over gains (B, C); their noise is small beside theirs."""
    over = gains.reshape(len(gains), *[1] * (merged.radiance.ndim - 2), -1)
    radiance = (merged.radiance / over).astype(np.float32)
    variance = (merged.variance / over**2).astype(np.float32)
    return Merged(radiance, variance, merged.saturated)


def _merge(
    references: ReferenceImages,
    gains: NDArray[np.float64] | None,
    folder: AcquisitionFolder,
    level: int,
    facts: dict[str, Any],
    resources: Resources,
    progress: bool,
) -> dict[str, Any]:
    """Merge a level; return what its manifest says of the images and their sum."""
    image_shape = references.floodlit.shape
    chunk = chunk_patterns(image_shape)
    total = ImageSum.zero(image_shape)
    with ExitStack() as stack:
        frames = stack.enter_context(folder.frames(level, "capture"))
        count = frames.shape[0]
        pieces = merge_pieces(count, image_shape)
        # a run is a shard, so that no two workers ever write the same one
        run_chunks = max(-(-(last - first) // chunk) for first, last in pieces or [(0, 1)])
        layout, shape = (chunk, run_chunks), (count, 2, *image_shape)
        merging = folder.merging(level, shape, facts["fingerprint"], layout)
        images, writer = stack.enter_context(merging)
        name = f"{name_of(level)} merge"
        bar = stack.enter_context(Progress(name, count, shown=progress))
        work = _MergeRun(references, gains, frames, writer, chunk)
        place = folder.store(level, "merge").parent
        workers = stack.enter_context(resources.workers(work.bytes_in_hand, place))
        for first, digests, of_run in workers.results(work, pieces):
            images.enter(first, digests)
            total.add_sum(of_run)
            bar.advance(of_run.count)
        entry = images.entry()
    samples = count * int(np.prod(image_shape))
    if total.saturated:
        _log.warning(
            "%s: %d of %d samples are saturated in every exposure; their radiance is a "
            "lower bound. Add a shorter exposure",
            name_of(level), total.saturated, samples,
        )  # fmt: skip
    counted = {"patterns": count, **entry, "saturated": total.saturated, "samples": samples}
    arrays = {"radiance": total.radiance, "variance": total.variance}
    # the manifest stands with the sums, too: raw frames may be dropped, and Snakemake removes it
    about = {"facts": facts | counted, "fingerprint": facts["fingerprint"], "units": RADIANCE_UNIT}
    return {**counted, SUMS: folder.write_part(level, SUMS, arrays, **about)}


def _kept(
    folder: AcquisitionFolder, level: int, made_of: dict[str, Any], made_from: str
) -> dict[str, Any] | None:
    """Return the manifest of merged images whose frames were dropped; None where frames are there.

    Raises StaleStoreError where the images are damaged or of other settings.
    """
    raw = folder.store(level, "capture")
    if not folder.is_kept or not FrameStore.open(raw).dropped:
        return None
    advice = f"To capture all levels again: '{folder.retaking()}', with the run's other options"
    try:
        sums = open_arrays(folder.store(level, SUMS))
        sums.read_all()
        facts: dict[str, Any] = {**sums.attributes["facts"], SUMS: sums.entry()}
        if level == 0:
            open_arrays(folder.store(0, REFERENCE_IMAGES)).read_all()
        images = FrameStore.open(folder.store(level, "merge"))
        why = "" if images.complete and not images.damaged() else "the merged images are damaged"
    except LockedError:
        raise
    except (StoreError, KeyError) as error:
        why = f"there are no whole merged images of them ({error})"
    if not why and facts["made_of"] != made_of:
        changed = differing(facts["made_of"], made_of)
        why = (
            f"what they were merged with changed ({changed}). Set that back and run again: all "
            "merged images are still there, and manifests that are missing are made again"
        )
    if why:
        raise StaleStoreError(
            f"{raw}: the raw exposures were dropped after their merge (capture.keep_raw is false), "
            f"and {why}. {advice}"
        )
    if facts["fingerprint"] != made_from:
        _log.warning(
            "%s: merged by other code than today's and kept, since the raw exposures were "
            "dropped. %s", raw, advice,
        )  # fmt: skip
    return facts


def drop_raw(folder: AcquisitionFolder) -> None:
    """Remove the raw exposures of all merged levels, and of the pictures for verification."""
    levels = [*folder.levels_above(None), VERIFICATION]
    for level in levels:
        if folder.exists(level, "merge"):
            _drop_raw(folder, level)


def _drop_raw(folder: AcquisitionFolder, level: int) -> None:
    """Remove the frames that were merged: last of all, so that it may be cut off anywhere."""
    kept = ["merge", SUMS, *([REFERENCE_IMAGES] if level == 0 else [])]
    raw = ["capture", *([REFERENCE_BRACKETS, SYMMETRY] if level == 0 else [])]
    for part in kept:
        to_disk(folder.store(level, part))
    stores = [folder.store(level, part) for part in raw]
    freed = sum(drop(store) for store in stores if store.exists())
    if freed:
        _log.info("%s: raw exposures dropped, %.3g MB", name_of(level), freed / 1e6)


def read_level_sum(folder: AcquisitionFolder, level: int) -> ImageSum:
    """Read the sum of a level's images and of their variance."""
    arrays, _ = folder.read(level, "merge", SUMS)
    return ImageSum(arrays["radiance"], arrays["variance"])
