"""The settings of a rig: its projector, its camera, and the optical bench in software."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rfpipe.config.base import Extent, Settings
from rfpipe.config.calibration import CalibrationConfig, Quadrilateral
from rfpipe.config.rig import CameraConfig, SceneConfig

__all__ = ["BenchConfig", "PixelFormat", "PylonConfig", "RigConfig", "WindowConfig"]

PixelFormat = Literal[
    "Mono8", "Mono10", "Mono12", "Mono16",
    "BayerRG8", "BayerRG10", "BayerRG12", "BayerRG16",
    "BayerGR8", "BayerGR10", "BayerGR12", "BayerGR16",
    "BayerGB8", "BayerGB10", "BayerGB12", "BayerGB16",
    "BayerBG8", "BayerBG10", "BayerBG12", "BayerBG16",
]  # fmt: skip
Offset = Annotated[int, Field(ge=0, le=32768)]
PictureExtent = Annotated[int, Field(ge=1, le=32768)]

_MOSAICS = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}


class WindowConfig(Settings):
    """The projector: a full-screen window on a display."""

    display: str | None = Field(
        None,
        pattern=r"^\S*:\d+(\.\d+)?$",
        description="X display, such as :0, or null for that of the environment's DISPLAY.",
    )
    screen: int = Field(
        0, ge=0, le=63, description="Number of the monitor on that display, 0 to 63."
    )
    offset: tuple[Offset, Offset] = Field(
        (0, 0),
        description="Place of the picture on the monitor: pixels from its upper edge and from "
        "its left edge.",
    )
    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None,
        description="Height and width of the picture in pixels, or null for the whole monitor. "
        "Set the monitor to the projector's native resolution.",
    )
    settle_seconds: float = Field(
        0.1,
        ge=0,
        le=60,
        description="Wait after a picture was drawn, until the projector shows it, in seconds, 0 "
        "to 60: two or three frames of the display plus the projector's own delay.",
    )
    response: str | None = Field(
        None,
        description="Text file with the light of the codes 0 to 255, one number a line, as a "
        "fraction of that of 255; null for that of the calibration, or, without one, light in "
        "proportion to the code.",
    )


class PylonConfig(Settings):
    """A Basler camera."""

    serial: str | None = Field(
        None, min_length=1, description="Serial number, or null for the only camera connected."
    )
    pixel_format: PixelFormat = Field(
        "Mono12",
        description="Mono8, Mono10, Mono12 or Mono16, or one of a colour mosaic: BayerRG, "
        "BayerGR, BayerGB or BayerBG with 8, 10, 12 or 16 bits. sensor.bits and sensor.bayer say "
        "the same.",
    )
    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None, description="Height and width of the frames in pixels, or null for the whole sensor."
    )
    offset: tuple[Offset, Offset] = Field(
        (0, 0),
        description="Place of the frames on the sensor: rows from its upper edge, columns from "
        "its left edge.",
    )
    gain_db: float = Field(
        0.0, ge=0, le=48, description="Gain in decibels, fixed, 0 to 48; 0 has the least noise."
    )
    timeout_seconds: float = Field(
        2.0,
        gt=0,
        le=600,
        description="Seconds until a frame counts as lost, beyond its exposure time; above 0, at "
        "most 600.",
    )
    retries: int = Field(
        3, ge=0, le=100, description="How often a failed frame is taken again, 0 to 100."
    )
    reconnects: int = Field(
        5, ge=0, le=1000, description="How often a lost camera is looked for, 0 to 1000."
    )
    reconnect_seconds: float = Field(
        2.0, ge=0, le=600, description="Wait before each of these attempts in seconds, 0 to 600."
    )
    nodes: dict[str, bool | int | float | str] = Field(
        default_factory=dict,
        description="Further settings of the camera, as its manual names them, such as "
        "{SensorReadoutMode: Fast}.",
    )

    @property
    def bits(self) -> int:
        """Bits of the pixel format."""
        return int(self.pixel_format.removeprefix("Mono").removeprefix("Bayer").lstrip("RGB"))

    @property
    def bayer(self) -> str | None:
        """Colour mosaic of the pixel format, None for grey."""
        if self.pixel_format.startswith("Mono"):
            return None
        return _MOSAICS[self.pixel_format.removeprefix("Bayer")[:2]]


class BenchConfig(Settings):
    """The optical bench in software: a scene between the projector's window and the camera.

    It is one to the programs around it, too: window, X server and camera driver are the real ones,
    the camera is the driver's emulated one.
    """

    scene: SceneConfig = Field(
        default_factory=lambda: SceneConfig(
            geometry="wedge", surfaces=("white", "texture"), shape=(32, 32), channels=1
        ),
        description="The scene; 1 channel for a grey camera, 3 for one with a colour mosaic.",
    )
    display_shape: tuple[Extent, Extent] = Field(
        (288, 320), description="Height and width of the display in pixels, 1 to 4096 each."
    )
    projector_corners: tuple[Quadrilateral, ...] | None = Field(
        None,
        min_length=1,
        description="Where the projector lights the scene, for each view: (x, y) of the upper "
        "left, upper right, lower right and lower left corner of the rays, in pixels from the "
        "picture's upper left corner, x to the right, y downwards. null: in the middle, each ray "
        "a square of as many whole pixels as fit.",
    )
    camera_corners: tuple[Quadrilateral, ...] | None = Field(
        None,
        min_length=1,
        description="The same on the camera. null: in the middle, over nine tenths of the "
        "picture, turned and distorted a little.",
    )
    camera_shape: tuple[Extent, Extent] = Field(
        (72, 80), description="Height and width of the camera's frames in pixels, 1 to 4096 each."
    )
    camera: CameraConfig | None = Field(
        None,
        description="The camera's true numbers, to be found by calibration; its exposures aren't "
        "used. null: those of sensor.",
    )
    projector_gamma: float = Field(
        2.2,
        gt=0,
        le=5,
        description="Exponent g of the projector, light ~ code^g, above 0 and at most 5.",
    )
    projector_black: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Light of a pixel at code 0 as a fraction of that at 255, from 0 to below 1.",
    )
    ambient: float = Field(
        0.0, ge=0, description="Radiance of other light in every camera pixel, at least 0."
    )

    @model_validator(mode="after")
    def _has_a_quadrilateral_for_each_view(self) -> Self:
        views = math.prod(self.scene.views or (1, 1))
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
        description="devices: a projector and a camera, or the bench; simulated: a scene under a "
        "coaxial rig, exactly as in a run's settings.",
    )
    projector: WindowConfig = Field(
        default_factory=WindowConfig, description="The projector of a rig of devices."
    )
    rays: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the ray domain where there is no calibration: each ray "
        "is a square of as many whole projector pixels as fit, in the middle. null: each "
        "projector pixel is a ray.",
    )
    camera: PylonConfig = Field(
        default_factory=PylonConfig, description="The camera of a rig of devices."
    )
    sensor: CameraConfig | None = Field(
        default_factory=CameraConfig,
        description="The sensor: its exposures, and what is known of its noise. A calibration's "
        "numbers take the place of these. null: exact radiance, of a simulated rig only.",
    )
    calibration: str | None = Field(
        None,
        min_length=1,
        description="Folder of the rig's calibration, relative to where rfpipe runs, or null.",
    )
    calibrate: CalibrationConfig = Field(
        default_factory=CalibrationConfig, description="How the rig is calibrated."
    )
    bench: BenchConfig | None = Field(
        None,
        description="The optical bench in software, in place of display, scene and camera; null "
        "for real ones.",
    )
    scene: SceneConfig | None = Field(
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
        if (self.scene is None) == (self.kind == "simulated"):
            expected = "be set" if self.scene is None else "be null"
            raise ValueError(f"scene should {expected} with kind {self.kind}")
        if self.bench is not None and self.kind == "simulated":
            raise ValueError("bench should be null with kind simulated")
        return self

    @model_validator(mode="after")
    def _sensor_is_that_of_the_camera(self) -> Self:
        if self.kind == "simulated":
            return self
        if self.sensor is None:
            raise ValueError("sensor should be set with kind devices, not null")
        models = {"sensor": self.sensor}
        if self.bench is not None and self.bench.camera is not None:
            models["bench.camera"] = self.bench.camera
        for name, model in models.items():
            for setting in ("bits", "bayer"):
                known, expected = getattr(model, setting), getattr(self.camera, setting)
                if known != expected:
                    raise ValueError(
                        f"{name}.{setting} should be {expected or 'null'} with "
                        f"camera.pixel_format {self.camera.pixel_format}, not {known or 'null'}"
                    )
        return self

    @model_validator(mode="after")
    def _bench_fits_the_devices(self) -> Self:
        if self.bench is None:
            return self
        channels = 1 if self.camera.bayer is None else 3
        if self.bench.scene.channels != channels:
            raise ValueError(
                f"bench.scene.channels should be {channels} with camera.pixel_format "
                f"{self.camera.pixel_format}, not {self.bench.scene.channels}"
            )
        if self.projector.display is not None:
            raise ValueError(
                f"projector.display should be null with a bench, which has its own display, not "
                f"{self.projector.display}"
            )
        if self.camera.shape is not None or self.camera.offset != (0, 0):
            raise ValueError(
                "camera.shape should be null and camera.offset [0, 0] with a bench, whose "
                "camera_shape says what the camera takes"
            )
        return self
