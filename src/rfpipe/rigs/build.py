"""A rig made of a projector and a camera, and the rig of a settings file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe import plugins
from rfpipe.array_types import Float
from rfpipe.errors import ConfigError, InputError
from rfpipe.photometry.camera import sensor_from_config
from rfpipe.rigs.base import Key, Rig, check_patterns
from rfpipe.rigs.calibrated import (
    VERDICTS_KEY,
    calibration_of,
    check_devices,
    check_settings,
    resampled_sensor,
    sensor_of,
    verdicts_of,
)
from rfpipe.rigs.devices import Camera, Closing, Projector, bracket_of
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.rigs.operator import SimulatedRig
from rfpipe.rigs.sequences import Sequencer, device_sequencer
from rfpipe.rigs.stale import StaleWatch
from rfpipe.units import picture_name

if TYPE_CHECKING:
    from rfpipe.config import RigConfig
    from rfpipe.photometry.resampling import Resampling


class DeviceRig(Closing):
    """A rig of two devices: the projector shows a pattern, then the camera takes a bracket.

    The camera's driver repeats failed frames. If both devices support hardware sequences, see
    `rfpipe.rigs.devices`, so does the rig.

    Parameters
    ----------
    projector : Projector
    camera : Camera
    layout : ProjectorLayout, optional
        Positions of the rays on the projector. None: each projector pixel is a ray.
    resampling : Resampling, optional
        Weights of camera pixels in each ray. None: each camera pixel is a ray.
    seconds_per_pattern : float
        Approximate duration of a bracket in seconds, for estimates; at least 0.
    verdicts : mapping, optional
        Verdicts of the calibration, see `rfpipe.rigs.calibrated`, for the rig's description.

    Raises
    ------
    InputError
        When devices, layout and resampling don't fit together.
    """

    def __init__(
        self,
        projector: Projector,
        camera: Camera,
        layout: ProjectorLayout | None = None,
        resampling: Resampling | None = None,
        seconds_per_pattern: float = 2.0,
        verdicts: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        for device, calibrated, shape in (
            ("projector", layout.display_shape if layout else None, projector.shape),
            ("camera", resampling.camera_shape if resampling else None, camera.shape),
        ):
            if calibrated is not None and tuple(calibrated) != tuple(shape):
                raise InputError(
                    f"the {device} has {tuple(shape)} pixels, but the calibration was made with "
                    f"{tuple(calibrated)}",
                    remedy=f"Calibrate again, or restore the {device}'s size",
                )
        self.projector, self.camera = projector, camera
        self.layout = layout
        self.seconds_per_pattern = float(seconds_per_pattern)
        self._verdicts = {step: dict(verdict) for step, verdict in (verdicts or {}).items()}
        self.projector_shape = projector.shape if layout is None else layout.shape
        self.camera_shape = camera.shape if resampling is None else resampling.shape
        self.channels = camera.channels
        self.sensor = resampled_sensor(camera.sensor, resampling)
        self._watch = StaleWatch(camera.sensor)
        self._sequencer: Sequencer | None = None
        if getattr(projector, "sequence_pictures", 0) and getattr(
            camera, "can_be_triggered", False
        ):
            self._sequencer = device_sequencer(projector, camera, self._picture, self.capture)

    def capture(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns and return their brackets; see `rfpipe.rigs.Rig.capture`."""
        patterns = check_patterns(patterns, keys, self.projector_shape)
        shape = self.camera.sensor.frame_shape(self.camera.shape, self.channels)
        frames = np.empty((len(patterns), *shape), self.camera.sensor.frame_dtype)
        for index, (pattern, key) in enumerate(zip(patterns, keys, strict=True)):
            name, picture = picture_name(key), self._picture(pattern)
            take = partial(bracket_of, self.projector, self.camera, picture, name)
            frames[index] = self._watch.capture(name, picture, take)
        return frames

    @property
    def sequence_patterns(self) -> int:
        """Largest number of patterns in a sequence; 0 where the devices don't support them."""
        return 0 if self._sequencer is None else self._sequencer.limit

    def show_sequence(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns in hardware sequences; see `rfpipe.rigs.base.sequence_patterns`."""
        patterns = check_patterns(patterns, keys, self.projector_shape)
        is_binary = ((patterns == 0) | (patterns == 1)).all()
        can_show = is_binary or getattr(self.projector, "sequence_levels", None) != 2
        if self._sequencer is None or not can_show or not len(patterns):
            return self.capture(patterns, keys)
        frames: NDArray[Any] = self._sequencer.brackets(patterns, keys)
        return frames

    def _picture(self, pattern: Float) -> Float:
        return pattern if self.layout is None else self.layout.picture(pattern)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: everything that affects a frame."""
        return {
            "kind": "devices",
            "projector": self.projector.describe(),
            "camera": self.camera.describe(),
            "layout": None if self.layout is None else self.layout.describe(),
            "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape),
            "channels": self.channels,
            "sensor": self.sensor.describe(),
            "seconds_per_pattern": self.seconds_per_pattern,
            **({VERDICTS_KEY: self._verdicts} if self._verdicts else {}),
        }

    @property
    def statistics(self) -> dict[str, dict[str, int]]:
        """Counters of the devices since their start, such as failed frames."""
        sources = {
            "projector": self.projector,
            "camera": self.camera,
            "sequences": self._sequencer,
            "brackets": self._watch,
        }
        return {
            name: dict(source.statistics)
            for name, source in sources.items()
            if hasattr(source, "statistics")
        }

    def close(self) -> None:
        """Close both devices; further calls have no effect."""
        try:
            self.camera.close()
        finally:
            self.projector.close()


def rig_from_config(
    config: RigConfig, source: str = "the rig's settings", *, force: bool = False
) -> Rig:
    """Create the rig of a settings file. The caller closes it, if it has devices.

    Parameters
    ----------
    config : RigConfig
    source : str
        Name of the settings in messages, such as their file.
    force : bool
        Whether settings and devices may differ from those of the calibration.

    Raises
    ------
    CaptureError
        When a device doesn't answer.
    StoreError
        When the calibration can't be read.
    ConfigError
        When settings or devices changed after the calibration.
    InputError
        When the sizes of calibration and devices differ.
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
    check_settings(config, source, force=force)
    calibration = calibration_of(config)
    projector, camera = devices_from_config(config)
    try:
        described = {"projector": projector.describe(), "camera": camera.describe()}
        check_devices(calibration, described, config, source, force=force)
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
    """Open projector and camera of a rig of devices, or of its simulated bench.

    ConfigError when the rig has no separate devices, CaptureError when a device doesn't answer.
    """
    if config.kind == "simulated" or config.rig is not None:
        kind = "simulated" if config.rig is None else f"driven as a whole, by {config.rig.driver}"
        raise ConfigError(f"the rig is {kind}; expected a rig of devices, or one with a bench")
    if config.bench is not None:
        devices: tuple[Projector, Camera] = plugins.find(
            plugins.CAMERAS, config.camera.bench or ""
        )(config)
        return devices
    projector: Projector = config.projector.make(response=calibration_of(config).projector_response)
    try:
        camera: Camera = config.camera.make(sensor=sensor_of(config))
    except BaseException:
        projector.close()
        raise
    return projector, camera
