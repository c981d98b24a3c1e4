"""What a rig's settings and its calibration say together of its devices."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rfpipe.errors import ConfigError, InputError
from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.rigs.calibrated import Calibration, load_calibration

if TYPE_CHECKING:
    from rfpipe.config import RigConfig

__all__ = ["calibration_of", "sensor_of"]


def sensor_of(config: RigConfig) -> CameraModel:
    """Return what is known of a rig's camera: its settings, and its calibration's numbers."""
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


def calibration_of(config: RigConfig) -> Calibration:
    """Return a rig's calibration, one that says nothing where it has none."""
    return Calibration() if config.calibration is None else load_calibration(config.calibration)
