"""A rig made of a projector and a camera, and the rig of a settings file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe import plugins
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

Float = NDArray[np.float32]


class DeviceRig(Closing):
    """A rig of two devices: shows a pattern on the projector, then has the camera take a bracket.

    Retries of failed frames are the camera's; what reaches this rig is good or an error. Where both
    devices have sequences, see `rfpipe.rigs.devices`, the rig has them, too.

    Parameters
    ----------
    projector : Projector
    camera : Camera
    layout : ProjectorLayout, optional
        Where the rays lie on the projector. None: each of its pixels is a ray.
    resampling : Resampling, optional
        How the camera's merged images become images on the ray grid. None: the camera's pixels
        are its rays.
    seconds_per_pattern : float
        Seconds that a bracket takes about, for estimates; at least 0.
    verdicts : mapping, optional
        Of its calibration, see `rfpipe.rigs.calibrated`: whoever acquires with the rig is told.

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
                    f"the calibration is of a {device} of {tuple(calibrated)} pixels; this one has "
                    f"{tuple(shape)}. Calibrate again, or set the {device}'s size back"
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
            frames[index] = self._watch.kept(name, picture, take)
        return frames

    @property
    def sequence_patterns(self) -> int:
        """The most patterns of a sequence; 0 where the devices have none together."""
        return 0 if self._sequencer is None else self._sequencer.most

    def show_sequence(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns by sequences; see `rfpipe.rigs.base.sequence_patterns`."""
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
        """Plain data for fingerprints and manifests: all that shapes a frame."""
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
        """Counts of the devices so far, such as failed frames."""
        of = {"projector": self.projector, "camera": self.camera, "sequences": self._sequencer}
        of["brackets"] = self._watch
        return {
            name: dict(one.statistics) for name, one in of.items() if hasattr(one, "statistics")
        }

    def close(self) -> None:
        """Give both devices back; closing twice is no error."""
        try:
            self.camera.close()
        finally:
            self.projector.close()


def rig_from_config(
    config: RigConfig, source: str = "the rig's settings", *, force: bool = False
) -> Rig:
    """Return the rig of a settings file; close it, if it has devices, when done.

    Parameters
    ----------
    config : RigConfig
    source : str
        Name of the settings in messages, such as their file.
    force : bool
        Whether settings and devices may differ from those that were calibrated.

    Raises
    ------
    CaptureError
        When a device doesn't answer.
    StoreError
        When the calibration can't be read.
    ConfigError
        When settings or devices changed after the calibration.
    InputError
        When the calibration doesn't fit the devices.
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
    """Return projector and camera of a rig of devices, or those of its bench.

    ConfigError where the rig is a simulated one or a whole, CaptureError where a device doesn't
    answer.
    """
    if config.kind == "simulated" or config.rig is not None:
        what = "simulated" if config.rig is None else f"a whole, {config.rig.driver}"
        raise ConfigError(f"the rig is {what}; expected one of devices, or with a bench")
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
