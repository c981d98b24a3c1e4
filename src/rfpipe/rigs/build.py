"""From a rig's settings to the rig."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rfpipe.errors import ConfigError
from rfpipe.photometry.camera import sensor_from_config
from rfpipe.rigs.base import Rig
from rfpipe.rigs.calibrated import calibration_of, sensor_of, verdicts_of
from rfpipe.rigs.device_rig import DeviceRig
from rfpipe.rigs.devices import Camera, Projector
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.rigs.operator import SimulatedRig

if TYPE_CHECKING:
    from rfpipe.config import RigConfig


def rig_from_config(config: RigConfig) -> Rig:
    """Return the rig of a settings file; close it, if it has devices, when done.

    Raises
    ------
    CaptureError
        When a device doesn't answer: says which, and what to set.
    StoreError
        When the calibration can't be read.
    InputError
        When calibration and devices don't fit together.
    """
    if config.rig is not None:
        rig: Rig = config.rig.make(sensor=config.sensor and sensor_of(config))
        return rig
    if config.kind == "simulated":
        from rfpipe.scenes import scene_from_config

        assert config.scene is not None
        return SimulatedRig(
            scene_from_config(config.scene),
            sensor_from_config(config.sensor),
            config.seed,
            config.seconds_per_pattern,
        )
    calibration = calibration_of(config)
    projector, camera = devices_from_config(config)
    try:
        layout = calibration.layout
        if layout is None and config.rays is not None:
            layout = ProjectorLayout.grid(projector.shape, config.rays)
        return DeviceRig(
            projector, camera, layout, calibration.resampling, config.seconds_per_pattern,
            verdicts_of(calibration.facts),
        )  # fmt: skip
    except BaseException:
        camera.close()
        projector.close()
        raise


def devices_from_config(config: RigConfig) -> tuple[Projector, Camera]:
    """Return projector and camera of a rig of devices, or those of its bench.

    ConfigError where the rig is a simulated one or a whole, CaptureError where a device doesn't
    answer.
    """
    if config.kind == "simulated" or config.rig is not None:
        what = "simulated" if config.rig is None else f"a whole, {config.rig.driver}"
        raise ConfigError(f"the rig is {what}; expected one of devices, or with a bench")
    if config.bench is not None:
        from rfpipe.rigs.bench import software_bench

        return software_bench(config)
    projector: Projector = config.projector.make(response=calibration_of(config).projector_response)
    try:
        camera: Camera = config.camera.make(sensor=sensor_of(config))
    except BaseException:
        projector.close()
        raise
    return projector, camera
