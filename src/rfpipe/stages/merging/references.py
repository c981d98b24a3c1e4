"""What level 0 learns from the reference brackets: black level, defects and floodlit image."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.defects import DefectMap
from rfpipe.photometry.sensor import MergeOptions, Sensor
from rfpipe.provenance import fingerprint
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.merging.merger import Merger
from rfpipe.stages.merging.raw import RawFrames
from rfpipe.stages.plan import REFERENCE, AcquisitionFolder, advice_on_damage
from rfpipe.stages.results import bundle_entry, intact_bundle
from rfpipe.store import ArrayBundle, open_arrays, write_arrays

__all__ = ["REFERENCES", "learn_references", "read_floodlit", "read_merger"]

Float = NDArray[np.float32]

REFERENCES = "merged_reference"
"""Their store, and their key in the merge's manifest of level 0."""


def learn_references(
    sensor: Sensor,
    folder: AcquisitionFolder,
    settings: dict[str, Any],
    code: str,
    resources: Resources,
) -> tuple[Merger, dict[str, Any]]:
    """Learn from the reference brackets and write what was learnt, or read what still holds.

    Parameters
    ----------
    sensor : Sensor
    folder : AcquisitionFolder
    settings : dict
        Plain data: "saturation_fraction", "mask_defects" and the sensor's description.
    code : str
        Fingerprint of the code behind the stage.
    resources : Resources

    Returns
    -------
    merger : Merger
    entry : dict
        For the manifest.

    Raises
    ------
    CaptureError
        As `Merger.from_references`.
    StaleStoreError
        When settings changed and the reference brackets were dropped.
    """
    captured = folder.read_manifest(0, "capture")[REFERENCE]
    made_of = {"settings": settings, "captured": captured["digest"]}
    made_from = fingerprint([made_of, code])
    store = folder.store(0, REFERENCES)
    raw = RawFrames(folder, 0, REFERENCE)
    bundle = intact_bundle(store, None if raw.dropped else made_from)
    if bundle is None:
        raw.must_be_there("what was learnt from them is missing or damaged")
        merger = _learn(sensor, folder, settings, resources)
        counted = {name: captured[name] for name in ("black_frames", "floodlit_frames")}
        _write(merger, store, counted, made_of, made_from)
        bundle = open_arrays(store)
    else:
        if bundle.attributes["fingerprint"] != made_from:
            raw.must_be_unchanged(bundle.attributes["made_of"], made_of)
        merger = _merger_of(bundle, sensor, settings["saturation_fraction"])
    return merger, {**bundle_entry(bundle), **bundle.attributes["counted"]}


def read_merger(sensor: Sensor, folder: AcquisitionFolder, saturation_fraction: float) -> Merger:
    """Read what level 0 learnt."""
    bundle = folder.bundle(0, "merge", REFERENCES)
    with advice_on_damage(folder.manifest(0, "merge")):
        return _merger_of(bundle, sensor, saturation_fraction)


def read_floodlit(folder: AcquisitionFolder) -> tuple[Float, Float]:
    """Read the floodlit image that level 0 measured, and its variance: (*camera_shape, C)."""
    bundle = folder.bundle(0, "merge", REFERENCES)
    with advice_on_damage(folder.manifest(0, "merge")):
        return bundle.read("floodlit"), bundle.read("floodlit_variance")


def _learn(
    sensor: Sensor, folder: AcquisitionFolder, settings: dict[str, Any], resources: Resources
) -> Merger:
    captured = folder.read_manifest(0, "capture")[REFERENCE]
    off, on = captured["black_frames"], captured["floodlit_frames"]
    with folder.frames(0, "capture", REFERENCE) as frames:
        bracket = prod(frames.shape[1:]) * frames.dtype.itemsize
        with resources.here.workers(bracket) as workers:

            def read(first: int, last: int) -> Iterator[NDArray[Any]]:
                return workers.results(frames.read, [(i, i + 1) for i in range(first, last)])

            return Merger.from_references(
                sensor,
                read(0, off),
                read(off, off + on),
                settings["saturation_fraction"],
                settings["mask_defects"],
            )


def _write(
    merger: Merger, store: Any, counted: dict[str, int], made_of: dict[str, Any], made_from: str
) -> None:
    arrays: dict[str, NDArray[Any]] = {
        "black": merger.black,
        "floodlit": merger.floodlit,
        "floodlit_variance": merger.floodlit_variance,
    }
    if merger.defects is not None:
        arrays["defects"] = merger.defects.mask
        counted = counted | {"hot": merger.defects.hot, "dead": merger.defects.dead}
    attributes = {"fingerprint": made_from, "made_of": made_of, "counted": counted}
    write_arrays(store, arrays, attributes)


def _merger_of(bundle: ArrayBundle, sensor: Sensor, saturation_fraction: float) -> Merger:
    counted = bundle.attributes["counted"]
    defects = None
    if "defects" in bundle.names:
        defects = DefectMap(bundle.read("defects"), counted["hot"], counted["dead"])
    options = MergeOptions(counted["black_frames"], saturation_fraction)
    black, *floodlit = (bundle.read(n) for n in ("black", "floodlit", "floodlit_variance"))
    return Merger(sensor, black, options, defects, *floodlit)
