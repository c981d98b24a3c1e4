"""The settings of a rig: its devices, its calibration, and the optical bench in software."""

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
    setting,
)
from rfpipe.config.camera import CameraConfig
from rfpipe.config.drivers import CameraDriver, ProjectorDriver, RigDriver
from rfpipe.config.scenes import SceneSettings

Pixels = Annotated[int, Field(ge=-4096, le=4096)]
Count = Annotated[int, Field(ge=2, le=1000)]


class CalibrationConfig(Settings):
    """How a rig is calibrated: what is shown and taken, and how good the rig is to be."""

    tolerance: Fraction = setting(0.02, "Error of a relit picture that verdicts allow, 0 to 1.")
    coaxial: bool = setting(
        True, "Whether camera and projector share their rays; symmetry is then checked."
    )
    dark_frames: Count = setting(8, "Brackets of the all-off picture, 2 to 1000.")
    levels: Count = setting(
        8, "Flat pictures of the photon-transfer curve, from dark to bright, 2 to 1000."
    )
    codes: int = setting(33, "Codes at which the projector's light is measured.", ge=5, le=256)
    period_pixels: int = setting(
        16,
        "Period of the stripes in projector pixels, a multiple of 4.",
        ge=8,
        le=1024,
        multiple_of=4,
    )
    views: tuple[ViewCount, ViewCount] | None = setting(
        None, "Rows and columns of an array of views, 1 to 16 each; null: a single one."
    )
    corners: Corners | None = setting(
        None,
        "Corners of each view on the projector in pixels, from the upper left one clockwise; null: "
        "measured.",
    )
    symmetry_patterns: int = setting(
        12, "Random patterns that symmetry is checked with.", ge=3, le=1000
    )

    @model_validator(mode="after")
    def _has_corners_for_each_view(self) -> Self:
        if self.corners is not None and self.views is not None:
            _check_corners("corners", self.corners, math.prod(self.views))
        return self


def _check_corners(name: str, corners: Corners, views: int) -> None:
    """Raise ValueError for other than one quadrilateral a view."""
    if len(corners) != views:
        raise ValueError(
            f"{name} should have four corners for each of {views} views, not for {len(corners)}"
        )


class BenchConfig(Settings):
    """The optical bench in software: a scene between the projector's pictures and the camera.

    The camera driver is the real one, its camera the driver's emulated one.
    """

    scene: SerializeAsAny[SceneSettings] = Field(
        default_factory=lambda: SceneSettings.of(
            "wedge", surfaces=("white", "texture"), shape=(32, 32), channels=1
        ),
        description="The scene; 1 channel for a grey camera, 3 for one with a colour mosaic.",
    )
    display_shape: tuple[Extent, Extent] = setting(
        (288, 320), "Height and width of the display in pixels, 1 to 4096 each."
    )
    camera_corners: Corners | None = setting(
        None,
        "Corners of each view's rays on the camera in pixels, from the upper left one clockwise; "
        "null: in the middle, turned and distorted a little.",
    )
    camera_shape: tuple[Extent, Extent] = setting(
        (72, 80), "Height and width of the camera's frames in pixels, 1 to 4096 each."
    )
    camera: CameraConfig | None = setting(
        None, "The camera's true numbers, for calibration to measure; null: the sensor's."
    )
    projector_gamma: Gamma = setting(
        2.2, "Exponent g of the projector, light ~ code^g, above 0 and at most 5."
    )
    projector_black: Share = setting(0.0, "Light of a pixel at code 0 over that at 255, below 1.")
    display_delay_seconds: float = setting(
        0.0, "Time from a picture's drawing to its light, in seconds.", ge=0, le=60
    )
    ambient: float = setting(0.0, "Radiance of other light in every camera pixel.", ge=0)
    knock: tuple[Annotated[int, Field(ge=0)], Pixels, Pixels] | None = setting(
        None,
        "A knock against the projector: exposures before it, and pixels by which the picture moves "
        "down and to the right, such as [200, 0, 4]; null: none.",
    )

    @model_validator(mode="after")
    def _scene_is_coaxial(self) -> Self:
        if not self.scene.is_coaxial:
            raise ValueError("scene should be a coaxial one: a bench has one domain of rays")
        if self.camera_corners is not None:
            views = math.prod(self.scene.view_grid)
            _check_corners("camera_corners", self.camera_corners, views)
        return self


class RigConfig(Settings):
    """All settings of a rig."""

    kind: Literal["devices", "simulated"] = setting(
        "devices", "devices: a projector and a camera, or the bench; simulated: a scene."
    )
    projector: ProjectorDriver = Field(
        default_factory=lambda: ProjectorDriver.model_validate({}),
        description="The projector of a rig of devices.",
    )
    rays: tuple[Extent, Extent] | None = setting(
        None,
        "Height and width of the ray domain without a calibration; null: a projector pixel a ray.",
    )
    camera: CameraDriver = Field(
        default_factory=lambda: CameraDriver.model_validate({}),
        description="The camera of a rig of devices.",
    )
    rig: RigDriver | None = setting(
        None, "A rig as a whole, in place of projector and camera, or null."
    )
    sensor: CameraConfig | None = Field(
        default_factory=CameraConfig,
        description="The sensor: its exposures, and what is known of its noise. A calibration's "
        "numbers take the place of these. null: exact radiance, of a simulated rig only.",
    )
    calibration: Text | None = setting(
        None, "Folder of the rig's calibration, relative to where rfpipe runs, or null."
    )
    calibrate: CalibrationConfig = group_of(CalibrationConfig)
    bench: BenchConfig | None = setting(
        None, "The optical bench in software, in place of display, scene and camera."
    )
    scene: SerializeAsAny[SceneSettings] | None = setting(
        None, "The scene of a simulated rig; null for a rig of devices."
    )
    seed: int = setting(0, "Seed of the simulated noise.", ge=0)
    seconds_per_pattern: float = setting(
        2.0, "Time that a bracket takes about, in seconds, for estimates.", ge=0, le=3600
    )

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        is_simulated, is_whole = self.kind == "simulated", self.rig is not None
        why = "a rig as a whole" if is_whole else f"kind {self.kind}"
        if is_simulated and not is_whole and self.scene is None:
            raise ValueError(f"scene should be set with {why}")
        if not is_simulated and not is_whole and self.sensor is None:
            raise ValueError(f"sensor should be set with {why}, not null")
        for name, is_none in (
            ("scene", is_whole or not is_simulated),
            ("bench", is_whole or is_simulated),
            ("calibration", is_whole),
        ):
            if is_none and getattr(self, name) is not None:
                raise ValueError(f"{name} should be null with {why}")
        return self

    @model_validator(mode="after")
    def _bench_fits_the_devices(self) -> Self:
        if self.bench is None:
            return self
        drivers = self.projector.driver, self.camera.driver
        if drivers[0] != "window" or self.camera.bench is None:
            raise ValueError(
                "projector.driver and camera.driver should be window and pylon with a bench, "
                f"which drives them in software, not {drivers[0]} and {drivers[1]}"
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
