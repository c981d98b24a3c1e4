"""What level 0 learns from the reference brackets: black level, defects and floodlit image."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.photometry.defects import DefectMap
from rfpipe.photometry.sensor import MergeOptions, Sensor
from rfpipe.provenance import fingerprint
from rfpipe.stages.folder import REFERENCE, AcquisitionFolder
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.merging.merger import Merger
from rfpipe.stages.merging.raw import RawFrames
from rfpipe.store import ArrayBundle, open_arrays, write_arrays

__all__ = ["REFERENCES", "intact_bundle", "learn_references", "read_floodlit", "read_merger"]

Float = NDArray[np.float32]
Arrays = dict[str, NDArray[Any]]

REFERENCES = "merged_reference"
"""Their store, and their key in the merge's manifest of level 0."""

_log = logging.getLogger(__name__)

_HELD = ("black", "floodlit", "floodlit_variance")


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
        arrays, counted = _learn(sensor, folder, settings, resources)
        about = {"fingerprint": made_from, "made_of": made_of, "counted": counted}
        write_arrays(store, arrays, about)
        bundle = open_arrays(store)
    elif bundle.attributes["fingerprint"] != made_from:
        raw.must_be_unchanged(bundle.attributes["made_of"], made_of)
    found = bundle.read_all(), bundle.attributes
    merger = _merger_of(*found, sensor, settings["saturation_fraction"])
    return merger, {**bundle.entry(), **bundle.attributes["counted"]}


def intact_bundle(store: Path, made_from: str | None) -> ArrayBundle | None:
    """Return a bundle that was made from the same things, if there is one and it is undamaged.

    `made_from` is None where it may be made from anything.
    """
    try:
        bundle = open_arrays(store)
        if made_from not in (None, bundle.attributes.get("fingerprint")):
            return None
        bundle.read_all()
    except IntegrityError as error:
        _log.warning("made anew, since it is damaged: %s", error)
        return None
    except StoreError:
        return None
    return bundle


def read_merger(sensor: Sensor, folder: AcquisitionFolder, saturation_fraction: float) -> Merger:
    """Read what level 0 learnt."""
    return _merger_of(*folder.read(0, "merge", REFERENCES), sensor, saturation_fraction)


def read_floodlit(folder: AcquisitionFolder) -> tuple[Float, Float]:
    """Read the floodlit image that level 0 measured, and its variance: (*camera_shape, C)."""
    arrays, _ = folder.read(0, "merge", REFERENCES)
    return arrays["floodlit"], arrays["floodlit_variance"]


def _learn(
    sensor: Sensor, folder: AcquisitionFolder, settings: dict[str, Any], resources: Resources
) -> tuple[Arrays, dict[str, int]]:
    """Return the arrays of what the brackets tell, and what was counted."""
    captured = folder.read_manifest(0, "capture")[REFERENCE]
    counted = {name: captured[name] for name in ("black_frames", "floodlit_frames")}
    off, on = counted.values()
    with folder.frames(0, "capture", REFERENCE) as frames:
        bracket = prod(frames.shape[1:]) * frames.dtype.itemsize
        with resources.here.workers(bracket, folder.path) as workers:

            def read(first: int, last: int) -> Iterator[NDArray[Any]]:
                return workers.results(frames.read, [(i, i + 1) for i in range(first, last)])

            merger = Merger.from_references(
                sensor,
                read(0, off),
                read(off, off + on),
                settings["saturation_fraction"],
                settings["mask_defects"],
            )
    arrays: Arrays = {name: getattr(merger, name) for name in _HELD}
    if merger.defects is not None:
        arrays["defects"] = merger.defects.mask
        counted |= {"hot": merger.defects.hot, "dead": merger.defects.dead}
    return arrays, counted


def _merger_of(
    arrays: Arrays, attributes: dict[str, Any], sensor: Sensor, saturation_fraction: float
) -> Merger:
    counted = attributes["counted"]
    defects = None
    if "defects" in arrays:
        defects = DefectMap(arrays["defects"], counted["hot"], counted["dead"])
    options = MergeOptions(counted["black_frames"], saturation_fraction)
    held = {name: arrays[name] for name in _HELD}
    return Merger(sensor, options=options, defects=defects, **held)
