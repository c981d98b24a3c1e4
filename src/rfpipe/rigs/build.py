"""From a rig's settings to the rig."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rfpipe.errors import ConfigError, InputError
from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.rigs.base import Rig
from rfpipe.rigs.calibrated import Calibration, load_calibration
from rfpipe.rigs.device_rig import DeviceRig
from rfpipe.rigs.devices import Camera, Projector
from rfpipe.rigs.layout import ProjectorLayout

if TYPE_CHECKING:
    from rfpipe.config import RigConfig

__all__ = ["camera_settings", "devices_from_config", "rig_from_config", "sensor_of"]


def rig_from_config(config: RigConfig) -> Rig:
    """Return the rig of a settings file; close it, if it has devices, when done.

    Parameters
    ----------
    config : RigConfig
        From `rfpipe.config.load_rig_config`.

    Raises
    ------
    CaptureError
        When a device doesn't answer: says which, and what to set.
    StoreError
        When the calibration can't be read.
    InputError
        When calibration and devices don't fit together.
    """
    if config.kind == "simulated":
        return _simulated(config)
    calibration = _calibration(config)
    projector, camera = devices_from_config(config)
    try:
        layout = calibration.layout
        if layout is None and config.rays is not None:
            layout = ProjectorLayout.grid(projector.shape, config.rays)
        return DeviceRig(
            projector, camera, layout, calibration.resampling, config.seconds_per_pattern
        )
    except BaseException:
        camera.close()
        projector.close()
        raise


def devices_from_config(config: RigConfig) -> tuple[Projector, Camera]:
    """Return projector and camera of a rig of devices, or those of its bench.

    Raises
    ------
    ConfigError
        When the rig is a simulated one, which has no devices.
    CaptureError
        When a device doesn't answer.
    """
    if config.kind == "simulated":
        raise ConfigError("kind is simulated; expected devices, or devices with a bench")
    if config.bench is not None:
        from rfpipe.rigs.bench import software_bench

        return software_bench(config)
    from rfpipe.rigs.pylon import PylonCamera
    from rfpipe.rigs.window import WindowProjector

    projector = WindowProjector(config.projector.display, **window_settings(config))
    try:
        camera = PylonCamera(
            sensor_of(config),
            serial=config.camera.serial,
            shape=config.camera.shape,
            offset=config.camera.offset,
            nodes=config.camera.nodes,
            **camera_settings(config),
        )
    except BaseException:
        projector.close()
        raise
    return projector, camera


def sensor_of(config: RigConfig) -> CameraModel:
    """Return what is known of a rig's camera: its settings, and its calibration's numbers."""
    sensor = sensor_from_config(config.sensor)
    if not isinstance(sensor, CameraModel):
        raise ConfigError("sensor is null; a rig of devices needs the camera's numbers")
    numbers: dict[str, Any] = dict(_calibration(config).camera)
    if "black_level_counts" in numbers:  # of a fixed pattern's mean
        numbers["black_level_counts"] = round(numbers["black_level_counts"])
    try:
        return replace(sensor, **numbers)
    except (TypeError, InputError) as error:
        raise ConfigError(
            f"calibration {config.calibration}: its numbers of the camera don't fit the settings "
            f"of sensor: {error}. Calibrate again"
        ) from error


def window_settings(config: RigConfig) -> dict[str, Any]:
    """Return how the projector's window is opened, wherever its display is."""
    from rfpipe.rigs.window import read_response

    settings = config.projector
    path = settings.response
    response = _calibration(config).projector_response if path is None else read_response(path)
    return {
        "screen": settings.screen,
        "offset": settings.offset,
        "shape": settings.shape,
        "settle_seconds": settings.settle_seconds,
        "response": response,
    }


def camera_settings(config: RigConfig) -> dict[str, Any]:
    """Return how frames are taken, of a real camera or of the bench's."""
    names = "gain_db", "timeout_seconds", "retries", "reconnects", "reconnect_seconds"
    return {name: getattr(config.camera, name) for name in names}


def _calibration(config: RigConfig) -> Calibration:
    return Calibration() if config.calibration is None else load_calibration(config.calibration)


def _simulated(config: RigConfig) -> Rig:
    from rfpipe.rigs.simulated import SimulatedRig
    from rfpipe.scenes import scene_from_config

    assert config.scene is not None
    return SimulatedRig(
        scene_from_config(config.scene),
        sensor_from_config(config.sensor),
        config.seed,
        config.seconds_per_pattern,
    )
