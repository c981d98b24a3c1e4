"""Stage: brackets to radiance images with their variance."""

from __future__ import annotations

import logging
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import LockedError, StoreError
from rfpipe.photometry.sensor import Merged, Sensor
from rfpipe.provenance import fingerprint, versions
from rfpipe.stages import symmetry
from rfpipe.stages.capturing import moves
from rfpipe.stages.capturing.drift import DRIFT, measure
from rfpipe.stages.capturing.moves import MOVES
from rfpipe.stages.folder import REFERENCE, AcquisitionFolder, name_of
from rfpipe.stages.jobs.progress import Progress
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.merging.merger import LevelSum, Merger, chunk_patterns, runs
from rfpipe.stages.merging.raw import RawFrames
from rfpipe.stages.merging.references import (
    REFERENCES,
    intact_bundle,
    learn_references,
    read_merger,
)
from rfpipe.stages.results import standing
from rfpipe.store import (
    FrameStore,
    ItemWriter,
    drop,
    open_arrays,
    read_manifest,
    to_disk,
    write_arrays,
    write_manifest,
)
from rfpipe.units import RADIANCE, RADIANCE_UNIT

__all__ = ["SUMS", "MergedFrames", "read_level_sum", "run"]

Float = NDArray[np.float32]
Double = NDArray[np.float64]

SUMS = "sums"
"""Sum of the level's images and of their variance: their store and manifest's key."""

_COPY = "manifest.json"

_log = logging.getLogger(__name__)


def run(
    sensor: Sensor,
    folder: AcquisitionFolder,
    level: int,
    *,
    saturation_fraction: float,
    mask_defects: bool,
    code: str,
    divide_out_drift: bool = False,
    keep_raw: bool = True,
    resources: Resources | None = None,
) -> None:
    """Merge the brackets of a level and write the manifest.

    Parameters
    ----------
    sensor : Sensor
        The one that took the frames.
    folder : AcquisitionFolder
    level : int
        Level 0 also learns the black level, the defects and the floodlit image, and whether the
        rig is coaxial, where random patterns were taken for that.
    saturation_fraction : float
        Counts from this fraction of full scale on are not used.
    mask_defects : bool
        Whether dead and hot pixels are left out: of infinite variance in every image.
    code : str
        Digest of the code behind the stage.
    divide_out_drift : bool
        Whether images are divided by the light's brightness at their time, where a drift watch
        measured it.
    keep_raw : bool
        Whether the brackets stay when they are merged. Where they don't, merged images that other
        code made are kept.
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
    resources = resources or Resources()
    settings: dict[str, Any] = {
        "sensor": sensor.describe(),
        "saturation_fraction": saturation_fraction,
        "mask_defects": mask_defects,
    }
    if level == 0:
        merger, references = learn_references(sensor, folder, settings, code, resources)
    else:
        references = folder.read_manifest(0, "merge")[REFERENCES]
        merger = read_merger(sensor, folder, saturation_fraction)
    captured = folder.read_manifest(level, "capture")
    made_of = {
        "settings": settings,
        "captured": captured["digest"],
        "references": references["digest"],
    }
    if DRIFT in captured:
        made_of[DRIFT] = [captured[DRIFT]["digest"], divide_out_drift]
    if MOVES in captured:
        made_of[MOVES] = captured[MOVES]["digest"]
    made_from = fingerprint([made_of, code])
    store = folder.store(level, "merge")
    manifest = folder.manifest(level, "merge")
    facts = standing(manifest, made_from)
    is_new = facts is None
    if is_new:
        facts = _kept(folder, level, made_of, made_from)
    if facts is None:
        # A merge is quick beside its capture, so that one that was interrupted starts anew.
        FrameStore.discard(store)
        gains, drift = _drift(merger, folder, level, captured, divide_out_drift)
        facts = {
            "stage": "merge",
            "level": level,
            "units": RADIANCE_UNIT,
            **({REFERENCES: references} if level == 0 else {}),
            **_merge(merger, gains, folder, level, made_from, resources),
            **drift,
            **_moves(merger, folder, level, captured),
            "made_of": made_of,
            "fingerprint": made_from,
            "versions": versions(),
        }
        write_manifest(store / _COPY, facts)
    if is_new:
        write_manifest(manifest, facts)
    if level == 0:
        symmetry.run(
            sensor, folder,
            saturation_fraction=saturation_fraction, code=code, keep_raw=keep_raw,
        )  # fmt: skip
    if not keep_raw:
        _drop_raw(folder, level)


@dataclass(frozen=True, eq=False)
class _MergeRun:
    """Merges runs of a level's brackets and writes their images; any thread or process may."""

    merger: Merger
    gains: Double | None
    captured: Path
    merged: Path
    made_from: str
    chunk: int

    def __call__(self, first: int, last: int) -> tuple[int, list[str], LevelSum]:
        """Merge a run; return its first pattern, and the digests and the sum of its images."""
        digests: list[str] = []
        total = LevelSum.zero(self.merger.floodlit.shape)
        with self._images.adding(first) as add:
            for start in range(first, last, self.chunk):
                stop = min(start + self.chunk, last)
                merged = self.merger.merge(self._frames.read(start, stop), start)
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

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the open stores: a cluster's workers pass the work on among themselves."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def _frames(self) -> FrameStore:
        return FrameStore.open(self.captured)

    @cached_property
    def _images(self) -> ItemWriter:
        return ItemWriter(self.merged, self.made_from)


def _drift(
    merger: Merger,
    folder: AcquisitionFolder,
    level: int,
    captured: dict[str, Any],
    divide_out: bool,
) -> tuple[Double | None, dict[str, Any]]:
    """Report what a drift watch saw: return gains (patterns, C) to divide by, and facts."""
    if DRIFT not in captured:
        return None, {}
    every = captured[DRIFT]["every"]
    with folder.frames(level, "capture", DRIFT) as frames:
        drift = measure(merger, frames)
    drift.report(name_of(level), divided_out=divide_out)
    gains = drift.gains_at(captured["patterns"], every) if divide_out else None
    return gains, {DRIFT: {**drift.facts(every), "divided_out": divide_out}}


def _moves(
    merger: Merger, folder: AcquisitionFolder, level: int, captured: dict[str, Any]
) -> dict[str, Any]:
    """Return what looks at the rig saw, if there were any."""
    if MOVES not in captured:
        return {}
    with folder.frames(level, "capture", MOVES) as frames:
        found = moves.measure(folder, merger, frames)
    return {MOVES: {"every": captured[MOVES]["every"], **found}}


def _divided(merged: Merged, gains: Double) -> Merged:
    """Return images (B, *camera_shape, C) over gains (B, C); their noise is small beside theirs."""
    over = gains.reshape(len(gains), *[1] * (merged.radiance.ndim - 2), -1)
    radiance = (merged.radiance / over).astype(np.float32)
    variance = (merged.variance / over**2).astype(np.float32)
    return Merged(radiance, variance, merged.saturated)


def _merge(
    merger: Merger,
    gains: Double | None,
    folder: AcquisitionFolder,
    level: int,
    made_from: str,
    resources: Resources,
) -> dict[str, Any]:
    image_shape = merger.floodlit.shape
    store = folder.store(level, "merge")
    chunk = chunk_patterns(image_shape)
    total = LevelSum.zero(image_shape)
    with folder.frames(level, "capture") as frames:
        count = frames.shape[0]
        pieces = runs(count, image_shape)
        # a run is a shard, so that no two workers ever write the same one
        run_chunks = max(-(-(last - first) // chunk) for first, last in pieces or [(0, 1)])
        shape = (count, 2, *image_shape)
        about = {"axis 1": ["radiance", "variance"], "units": RADIANCE_UNIT}
        merger = replace(merger, options=replace(merger.options, brackets=count))
        # a cluster's workers have working folders of their own
        captured, merged = frames.path.absolute(), store.absolute()
        work = _MergeRun(merger, gains, captured, merged, made_from, chunk)
        with (
            FrameStore.create(
                store,
                shape,
                RADIANCE,
                made_from,
                about,
                items_per_chunk=chunk,
                chunks_per_file=run_chunks,
            ) as images,
            resources.workers(work.bytes_in_hand, store.parent) as workers,
        ):
            with Progress(f"{name_of(level)} merge", count, quick=True) as progress:
                for first, digests, of_run in workers.results(work, pieces):
                    images.enter(first, digests)
                    total.join(of_run)
                    progress.advance(of_run.count)
            entry = images.entry()
    samples = count * int(np.prod(image_shape))
    if total.saturated:
        _log.warning(
            "%s: %d of %d samples are saturated in every exposure; their radiance is a "
            "lower bound. Add a shorter exposure",
            name_of(level), total.saturated, samples,
        )  # fmt: skip
    sums = folder.store(level, SUMS)
    arrays = {"radiance": total.radiance, "variance": total.variance}
    write_arrays(sums, arrays, {"fingerprint": made_from, "units": RADIANCE_UNIT})
    return {
        "patterns": count,
        **entry,
        "saturated": total.saturated,
        "samples": samples,
        SUMS: open_arrays(sums).entry(),
    }


def _kept(
    folder: AcquisitionFolder, level: int, made_of: dict[str, Any], made_from: str
) -> dict[str, Any] | None:
    """Return the manifest of merged images whose frames were dropped; None where frames are there.

    Raises StaleStoreError where the images are damaged or of other settings.
    """
    raw = RawFrames(folder, level, "capture")
    if not raw.dropped:
        return None
    copy = folder.store(level, "merge") / _COPY
    try:
        facts = read_manifest(copy)
    except StoreError:
        raw.must_be_there("there are no whole merged images of them")
        raise
    if facts["fingerprint"] != made_from:
        raw.must_be_unchanged(facts["made_of"], made_of)
    if not _is_intact(folder, level, facts):
        raw.must_be_there("the merged images are damaged")
    return facts


def _is_intact(folder: AcquisitionFolder, level: int, facts: dict[str, Any]) -> bool:
    made_from = facts["fingerprint"]
    if intact_bundle(folder.store(level, SUMS), made_from) is None:
        return False
    store = folder.store(level, "merge")
    try:
        FrameStore.open(store)  # or one would be made where the header is missing
        shape = tuple(facts["shape"])
        with FrameStore.create(store, shape, facts["dtype"], made_from, {}) as images:
            return images.complete
    except LockedError:
        raise
    except StoreError as error:
        _log.warning("made anew, since it is damaged: %s", error)
        return False


def _drop_raw(folder: AcquisitionFolder, level: int) -> None:
    """Remove the frames that were merged: last of all, so that it may be cut off anywhere."""
    kept = ["merge", SUMS, *([REFERENCES] if level == 0 else [])]
    raw = ["capture", *([REFERENCE] if level == 0 else [])]
    for part in kept:
        to_disk(folder.store(level, part))
    freed = sum(drop(folder.store(level, part)) for part in raw)
    if freed:
        _log.info("%s: raw exposures dropped, %.3g MB", name_of(level), freed / 1e6)


def read_level_sum(folder: AcquisitionFolder, level: int) -> LevelSum:
    """Read the sum of a level's images and of their variance."""
    arrays, _ = folder.read(level, "merge", SUMS)
    return LevelSum(arrays["radiance"], arrays["variance"])


@dataclass(frozen=True)
class MergedFrames:
    """The merged images of a level as they lie on disk; see `rfpipe.stages.merging.images`."""

    frames: FrameStore

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return radiance and variance of patterns ``first:last``."""
        images = self.frames.read(first, min(last, self.frames.shape[0]))
        return images[:, 0], images[:, 1]
