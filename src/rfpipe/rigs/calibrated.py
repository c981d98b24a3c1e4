"""What a calibration knows of a rig, and whether the rig is to be used."""

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
"""What lies in the folder: facts that a person reads, and the arrays."""

VERDICTS_KEY = "calibration"
"""Key of a rig's description under which its calibration's verdicts stand."""

STANDINGS = {
    "good": "good",
    "unknown": "can't tell",
    "poor": "NOT GOOD",
    "failed": "NOT MEASURED",
}
"""How verdicts read, by their standing, from the best to the worst."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known of a rig; None or empty where it wasn't calibrated.

    Attributes
    ----------
    layout : ProjectorLayout or None
        Where the rays lie on the projector; dark where the camera doesn't see them.
    resampling : Resampling or None
        How the camera's images become images on the rays.
    camera : mapping
        Measured parameters of `CameraModel`, as far as they were found.
    projector_response : ndarray of float64, shape (256,), or None
        Light of each code as a fraction of that of code 255, ascending from 0 to 1.
    facts : mapping
        Plain data: verdicts, measured numbers with their standard errors, settings.
    settings : mapping
        Settings of the rig's file that it was measured with, by dotted name; empty where unknown.
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
    """Write a calibration; its facts last, so that they tell of a complete one."""
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
    """Read a calibration, such as `rfpipe calibrate` wrote.

    StoreError where there is no complete one, IntegrityError where it is damaged.
    """
    folder = Path(folder)
    if not (folder / FACTS).is_file():
        command = shlex.join(["rfpipe", "calibrate", "RIG.yaml", "--output", str(folder)])
        raise StoreError(
            f"{folder}: holds no complete calibration ({FACTS} is missing); make one with "
            f"`{command}`, or set the rig's calibration to null"
        )
    manifest, arrays = read_parts(folder / FACTS, folder / ARRAYS)
    return Calibration(
        ProjectorLayout.from_arrays(arrays) if "ray_of_pixel" in arrays else None,
        Resampling.from_arrays(arrays) if "resampling_shape" in arrays else None,
        manifest["camera"],
        arrays.get("projector_response"),
        manifest["facts"],
        manifest.get("settings", {}),  # calibrations of rfpipe's first version have none
        manifest.get("devices", {}),
    )


def read_parts(manifest: Path, store: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a manifest and the arrays that it tells of; IntegrityError where they don't belong."""
    told, bundle = read_manifest(manifest), open_arrays(store)
    if bundle.digest != told["arrays"]:
        raise IntegrityError(
            f"{store}: is not what {manifest.name} tells of; remove both and calibrate again"
        )
    return told, bundle.read_all()


def calibration_of(config: RigConfig) -> Calibration:
    """Return a rig's calibration, one that says nothing where it has none."""
    return Calibration() if config.calibration is None else load_calibration(config.calibration)


def sensor_of(config: RigConfig) -> CameraModel:
    """Return the camera of a rig's settings, with its calibration's numbers."""
    sensor = sensor_from_config(config.sensor)
    if not isinstance(sensor, CameraModel):
        raise ConfigError("sensor is null; a rig of devices needs the camera's numbers")
    numbers: dict[str, Any] = dict(calibration_of(config).camera)
    if "black_level_counts" in numbers:  # of a fixed pattern's mean
        numbers["black_level_counts"] = round(numbers["black_level_counts"])
    try:
        return replace(sensor, **numbers)
    except (TypeError, InputError) as error:
        raise ConfigError(
            f"calibration {config.calibration}: its numbers of the camera don't fit the settings "
            f"of sensor: {error}. Calibrate again"
        ) from error


def resampled_sensor(sensor: Sensor, resampling: Resampling | None) -> Sensor:
    """Return the sensor that merges brackets onto the ray grid, where there is one."""
    if resampling is None:
        return sensor
    if not isinstance(sensor, CameraModel):
        raise InputError(
            "frames are resampled to rays for a camera of counts alone (CameraModel), not for a "
            f"{type(sensor).__name__}; give the camera its numbers, or frames of the rays' size"
        )
    return ResampledSensor(sensor, resampling)


def verdicts_of(facts: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return title, standing and verdict of each step in a calibration's facts."""
    names = "title", "standing", "verdict"
    return {step: {name: str(of_step[name]) for name in names} for step, of_step in facts.items()}


def faults_of(verdicts: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return a line for each step that isn't good."""
    return [
        f"{one['title']}: {STANDINGS[one['standing']]}. {one['verdict']}"
        for one in verdicts.values()
        if one["standing"] in ("poor", "failed")
    ]


def check_verdicts(facts: Mapping[str, Any], folder: str | None, *, force: bool) -> None:
    """Refuse a rig whose calibration is not good, or warn of it where that is forced.

    `facts` are those of a `Calibration`, and `folder` is where it lies, None for a rig without one.
    ConfigError names each step that is not good, and what to do.
    """
    if folder is None:
        _log.warning(
            "the rig has no calibration: nothing is known of its noise, its response and its rays. "
            "Make one with `rfpipe calibrate`, and name its folder in the setting calibration"
        )
        return
    faults = faults_of(verdicts_of(facts))
    if faults and not force:
        lines = "\n".join(f"  {fault}" for fault in faults)
        raise ConfigError(
            f"{folder}: the calibration is not good, so that pictures of this rig can't be relied "
            f"on:\n{lines}\nSee {folder}/report.html; mend it, and run `rfpipe calibrate` again. "
            "To go on all the same, add --force: the reports will say so"
        )
    for fault in faults:
        _log.warning("%s: %s", folder, fault)


def check_settings(config: RigConfig, source: str, *, force: bool = False) -> None:
    """Raise an error where a rig's settings aren't those that it was calibrated with.

    Parameters
    ----------
    config : RigConfig
        The settings of a rig of devices.
    source : str
        Name of the settings in messages, such as their file.
    force : bool
        Whether to log warnings instead.

    Raises
    ------
    ConfigError
        Names each setting that changed, both values, and what to do.
    """
    if config.calibration is None:
        return
    made_with = load_calibration(config.calibration).settings
    if not made_with:
        _log.warning(
            "%s: doesn't record the settings that it was made with, as rfpipe's first version made "
            "it: nothing can be said of changes since. Calibrate again", config.calibration,
        )  # fmt: skip
        return
    now = shaping_settings(config) | flat({"calibrate": config.calibrate.model_dump(mode="json")})
    relevant = {
        name: value for name, value in now.items() if name in made_with or not is_of_a_step(name)
    }
    _refuse(differences(made_with, relevant), "settings", config.calibration, source, force=force)


def check_devices(
    calibration: Calibration,
    devices: Mapping[str, Mapping[str, Any]],
    config: RigConfig,
    source: str,
    *,
    force: bool = False,
) -> None:
    """Raise an error where models or serial numbers aren't those of the calibrated devices.

    `devices` are the descriptions of ``projector`` and ``camera``; the others as `check_settings`.
    """
    connected = identities(flat(devices))
    lines = differences(calibration.devices, connected) if calibration.devices else []
    _refuse(lines, "devices", str(config.calibration), source, force=force)


def _refuse(lines: list[str], what: str, folder: str, source: str, *, force: bool) -> None:
    """Raise ConfigError with lines of what changed since the calibration, or log them if forced."""
    if lines and not force:
        listed = "\n".join(f"  {line}" for line in lines)
        raise ConfigError(
            f"{source}: has other {what} than its calibration {folder} was made with:\n{listed}\n"
            "Run `rfpipe calibrate` again, or set them back. To go on all the same, add --force"
        )
    for line in lines:
        _log.warning("%s: since its calibration %s, %s", source, folder, line)


def was_coaxial(described: Mapping[str, Any]) -> bool:
    """Test whether a rig's description has a calibration that found the rig coaxial."""
    symmetry = (described.get(VERDICTS_KEY) or {}).get("symmetry", {})
    return bool(symmetry.get("standing") == "good")


def warn_of(described: Mapping[str, Any], name: str) -> None:
    """Warn of the faults in the verdicts of a rig's description."""
    for fault in faults_of(described.get(VERDICTS_KEY) or {}):
        _log.warning("%s: its calibration is not good. %s", name, fault)
