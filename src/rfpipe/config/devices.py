"""The settings of a rig: its devices, and the optical bench in software."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, NonNegativeFloat, SerializeAsAny, model_validator

from rfpipe.config.base import Corners, Extent, Gamma, Settings, Share, Text, group_of
from rfpipe.config.calibration import CalibrationConfig
from rfpipe.config.camera import CameraConfig
from rfpipe.config.drivers import CameraDriver, ProjectorDriver, RigDriver
from rfpipe.config.scenes import SceneSettings

Pixels = Annotated[int, Field(ge=-4096, le=4096)]
Knock = tuple[Annotated[int, Field(ge=0)], Pixels, Pixels]
"""Exposures before it, and pixels down and to the right."""


class BenchConfig(Settings):
    """The optical bench in software: a scene between the projector's window and the camera.

    It is one to the programs around it, too: window, X server (where Xvfb is installed) and camera
    driver are the real ones, the camera is the driver's emulated one.
    """

    scene: SerializeAsAny[SceneSettings] = Field(
        default_factory=lambda: SceneSettings.of(
            "wedge", surfaces=("white", "texture"), shape=(32, 32), channels=1
        ),
        description="The scene; 1 channel for a grey camera, 3 for one with a colour mosaic.",
    )
    display_shape: tuple[Extent, Extent] = Field(
        (288, 320), description="Height and width of the display in pixels, 1 to 4096 each."
    )
    projector_corners: Corners | None = Field(
        None,
        description="Corners of each view's rays in the projector's picture, in pixels, from the "
        "upper left one clockwise; null: in the middle, as large as fits.",
    )
    camera_corners: Corners | None = Field(
        None,
        description="The same on the camera; null: in the middle, turned and distorted a little.",
    )
    camera_shape: tuple[Extent, Extent] = Field(
        (72, 80), description="Height and width of the camera's frames in pixels, 1 to 4096 each."
    )
    camera: CameraConfig | None = Field(
        None,
        description="The camera's true numbers, for calibration to measure; null: the sensor's.",
    )
    projector_gamma: Gamma = Field(
        2.2, description="Exponent g of the projector, light ~ code^g, above 0 and at most 5."
    )
    projector_black: Share = Field(
        0.0,
        description="Light of a pixel at code 0 as a fraction of that at 255, from 0 to below 1.",
    )
    display_delay_seconds: float = Field(
        0.0,
        ge=0,
        le=60,
        description="Time from a picture's drawing to its light, in seconds, 0 to 60.",
    )
    ambient: NonNegativeFloat = Field(
        0.0, description="Radiance of other light in every camera pixel, at least 0."
    )
    knock: Knock | None = Field(
        None,
        description="A knock against the projector: exposures before it, and pixels by which the "
        "picture moves down and to the right, such as [200, 0, 4]; null: none.",
    )

    @model_validator(mode="after")
    def _scene_is_coaxial(self) -> Self:
        if not self.scene.is_coaxial:
            raise ValueError("scene should be a coaxial one: a bench has one domain of rays")
        return self

    @model_validator(mode="after")
    def _has_a_quadrilateral_for_each_view(self) -> Self:
        views = math.prod(self.scene.view_grid)
        for name in ("projector_corners", "camera_corners"):
            corners = getattr(self, name)
            if corners is not None and len(corners) != views:
                raise ValueError(
                    f"{name} should have four corners for each of the scene's {views} views, not "
                    f"for {len(corners)}"
                )
        return self


class RigConfig(Settings):
    """All settings of a rig."""

    kind: Literal["devices", "simulated"] = Field(
        "devices",
        description="devices: a projector and a camera, or the bench; simulated: a scene, "
        "exactly as in a run's settings.",
    )
    projector: ProjectorDriver = Field(
        default_factory=lambda: ProjectorDriver.model_validate({}),
        description="The projector of a rig of devices.",
    )
    rays: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the ray domain without a calibration, in the middle of "
        "the projector; null: a projector pixel a ray.",
    )
    camera: CameraDriver = Field(
        default_factory=lambda: CameraDriver.model_validate({}),
        description="The camera of a rig of devices.",
    )
    rig: RigDriver | None = Field(
        None,
        description="A rig as a whole, in place of projector and camera, or null.",
    )
    sensor: CameraConfig | None = Field(
        default_factory=CameraConfig,
        description="The sensor: its exposures, and what is known of its noise. A calibration's "
        "numbers take the place of these. null: exact radiance, of a simulated rig only.",
    )
    calibration: Text | None = Field(
        None,
        description="Folder of the rig's calibration, relative to where rfpipe runs, or null.",
    )
    calibrate: CalibrationConfig = group_of(CalibrationConfig)
    bench: BenchConfig | None = Field(
        None,
        description="The optical bench in software, in place of display, scene and camera; null "
        "for real ones.",
    )
    scene: SerializeAsAny[SceneSettings] | None = Field(
        None, description="The scene of a simulated rig; null for a rig of devices."
    )
    seed: int = Field(0, ge=0, description="Seed of the simulated noise, at least 0.")
    seconds_per_pattern: float = Field(
        2.0,
        ge=0,
        le=3600,
        description="Time that a bracket takes about, in seconds, 0 to 3600, for estimates.",
    )

    @model_validator(mode="after")
    def _has_a_scene_where_simulated(self) -> Self:
        if self.rig is None and (self.scene is None) == (self.kind == "simulated"):
            expected = "be set" if self.scene is None else "be null"
            raise ValueError(f"scene should {expected} with kind {self.kind}")
        if self.bench is not None and self.kind == "simulated":
            raise ValueError("bench should be null with kind simulated")
        return self

    @model_validator(mode="after")
    def _rig_as_a_whole_stands_alone(self) -> Self:
        if self.rig is not None:
            for name in ("bench", "scene", "calibration"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name} should be null with a rig as a whole")
        return self

    @model_validator(mode="after")
    def _sensor_is_that_of_the_camera(self) -> Self:
        if self.kind == "simulated" or self.rig is not None:
            return self
        if self.sensor is None:
            raise ValueError("sensor should be set with kind devices, not null")
        models = {"sensor": self.sensor}
        if self.bench is not None and self.bench.camera is not None:
            models["bench.camera"] = self.bench.camera
        camera = self.camera.options
        for name, model in models.items():
            for setting in ("bits", "bayer"):
                known, expected = getattr(model, setting), getattr(camera, setting, ...)
                if expected not in (..., known):
                    raise ValueError(
                        f"{name}.{setting} should be {expected or 'null'} with {self._delivers}, "
                        f"not {known or 'null'}"
                    )
        return self

    @model_validator(mode="after")
    def _bench_fits_the_devices(self) -> Self:
        if self.bench is None:
            return self
        drivers = self.projector.driver, self.camera.driver
        if drivers[0] != "window" or self.camera.bench is None:
            raise ValueError(
                f"projector.driver and camera.driver should be window and pylon, or another "
                f"camera of rfpipe's own, with a bench, which drives them in software, not "
                f"{drivers[0]} and {drivers[1]}"
            )
        window, camera = self.projector.options.model_dump(), self.camera.options.model_dump()
        channels = getattr(self.camera.options, "channels", self.bench.scene.channels)
        if self.bench.scene.channels != channels:
            raise ValueError(
                f"bench.scene.channels should be {channels} with {self._delivers}, not "
                f"{self.bench.scene.channels}"
            )
        if window["display"] is not None:
            raise ValueError(
                "projector.options.display should be null with a bench, which has its own display, "
                f"not {window['display']}"
            )
        if camera.get("shape") is not None or tuple(camera.get("offset", (0, 0))) != (0, 0):
            raise ValueError(
                "camera.options.shape should be null and camera.options.offset [0, 0] with a "
                "bench, whose camera_shape says what the camera takes"
            )
        return self

    @property
    def _delivers(self) -> str:
        """Say what decides which counts the camera delivers."""
        chosen = getattr(self.camera.options, "pixel_format", None)
        if chosen is None:
            return f"camera.driver {self.camera.driver}"
        return f"camera.options.pixel_format {chosen}"
