"""Stage: brackets to radiance images with their variance."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import LockedError, StaleStoreError, StoreError
from rfpipe.jobs.job import Progress
from rfpipe.jobs.workers import Resources
from rfpipe.photometry.sensor import Merged, Sensor
from rfpipe.provenance import fingerprint, versions
from rfpipe.references import symmetry
from rfpipe.references.drift import measure_looks
from rfpipe.references.initial_brightness import measure_lamp, with_brightness
from rfpipe.references.reference_images import (
    LevelSum,
    Merger,
    chunk_patterns,
    learn_references,
    read_merger,
    runs,
    write_references,
)
from rfpipe.references.steadiness import camera_of
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
from rfpipe.units import RADIANCE_UNIT

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
    references = captured if level == 0 else folder.read_manifest(0, "merge")
    made_of: dict[str, Any] = {
        "settings": {
            "sensor": sensor.describe() if folder.is_kept else None,
            "mask_defects": mask_defects,
        },
        "captured": captured["digest"],
        "references": references[REFERENCE_BRACKETS if level == 0 else REFERENCE_IMAGES]["digest"],
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
                merger, of_rig = _learn(sensor, folder, mask_defects, divide)
                facts |= of_rig
            else:
                merger = read_merger(sensor, folder)
            lamp = facts if level == 0 else folder.read_manifest(0, "merge")
            is_steady = lamp.get(LAMP, {}).get("steady", True)
            gains, looks = measure_looks(
                folder, merger, level, divide_out=divide_out_drift, is_steady=is_steady
            )
            facts |= looks
            facts |= _merge(merger, gains, folder, level, facts, resources or Resources(), progress)
        folder.write_manifest(level, "merge", facts)
    if not keep_raw:
        _drop_raw(folder, level)


def _learn(
    sensor: Sensor, folder: AcquisitionFolder, mask_defects: bool, divide_out_drift: bool
) -> tuple[Merger, dict[str, Any]]:
    """Learn from the brackets that an acquisition begins with, and write it.

    Returns what merges, and facts for the manifest: of references, lamp and symmetry.
    """
    merger = learn_references(sensor, folder, mask_defects)
    facts: dict[str, Any] = {}
    randoms = None
    if divide_out_drift and camera_of(sensor) is not None:
        schedule = read_schedule(folder, 0)
        is_white = schedule.count == 1 and bool((schedule.batch(0, 1) == 1).all())
        lamp = measure_lamp(folder, merger, level_0_is_white=is_white)
        merger, randoms = with_brightness(merger, lamp.whites), lamp.randoms
        facts |= lamp.facts()
    facts[REFERENCE_IMAGES] = write_references(folder, merger)
    return merger, facts | symmetry.measured(folder, merger, randoms)


@dataclass(frozen=True, eq=False)
class _MergeRun:
    """Merges runs of a level's brackets and writes their images; any thread or process may."""

    merger: Merger
    gains: NDArray[np.float64] | None
    frames: Any
    images: Any
    chunk: int

    def __call__(self, first: int, last: int) -> tuple[int, list[str], LevelSum]:
        """Merge a run; return its first pattern, and the digests and the sum of its images."""
        digests: list[str] = []
        total = LevelSum.zero(self.merger.floodlit.shape)
        with self.images.adding(first) as add:
            for start in range(first, last, self.chunk):
                stop = min(start + self.chunk, last)
                merged = self.merger.merge(self.frames.read(start, stop), start)
                if self.gains is not None:
                    merged = _divided(merged, self.gains[start:stop])
                total.add(merged)
                digests += add(np.stack([merged.radiance, merged.variance], axis=1))
        return first, digests, total

    @property
    def bytes_in_hand(self) -> int:
        """Memory that a run takes while it is worked on."""
        image = 2 * self.merger.floodlit.nbytes
        # The merge by NumPy has up to five float32 copies of a bracket; images exist as such, as
        # a block and compressed.
        brackets = self.merger.black.nbytes * 5
        return brackets + self.chunk * (self.merger.black.nbytes + 3 * image) + 2 * image


def _divided(merged: Merged, gains: NDArray[np.float64]) -> Merged:
    """Return images (B, *camera_shape, C) over gains (B, C); their noise is small beside theirs."""
    over = gains.reshape(len(gains), *[1] * (merged.radiance.ndim - 2), -1)
    radiance = (merged.radiance / over).astype(np.float32)
    variance = (merged.variance / over**2).astype(np.float32)
    return Merged(radiance, variance, merged.saturated)


def _merge(
    merger: Merger,
    gains: NDArray[np.float64] | None,
    folder: AcquisitionFolder,
    level: int,
    facts: dict[str, Any],
    resources: Resources,
    progress: bool,
) -> dict[str, Any]:
    """Merge a level; return what its manifest says of the images and their sum."""
    image_shape = merger.floodlit.shape
    chunk = chunk_patterns(image_shape)
    total = LevelSum.zero(image_shape)
    with ExitStack() as stack:
        frames = stack.enter_context(folder.frames(level, "capture"))
        count = frames.shape[0]
        pieces = runs(count, image_shape)
        # a run is a shard, so that no two workers ever write the same one
        run_chunks = max(-(-(last - first) // chunk) for first, last in pieces or [(0, 1)])
        layout, shape = (chunk, run_chunks), (count, 2, *image_shape)
        merging = folder.merging(level, shape, facts["fingerprint"], layout)
        images, writer = stack.enter_context(merging)
        name = f"{name_of(level)} merge"
        bar = stack.enter_context(Progress(name, count, shown=progress))
        work = _MergeRun(merger, gains, frames, writer, chunk)
        place = folder.store(level, "merge").parent
        workers = stack.enter_context(resources.workers(work.bytes_in_hand, place))
        for first, digests, of_run in workers.results(work, pieces):
            images.enter(first, digests)
            total.join(of_run)
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


def read_level_sum(folder: AcquisitionFolder, level: int) -> LevelSum:
    """Read the sum of a level's images and of their variance."""
    arrays, _ = folder.read(level, "merge", SUMS)
    return LevelSum(arrays["radiance"], arrays["variance"])
