"""What a calibration knows of a rig: read from its folder, to build the rig with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.photometry.resampling import Resampling
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.store import open_arrays, read_manifest, write_arrays, write_manifest

__all__ = ["Calibration", "load_calibration", "write_calibration"]

FACTS, ARRAYS = "calibration.json", "calibration.zarr"
"""What lies in the folder: facts that a person reads, and the arrays."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known of a rig; None or empty where it wasn't calibrated.

    Attributes
    ----------
    layout : ProjectorLayout or None
        Where the rays lie on the projector; dark where the camera doesn't see them.
    resampling : Resampling or None
        How the camera's images become images on the rays.
    camera : dict
        Measured parameters of `CameraModel`: full well, read noise, dark current, black level and
        gamma of the response, as far as they were found.
    projector_response : ndarray of float64, shape (256,), or None
        Light of each code as a fraction of that of code 255, ascending from 0 to 1.
    black : ndarray of float32 or None
        Mean of the dark frames, shape of a bracket, counts.
    hot : ndarray of bool or None
        Hot photosites, shape of a frame.
    facts : dict
        Plain data: verdicts, measured numbers with their standard errors, settings.
    """

    layout: ProjectorLayout | None = None
    resampling: Resampling | None = None
    camera: Mapping[str, float] = field(default_factory=dict)
    projector_response: NDArray[np.float64] | None = None
    black: NDArray[np.float32] | None = None
    hot: NDArray[np.bool_] | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


def write_calibration(folder: Path, calibration: Calibration) -> None:
    """Write a calibration; its facts last, so that they tell of a complete one.

    Raises
    ------
    StoreError
        When the disk is full or the folder isn't writable.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for part in (calibration.layout, calibration.resampling):
        if part is not None:
            arrays |= part.arrays()
    for name in ("projector_response", "black", "hot"):
        array = getattr(calibration, name)
        if array is not None:
            arrays[name] = array
    (folder / FACTS).unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    digest = write_arrays(folder / ARRAYS, arrays, {})
    facts = {"camera": dict(calibration.camera), "arrays": digest, "facts": dict(calibration.facts)}
    write_manifest(folder / FACTS, facts)


def load_calibration(folder: str | Path) -> Calibration:
    """Read a calibration.

    Parameters
    ----------
    folder
        Such as `rfpipe calibrate` wrote.

    Raises
    ------
    StoreError
        When there is none, or not yet a complete one.
    IntegrityError
        When it is damaged.
    """
    folder = Path(folder)
    if not (folder / FACTS).is_file():
        raise StoreError(
            f"{folder}: holds no complete calibration ({FACTS} is missing); make one with "
            f"`rfpipe calibrate RIG.yaml --output {folder}`, or set the rig's calibration to null"
        )
    manifest = read_manifest(folder / FACTS)
    bundle = open_arrays(folder / ARRAYS)
    if bundle.digest != manifest["arrays"]:
        raise IntegrityError(
            f"{folder / ARRAYS}: is not the one that {FACTS} tells of; calibrate again"
        )
    arrays = {name: bundle.read(name) for name in bundle.names}
    return Calibration(
        ProjectorLayout.from_arrays(arrays) if "ray_of_pixel" in arrays else None,
        Resampling.from_arrays(arrays) if "resampling_shape" in arrays else None,
        manifest["camera"],
        arrays.get("projector_response"),
        arrays.get("black"),
        arrays.get("hot"),
        manifest["facts"],
    )
