"""Stage: brackets to radiance images with their variance."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.defects import DefectMap
from rfpipe.photometry.sensor import MergeOptions, Sensor
from rfpipe.provenance import fingerprint, versions
from rfpipe.stages.capture import REFERENCE
from rfpipe.stages.merging import Merger
from rfpipe.stages.plan import AcquisitionFolder, advice_on_damage
from rfpipe.stages.results import bundle_entry
from rfpipe.store import FrameStore, open_arrays, read_manifest, write_arrays, write_manifest
from rfpipe.units import RADIANCE, RADIANCE_UNIT

__all__ = ["CALIBRATION", "MergedFrames", "merged_frames", "read_floodlit", "run"]

Float = NDArray[np.float32]

CALIBRATION = "calibration"
"""Black level, defects and floodlit image, learnt at level 0: their store and manifest's key."""

# Both read and written at a time; two images of 62 x 70 RGB rays make 100 kB.
_CHUNK_BYTES = 2 * 2**20
_BATCH_BYTES = 16 * 2**20
_COPY = "manifest.json"

_log = logging.getLogger(__name__)


def run(
    sensor: Sensor,
    folder: AcquisitionFolder,
    level: int,
    *,
    saturation_fraction: float,
    repair_defects: bool,
    code: str,
) -> None:
    """Merge the brackets of a level and write the manifest.

    Parameters
    ----------
    sensor : Sensor
        The one that took the frames.
    folder : AcquisitionFolder
    level : int
        Level 0 also learns the black level, the defects and the floodlit image.
    saturation_fraction : float
        Counts from this fraction of full scale on are not used.
    repair_defects : bool
        Whether dead and hot pixels are filled in from their neighbours.
    code : str
        Fingerprint of the code behind the stage.

    Raises
    ------
    CaptureError
        When the floodlit image is black or below the black level, or a frame can't be one of the
        sensor's; names the pattern.
    IntegrityError
        When captured frames are damaged.
    """
    captured = folder.read_manifest(level, "capture")
    settings: dict[str, Any] = {
        "sensor": sensor.describe(),
        "saturation_fraction": saturation_fraction,
        "repair_defects": repair_defects,
        "code": code,
    }
    calibration: dict[str, Any]
    if level == 0:
        merger, calibration = _calibrate(sensor, folder, settings)
    else:
        calibration = folder.read_manifest(0, "merge")[CALIBRATION]
        merger = _read_merger(sensor, folder, saturation_fraction)
    made_from = fingerprint([settings, calibration["digest"], captured["digest"]])
    store = folder.store(level, "merge")
    facts = _kept(store, made_from)
    if facts is None:
        # A merge is quick beside its capture, so that one that was interrupted starts anew.
        FrameStore.discard(store)
        facts = {
            "stage": "merge",
            "level": level,
            "units": RADIANCE_UNIT,
            **({CALIBRATION: calibration} if level == 0 else {}),
            **_merge(merger, folder, level, made_from),
            "fingerprint": made_from,
            "versions": versions(),
        }
        write_manifest(store / _COPY, facts)
    write_manifest(folder.manifest(level, "merge"), facts)


def _merge(merger: Merger, folder: AcquisitionFolder, level: int, made_from: str) -> dict[str, Any]:
    with folder.frames(level, "capture") as frames:
        count = frames.shape[0]
        image = (2, *merger.floodlit.shape)  # radiance, variance
        nbytes = int(np.prod(image)) * np.dtype(RADIANCE).itemsize
        chunk = max(1, _CHUNK_BYTES // nbytes)
        batch = max(1, _BATCH_BYTES // nbytes)
        saturated = 0
        with FrameStore.create(
            folder.store(level, "merge"),
            (count, *image),
            RADIANCE,
            made_from,
            {"axis 1": ["radiance", "variance"], "units": RADIANCE_UNIT},
            items_per_chunk=chunk,
        ) as images:
            for first, last in images.missing(batch):
                merged = merger.merge(frames.read(first, last), first)
                images.write(first, np.stack([merged.radiance, merged.variance], axis=1))
                saturated += merged.saturated
            digest = images.digest()
    samples = count * int(np.prod(image[1:]))
    if saturated:
        _log.warning(
            "level %d: %d of %d samples are saturated in every exposure; their radiance is a "
            "lower bound. Add a shorter exposure",
            level, saturated, samples,
        )  # fmt: skip
    return {
        "patterns": count,
        "digest": digest,
        "dtype": np.dtype(RADIANCE).str,
        "shape": [count, *image],
        "saturated": saturated,
        "samples": samples,
    }


def _kept(store: Path, made_from: str) -> dict[str, Any] | None:
    """Return the manifest of a store that was made from the same things and is undamaged."""
    copy = store / _COPY
    if not copy.exists():
        return None
    with advice_on_damage(copy):
        facts = read_manifest(copy)
    if facts["fingerprint"] != made_from:
        return None
    with FrameStore.create(store, tuple(facts["shape"]), facts["dtype"], made_from, {}) as images:
        if not images.complete:  # a damaged chunk
            return None
    _log.info("%s: made from the same things before; kept", store)
    return facts


def _calibrate(
    sensor: Sensor, folder: AcquisitionFolder, settings: dict[str, Any]
) -> tuple[Merger, dict[str, Any]]:
    """Learn from the reference brackets and write what was learnt; also its manifest entry."""
    captured = folder.read_manifest(0, "capture")[REFERENCE]
    with folder.frames(0, "capture", REFERENCE) as frames:
        brackets = frames.read(0, frames.shape[0])
    off, on = np.split(brackets, [captured["black_frames"]])
    merger = Merger.calibrate(
        sensor, off, on, settings["saturation_fraction"], settings["repair_defects"]
    )
    arrays: dict[str, NDArray[Any]] = {
        "black": merger.black,
        "floodlit": merger.floodlit,
        "floodlit_variance": merger.floodlit_variance,
    }
    counted = {"black_frames": len(off), "floodlit_frames": len(on)}
    if merger.defects is not None:
        arrays["defects"] = merger.defects.mask
        counted |= {"hot": merger.defects.hot, "dead": merger.defects.dead}
        if merger.defects.hot or merger.defects.dead:
            _log.warning(
                "%d hot and %d dead pixels are filled in from their neighbours",
                merger.defects.hot, merger.defects.dead,
            )  # fmt: skip
    store = folder.store(0, CALIBRATION)
    made_from = fingerprint([settings, captured["digest"]])
    write_arrays(store, arrays, {"fingerprint": made_from, "counted": counted})
    return merger, {**bundle_entry(open_arrays(store)), **counted}


def _read_merger(sensor: Sensor, folder: AcquisitionFolder, saturation_fraction: float) -> Merger:
    bundle = folder.bundle(0, "merge", CALIBRATION)
    counted = bundle.attributes["counted"]
    with advice_on_damage(folder.manifest(0, "merge")):
        defects = None
        if "defects" in bundle.names:
            defects = DefectMap(bundle.read("defects"), counted["hot"], counted["dead"])
        options = MergeOptions(counted["black_frames"], saturation_fraction)
        black, *floodlit = (bundle.read(n) for n in ("black", "floodlit", "floodlit_variance"))
        return Merger(sensor, black, options, defects, *floodlit)


def read_floodlit(folder: AcquisitionFolder) -> tuple[Float, Float]:
    """Read the floodlit image that level 0 measured, and its variance: (*camera_shape, C)."""
    bundle = folder.bundle(0, "merge", CALIBRATION)
    with advice_on_damage(folder.manifest(0, "merge")):
        return bundle.read("floodlit"), bundle.read("floodlit_variance")


@dataclass(frozen=True)
class MergedFrames:
    """The merged images of a level as they lie on disk; see `rfpipe.stages.images`."""

    frames: FrameStore

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return radiance and variance of patterns ``first:last``."""
        images = self.frames.read(first, min(last, self.frames.shape[0]))
        return images[:, 0], images[:, 1]


@contextmanager
def merged_frames(folder: AcquisitionFolder, level: int) -> Iterator[MergedFrames]:
    """Open the merged images of a level."""
    with folder.frames(level, "merge") as frames:
        yield MergedFrames(frames)
