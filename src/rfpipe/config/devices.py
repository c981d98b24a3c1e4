"""Settings of a rig: devices, calibration, and the optical bench in software."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, SerializeAsAny, model_validator

from rfpipe.config.base import (
    Corners,
    Extent,
    Fraction,
    Gamma,
    Settings,
    Share,
    Text,
    ViewCount,
    group_of,
)
from rfpipe.config.camera import CameraConfig
from rfpipe.config.drivers import CameraDriver, ProjectorDriver, RigDriver
from rfpipe.config.scenes import SceneSettings

Pixels = Annotated[int, Field(ge=-4096, le=4096)]
Count = Annotated[int, Field(ge=2, le=1000)]


class CalibrationConfig(Settings):
    """Calibration of the rig: patterns, pictures, and the accepted error."""

    tolerance: Fraction = Field(
        0.02, description="Relative error of relit pictures that the verdicts accept."
    )
    coaxial: bool = Field(
        True,
        description="Camera and projector share their rays; the symmetry is then checked.",
    )
    dark_frames: Count = Field(8, description="Brackets of the all-off pattern.")
    levels: Count = Field(
        8, description="Flat pictures of the photon-transfer curve, from dark to bright."
    )
    codes: int = Field(
        33, description="Codes at which the projector's light is measured.", ge=5, le=256
    )
    period_pixels: int = Field(
        16,
        description="Period of the stripes in projector pixels, a multiple of 4.",
        ge=8,
        le=1024,
        multiple_of=4,
    )
    views: tuple[ViewCount, ViewCount] | None = Field(
        None, description="Rows and columns of an array of views; null: a single view."
    )
    corners: Corners | None = Field(
        None,
        description="Corners (x, y) of each view on the projector in pixels, clockwise from the "
        "upper left; null: measured.",
    )
    symmetry_patterns: int = Field(
        12, description="Random patterns for the check of symmetry.", ge=3, le=1000
    )

    @model_validator(mode="after")
    def _check_corners_of_views(self) -> Self:
        if self.corners is not None and self.views is not None:
            _check_corners("corners", self.corners, math.prod(self.views))
        return self


def _check_corners(name: str, corners: Corners, views: int) -> None:
    """Raise ValueError unless there is one quadrilateral per view."""
    if len(corners) != views:
        raise ValueError(
            f"{name} should have four corners for each of {views} views, not for {len(corners)}"
        )


class LensConfig(Settings):
    """A thin lens of the optical bench."""

    aperture: float = Field(
        0.0, ge=0, description="Diameter of the lens in scene units; 0: a pinhole, all in focus."
    )
    focus: float = Field(
        3.0,
        gt=0,
        description="Distance in focus along the optical axis, in scene units; scenes are at about "
        "3.",
    )


class BenchConfig(Settings):
    """The optical bench in software: a simulated scene between projector window and camera.

    The real camera driver runs with the emulated camera that its vendor provides.
    """

    scene: SerializeAsAny[SceneSettings] = Field(
        default_factory=lambda: SceneSettings.of(
            "wedge", surfaces=("white", "texture"), shape=(32, 32), channels=1
        ),
        description="The scene, with 1 channel for a grey camera or 3 for a colour mosaic.",
    )
    display_shape: tuple[Extent, Extent] = Field(
        (288, 320), description="Height and width of the display in pixels."
    )
    camera_corners: Corners | None = Field(
        None,
        description="Corners (x, y) of each view's rays on the camera in pixels, clockwise from "
        "the upper left; null: central, slightly rotated and distorted.",
    )
    camera_shape: tuple[Extent, Extent] = Field(
        (72, 80), description="Height and width of the camera's frames in pixels."
    )
    camera: CameraConfig | None = Field(
        None,
        description="True parameters of the camera, which a calibration should measure; null: "
        "those of the sensor.",
    )
    projector_lens: LensConfig | None = Field(
        None,
        description="Lens of the projector, such as {aperture: 0.05, focus: 2.5}, which blurs its "
        "light by the depth of the surface; null: a pinhole.",
    )
    camera_lens: LensConfig | None = Field(
        None, description="Lens of the camera, likewise; null: a pinhole."
    )
    projector_gamma: Gamma = Field(2.2, description="Exponent g of the projector, light ~ code^g.")
    projector_black: Share = Field(
        0.0, description="Light of a projector pixel at code 0, relative to code 255."
    )
    display_delay_seconds: float = Field(
        0.0, description="Seconds from drawing a pattern to its light.", ge=0, le=60
    )
    ambient: float = Field(
        0.0, description="Radiance of ambient light in every camera pixel.", ge=0
    )
    knock: tuple[Annotated[int, Field(ge=0)], Pixels, Pixels] | None = Field(
        None,
        description="A simulated knock against the projector: exposures before it, and the "
        "movement of the picture down and to the right in pixels, such as [200, 0, 4]; null: none.",
    )

    @model_validator(mode="after")
    def _check_scene_is_coaxial(self) -> Self:
        if not self.scene.is_coaxial:
            raise ValueError("scene should be coaxial: a bench has one ray domain")
        if self.camera_corners is not None:
            views = math.prod(self.scene.view_grid)
            _check_corners("camera_corners", self.camera_corners, views)
        return self


class RigConfig(Settings):
    """All settings of a rig."""

    kind: Literal["devices", "simulated"] = Field(
        "devices",
        description="devices: a projector and a camera, or the bench; simulated: a simulated "
        "scene.",
    )
    projector: ProjectorDriver = Field(
        default_factory=lambda: ProjectorDriver.model_validate({}),
        description="Projector of a rig of devices.",
    )
    rays: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the ray domain without a calibration; null: a ray per "
        "projector pixel.",
    )
    camera: CameraDriver = Field(
        default_factory=lambda: CameraDriver.model_validate({}),
        description="Camera of a rig of devices.",
    )
    rig: RigDriver | None = Field(
        None,
        description="A complete rig in place of a separate projector and camera; null: none.",
    )
    sensor: CameraConfig | None = Field(
        default_factory=CameraConfig,
        description="Exposures and noise of the sensor, unless a calibration measured them; "
        "null: exact radiance, for a simulated rig only.",
    )
    calibration: Text | None = Field(
        None,
        description="Folder of the rig's calibration, relative to the folder where rfpipe runs; "
        "null: none.",
    )
    calibrate: CalibrationConfig = group_of(CalibrationConfig)
    bench: BenchConfig | None = Field(
        None,
        description="The optical bench in software, in place of display, scene and camera; null: "
        "none.",
    )
    scene: SerializeAsAny[SceneSettings] | None = Field(
        None, description="Scene of a simulated rig; null: for a rig of devices."
    )
    seed: int = Field(0, description="Seed of the simulated noise.", ge=0)
    seconds_per_pattern: float = Field(
        2.0,
        description="Seconds that a bracket takes approximately, for forecasts.",
        ge=0,
        le=3600,
    )

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        is_simulated, is_complete = self.kind == "simulated", self.rig is not None
        reason = "a complete rig" if is_complete else f"kind {self.kind}"
        if is_simulated and not is_complete and self.scene is None:
            raise ValueError(f"scene should be set with {reason}")
        if not is_simulated and not is_complete and self.sensor is None:
            raise ValueError(f"sensor should be set with {reason}, not null")
        if self.scene is not None and (is_complete or not is_simulated):
            raise ValueError(f"scene should be null with {reason}")
        if self.bench is not None and (is_complete or is_simulated):
            raise ValueError(f"bench should be null with {reason}")
        if self.calibration is not None and is_complete:
            raise ValueError(f"calibration should be null with {reason}")
        return self

    @model_validator(mode="after")
    def _check_devices_of_bench(self) -> Self:
        if self.bench is None:
            return self
        projector, camera = self.projector.driver, self.camera.driver
        if projector != "window" or self.camera.bench is None:
            raise ValueError(
                "projector.driver and camera.driver should be window and pylon with a bench, "
                f"which emulates them in software, not {projector} and {camera}"
            )
        sensor, true = self.sensor, self.bench.camera or self.sensor
        assert sensor is not None  # of a rig of devices
        assert true is not None
        if (true.bits, true.bayer) != (sensor.bits, sensor.bayer):
            raise ValueError("bench.camera.bits and bench.camera.bayer should be the sensor's")
        channels = 1 if sensor.bayer is None else 3
        if self.bench.scene.channels != channels:
            raise ValueError(
                f"bench.scene.channels should be {channels} with sensor.bayer "
                f"{sensor.bayer or 'null'}, not {self.bench.scene.channels}"
            )
        return self
