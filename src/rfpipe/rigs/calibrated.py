"""Result of a calibration, and checks of a rig against it."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import ConfigError, InputError, IntegrityError, StoreError
from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.photometry.resampling import ResampledSensor, Resampling
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.rigs.settings import differences, flat, identities, is_of_a_step, shaping_settings
from rfpipe.store import open_arrays, read_manifest, write_arrays, write_manifest

if TYPE_CHECKING:
    from rfpipe.config import RigConfig

FACTS, ARRAYS = "calibration.json", "calibration.zarr"
"""Files in a calibration's folder: a manifest, and the arrays."""

VERDICTS_KEY = "calibration"
"""Key of the calibration's verdicts in a rig's description."""

STANDINGS = {
    "good": "good",
    "unknown": "can't tell",
    "poor": "NOT GOOD",
    "failed": "NOT MEASURED",
}
"""Standings of verdicts as displayed, from the best to the worst."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of a rig; parts that were not measured are None or empty.

    Attributes
    ----------
    layout : ProjectorLayout or None
        Positions of the rays on the projector; dark where the camera doesn't see them.
    resampling : Resampling or None
        Weights of camera pixels in each ray.
    camera : mapping
        Measured parameters of `CameraModel`.
    projector_response : ndarray of float64, shape (256,), or None
        Light of each code relative to code 255, ascending from 0 to 1.
    facts : mapping
        Plain data by step: verdicts, and measured numbers with their standard errors.
    settings : mapping
        Settings of the rig's file during the measurement, by dotted name.
    devices : mapping
        Models and serial numbers of the devices, by names such as ``camera.serial``.
    """

    layout: ProjectorLayout | None = None
    resampling: Resampling | None = None
    camera: Mapping[str, float] = field(default_factory=dict)
    projector_response: NDArray[np.float64] | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    devices: Mapping[str, Any] = field(default_factory=dict)


def write_calibration(folder: Path, calibration: Calibration) -> None:
    """Write a calibration; the manifest last, which marks it as complete."""
    arrays: dict[str, NDArray[Any]] = {}
    for part in (calibration.layout, calibration.resampling):
        if part is not None:
            arrays |= part.arrays()
    if calibration.projector_response is not None:
        arrays["projector_response"] = calibration.projector_response
    (folder / FACTS).unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    digest = write_arrays(folder / ARRAYS, arrays, {})
    parts = {
        "camera": dict(calibration.camera),
        "facts": dict(calibration.facts),
        "settings": dict(calibration.settings),
        "devices": dict(calibration.devices),
    }
    write_manifest(folder / FACTS, {**parts, "arrays": digest})


def load_calibration(folder: str | Path) -> Calibration:
    """Read a calibration that `rfpipe calibrate` wrote.

    Raises
    ------
    StoreError
        When the folder has no complete calibration.
    IntegrityError
        When it is damaged.
    """
    folder = Path(folder)
    if not (folder / FACTS).is_file():
        command = shlex.join(["rfpipe", "calibrate", "RIG.yaml", "--output", str(folder)])
        raise StoreError(
            f"{folder}: has no complete calibration ({FACTS} is missing)",
            remedy=f"run `{command}`, or set the rig's calibration to null",
        )
    manifest, arrays = read_manifest_and_arrays(folder / FACTS, folder / ARRAYS)
    return Calibration(
        ProjectorLayout.from_arrays(arrays) if "ray_of_pixel" in arrays else None,
        Resampling.from_arrays(arrays) if "resampling_shape" in arrays else None,
        manifest["camera"],
        arrays.get("projector_response"),
        manifest["facts"],
        manifest["settings"],
        manifest["devices"],
    )


def read_manifest_and_arrays(
    path: Path, store: Path
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a manifest and its arrays; IntegrityError if the arrays have another digest."""
    manifest, bundle = read_manifest(path), open_arrays(store)
    if bundle.digest != manifest["arrays"]:
        raise IntegrityError(
            f"{store}: its digest is {bundle.digest}, but {path.name} has {manifest['arrays']}",
            remedy="remove both and calibrate again",
        )
    return manifest, bundle.read_all()


def calibration_of(config: RigConfig) -> Calibration:
    """Calibration of a rig, an empty one if the settings name none."""
    return Calibration() if config.calibration is None else load_calibration(config.calibration)


def sensor_of(config: RigConfig) -> CameraModel:
    """Camera model of a rig's settings, with the parameters measured by the calibration."""
    sensor = sensor_from_config(config.sensor)
    if not isinstance(sensor, CameraModel):
        raise ConfigError("sensor is null; a rig of devices needs the camera's parameters")
    numbers: dict[str, Any] = dict(calibration_of(config).camera)
    if "black_level_counts" in numbers:  # measured as a mean over photosites
        numbers["black_level_counts"] = round(numbers["black_level_counts"])
    try:
        return replace(sensor, **numbers)
    except (TypeError, InputError) as error:
        raise ConfigError(
            f"calibration {config.calibration}: its camera parameters are inconsistent with the "
            f"setting sensor: {error}",
            remedy="Calibrate again",
        ) from error


def resampled_sensor(sensor: Sensor, resampling: Resampling | None) -> Sensor:
    """Add a resampling to rays, if there is one, to a camera's sensor."""
    if resampling is None:
        return sensor
    if not isinstance(sensor, CameraModel):
        raise InputError(
            f"the sensor is a {type(sensor).__name__}; only frames of counts (CameraModel) can be "
            "resampled to rays",
            remedy="Set the camera's parameters, or use frames of the rays' size",
        )
    return ResampledSensor(sensor, resampling)


def verdicts_of(facts: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Title, standing and verdict of each step in a calibration's facts."""
    names = "title", "standing", "verdict"
    return {step: {name: str(of_step[name]) for name in names} for step, of_step in facts.items()}


def poor_verdicts(verdicts: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Describe each step whose standing is poor or failed, in one line."""
    return [
        f"{verdict['title']}: {STANDINGS[verdict['standing']]}. {verdict['verdict']}"
        for verdict in verdicts.values()
        if verdict["standing"] in ("poor", "failed")
    ]


def check_verdicts(facts: Mapping[str, Any], folder: str | None, *, force: bool) -> None:
    """Raise ConfigError if a rig's calibration isn't good; log warnings instead with `force`.

    Parameters
    ----------
    facts : mapping
        Facts of the `Calibration`.
    folder : str or None
        Folder of the calibration, None for a rig without one.
    force : bool
    """
    if folder is None:
        _log.warning(
            "the rig has no calibration, so that its noise, its response and its rays are unknown. "
            "Run `rfpipe calibrate`, and set calibration to its folder"
        )
        return
    lines = poor_verdicts(verdicts_of(facts))
    if lines and not force:
        listed = "\n".join(f"  {line}" for line in lines)
        raise ConfigError(
            f"{folder}: the calibration is not good, so that pictures of this rig are unreliable:\n"
            f"{listed}\nSee {folder}/report.html, mend the rig, and run `rfpipe calibrate` again. "
            "To use the rig nevertheless, add --force; the reports will state it"
        )
    for line in lines:
        _log.warning("%s: %s", folder, line)


def check_settings(config: RigConfig, source: str, *, force: bool = False) -> None:
    """Check that a rig's settings are the same as during its calibration.

    Parameters
    ----------
    config : RigConfig
        Settings of a rig of devices.
    source : str
        Name of the settings in messages, such as their file.
    force : bool
        Whether to log warnings instead of raising an error.

    Raises
    ------
    ConfigError
        Names each setting that changed, both values, and the remedy.
    """
    if config.calibration is None:
        return
    calibrated = load_calibration(config.calibration).settings
    calibrate = flat({"calibrate": config.calibrate.model_dump(mode="json")})
    current = shaping_settings(config) | calibrate
    relevant = {
        name: value
        for name, value in current.items()
        if name in calibrated or not is_of_a_step(name)
    }
    _refuse(differences(calibrated, relevant), "settings", config.calibration, source, force=force)


def check_devices(
    calibration: Calibration,
    devices: Mapping[str, Mapping[str, Any]],
    config: RigConfig,
    source: str,
    *,
    force: bool = False,
) -> None:
    """Check that models and serial numbers are those of the calibrated devices.

    `devices` has the descriptions of ``projector`` and ``camera``; other parameters and errors as
    `check_settings`.
    """
    connected = identities(flat(devices))
    lines = differences(calibration.devices, connected) if calibration.devices else []
    _refuse(lines, "devices", str(config.calibration), source, force=force)


def _refuse(lines: list[str], what: str, folder: str, source: str, *, force: bool) -> None:
    """Raise ConfigError with the changes since the calibration, if any; log them with `force`."""
    if lines and not force:
        listed = "\n".join(f"  {line}" for line in lines)
        raise ConfigError(
            f"{source}: the {what} changed since the calibration {folder}:\n{listed}\n"
            "Run `rfpipe calibrate` again, or undo the changes. To use the rig nevertheless, add "
            "--force"
        )
    for line in lines:
        _log.warning("%s: since its calibration %s, %s", source, folder, line)


def was_coaxial(described: Mapping[str, Any]) -> bool:
    """Test whether a rig's calibration found it coaxial, by the rig's description."""
    symmetry = (described.get(VERDICTS_KEY) or {}).get("symmetry", {})
    return bool(symmetry.get("standing") == "good")


def warn_of(described: Mapping[str, Any], name: str) -> None:
    """Log a warning for each poor verdict in a rig's description."""
    for line in poor_verdicts(described.get(VERDICTS_KEY) or {}):
        _log.warning("%s: its calibration is not good. %s", name, line)
