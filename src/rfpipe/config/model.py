"""The model of a run's settings: names, units, ranges and defaults.

Plain data only: the layers above build cameras, scenes and methods from it.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

__all__ = [
    "AcquisitionConfig",
    "CameraConfig",
    "CaptureConfig",
    "Config",
    "MergeConfig",
    "MethodName",
    "Normalization",
    "NumberFormat",
    "OccluderConfig",
    "ReportConfig",
    "ResourcesConfig",
    "SceneConfig",
    "StorageConfig",
    "Surface",
]

Surface = Literal["white", "texture"]
MethodName = Literal["brute_force", "dual", "symmetric"]
Normalization = Literal["none", "per_channel", "total_energy"]
NumberFormat = Literal["float32", "uint16", "uint8"]

Exposure = Annotated[float, Field(gt=0, le=60)]
Extent = Annotated[int, Field(ge=1, le=4096)]
Tolerance = Annotated[float, Field(gt=0, lt=1)]
ViewCount = Annotated[int, Field(ge=1, le=16)]
SpanDegrees = Annotated[float, Field(ge=0, le=45)]
Vector = tuple[float, float, float]
SceneName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]


class _Settings(BaseModel):
    """Base of all settings: unknown keys are errors, values can't change, numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value_as_number(cls, value: object, info: ValidationInfo) -> object:
        # pydantic would read true as 1, and YAML reads a bare yes or on as true
        name = info.field_name
        if isinstance(value, bool) and name and cls.model_fields[name].annotation is not bool:
            raise ValueError("should not be true or false")
        return value


class OccluderConfig(_Settings):
    """A black parallelogram that blocks light between surface points, and the camera's view."""

    centre: Vector = Field(
        description="Centre (x, y, z) in scene units; the camera is at the origin and looks "
        "along +z, the scene's surfaces are at z of about 1 to 3."
    )
    edge_u: Vector = Field(
        description="Vector from the centre to the middle of one edge, in scene units."
    )
    edge_v: Vector = Field(
        description="Vector from the centre to the middle of a neighbouring edge, in scene units; "
        "not parallel to edge_u."
    )

    @model_validator(mode="after")
    def _spans_a_parallelogram(self) -> Self:
        (a, b, c), (d, e, f) = self.edge_u, self.edge_v
        if (b * f - c * e, c * d - a * f, a * e - b * d) == (0, 0, 0):
            raise ValueError("edge_u and edge_v should span a parallelogram, but they are parallel")
        return self


class SceneConfig(_Settings):
    """A simulated scene seen by a coaxial rig."""

    geometry: Literal["plane", "wedge", "room"] = Field(
        description="plane: one plane across the line of sight; wedge: two planes that meet in "
        "a concave edge, farthest from the camera; room: the corner of a room with a box, a "
        "poster and a card in it."
    )
    surfaces: tuple[Surface, ...] = Field(
        min_length=1,
        max_length=3,
        description="Albedo of each surface: one for a plane, left and right for a wedge, left "
        "wall, right wall and floor for a room. white: albedo 0.8; texture: text-like strokes of "
        "albedo 0.15 and 0.85. A room's surfaces are tinted, too.",
    )
    shape: tuple[Extent, Extent] = Field(
        (62, 70),
        description="Rays of the rig, or of each of its views: height and width in pixels, 1 to "
        "4096 each.",
    )
    views: tuple[ViewCount, ViewCount] | None = Field(
        None,
        description="A room's rig as a planar array of coaxial projectors and cameras, a light "
        "field [5.2]: rows and columns, 1 to 16 each; null for a single pair.",
    )
    span_degrees: tuple[SpanDegrees, SpanDegrees] = Field(
        (37.0, 29.0),
        description="Angles under which the outermost columns and rows of the array appear from "
        "the scene's centre, horizontally and vertically, in degrees, 0 to 45 each.",
    )
    channels: Literal[1, 3] = Field(3, description="Colour channels: 1 (grey) or 3 (RGB).")
    bounces: Literal[1, 2, 3] = Field(
        3, description="Light simulated: 1 is direct light alone, 2 and 3 add inter-reflection."
    )
    occluders: tuple[OccluderConfig, ...] = Field(
        (),
        description="Parallelograms that block light between the surfaces of a plane or wedge.",
    )
    seed: int = Field(0, ge=0, description="Seed of the texture's strokes, at least 0.")
    methods: tuple[MethodName, ...] | None = Field(
        None,
        min_length=1,
        description="Methods to acquire this scene with, or null for those of the whole run.",
    )
    tolerance: Tolerance | None = Field(
        None,
        description="Tolerance of this scene, as acquisition.tolerance, or null for that one.",
    )
    sweep: bool = Field(
        True,
        description="Whether to acquire the scene again at each of report.tolerances, for the "
        "plot of speed against error: true or false.",
    )

    @property
    def ray_shape(self) -> tuple[int, ...]:
        """Shape of the ray domain: (H, W), or (V, H, W) for an array of views."""
        return self.shape if self.views is None else (math.prod(self.views), *self.shape)

    @field_validator("methods", mode="after")
    @classmethod
    def _no_method_twice(cls, methods: tuple[MethodName, ...] | None) -> Any:
        return methods and _each_once(methods)

    @model_validator(mode="after")
    def _fits_the_geometry(self) -> Self:
        expected = {"plane": 1, "wedge": 2, "room": 3}[self.geometry]
        if len(self.surfaces) != expected:
            raise ValueError(
                f"geometry {self.geometry} should have {expected} surfaces, "
                f"not {len(self.surfaces)} ({', '.join(self.surfaces)})"
            )
        if self.views is not None and self.geometry != "room":
            raise ValueError(
                f"views should be null with geometry {self.geometry}, not {self.views}: only a "
                "room is seen by an array of views"
            )
        if self.occluders and self.geometry == "room":
            raise ValueError("occluders should be empty with geometry room, which has its own")
        return self


class CameraConfig(_Settings):
    """The simulated camera [App. B]; radiance is in units of the coaxial transport matrix."""

    exposures: tuple[Exposure, ...] = Field(
        (1 / 64, 1 / 16, 1 / 4, 1.0),
        min_length=1,
        description="Exposure times of a bracket in seconds, ascending, above 0 and at most 60.",
    )
    electrons_per_radiance: float = Field(
        640_000.0,
        gt=0,
        description="Photo-electrons a second for a radiance of 1, above 0. The default fills "
        "the full well at radiance 2 in 1/64 s.",
    )
    full_well_electrons: float = Field(
        20_000.0, gt=0, description="Electrons at which a pixel saturates, above 0."
    )
    read_noise_electrons: float = Field(
        5.0, ge=0, description="Standard deviation of the read noise in electrons, at least 0."
    )
    dark_current_electrons: float = Field(
        1.0, ge=0, description="Dark current in electrons a second, at least 0."
    )
    black_level_counts: int = Field(
        64, ge=0, description="Counts of a pixel without light; at least 0 and below full scale."
    )
    bits: int = Field(
        12, ge=8, le=16, description="Bits of the analogue-to-digital converter, 8 to 16."
    )
    psf_sigma: float = Field(
        0.0,
        ge=0,
        le=10,
        description="Standard deviation of the lens blur in pixels, 0 (none) to 10.",
    )
    vignetting: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Fraction of the light lost in the image's corners, from 0 (none) to below 1.",
    )
    flare: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Fraction of the light that the lens spreads evenly over the image, from 0 "
        "(none) to below 1.",
    )
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = Field(
        None,
        description="Colour mosaic of the sensor, or null for three full channels: RGGB, BGGR, "
        "GRBG or GBRG.",
    )
    response_gamma: float = Field(
        1.0,
        gt=0,
        le=5,
        description="Exponent g of the response, counts ~ electrons^(1/g): above 0 and at most "
        "5; 1 is a linear camera.",
    )

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if any(a >= b for a, b in zip(self.exposures, self.exposures[1:], strict=False)):
            raise ValueError(f"exposures should ascend without repeats, not {self.exposures}")
        if self.black_level_counts >= 2**self.bits - 1:
            raise ValueError(
                f"black_level_counts should be below full scale, {2**self.bits - 1} at "
                f"{self.bits} bits, not {self.black_level_counts}"
            )
        return self


class AcquisitionConfig(_Settings):
    """When a method stops subdividing."""

    tolerance: Tolerance = Field(
        1e-3,
        description="Error allowed in a stored block, as a fraction of the floodlit image's "
        "maximum, between 0 and 1.",
    )
    noise_significance: float = Field(
        3.0,
        ge=0,
        le=100,
        description="Light counts as measured above this many standard deviations of its noise, "
        "0 to 100.",
    )
    subtract_stored: bool = Field(
        False,
        description="Dual photography: take the light stored at coarser levels off finer images, "
        "true or false. The thesis [C.1] doesn't, and counts some of it twice.",
    )


class CaptureConfig(_Settings):
    """How patterns are shown and pictures taken."""

    rig: Literal["simulated"] = Field("simulated", description="The rig: simulated.")
    seconds_per_pattern: float = Field(
        2.0,
        gt=0,
        le=3600,
        description="Time that a real rig takes for a pattern's bracket, in seconds, above 0 and "
        "at most 3600; the simulation doesn't wait, reports count with it.",
    )
    black_frames: int = Field(
        8, ge=1, le=1024, description="Brackets of the all-off pattern, averaged: 1 to 1024."
    )
    floodlit_frames: int = Field(
        64,
        ge=1,
        le=1024,
        description="Brackets of the all-on pattern, averaged: 1 to 1024. A level's images are "
        "scaled to them, so that they set the noise of the direct light.",
    )
    batch_patterns: int = Field(
        16, ge=1, le=1024, description="Patterns captured and stored at a time, 1 to 1024."
    )
    keep_raw: bool = Field(
        True,
        description="Whether a level's raw exposures stay after their merge: true or false. "
        "Without them, other merge settings mean to capture again.",
    )
    when_patterns_change: Literal["recapture", "refuse"] = Field(
        "recapture",
        description="What to do with a level's pictures when a changed setting changes its "
        "patterns: recapture (it says so first) or refuse.",
    )


class MergeConfig(_Settings):
    """How a bracket becomes a radiance image."""

    saturation_fraction: float = Field(
        0.98,
        gt=0,
        le=1,
        description="Counts at or above this fraction of full scale are saturated and not used, "
        "above 0 and at most 1.",
    )
    repair_defects: bool = Field(
        True, description="Replace dead and hot pixels by their neighbours' median: true or false."
    )


class ResourcesConfig(_Settings):
    """What a job may use; none of it changes a result."""

    memory_gib: float = Field(
        4.0,
        ge=0.5,
        le=1024,
        description="Memory that a job may take, in GiB, 0.5 to 1024. As many jobs as there are "
        "cores run side by side.",
    )
    cluster: str | None = Field(
        None,
        pattern=r"^(tcp|tls|ucx)://\S+:\d+$",
        description="Address of a dask scheduler whose workers merge brackets, such as "
        "tcp://host:8786, or null to work here. They must see the results' folder under the same "
        "path.",
    )


class StorageConfig(_Settings):
    """How the transport is stored."""

    number_format: NumberFormat = Field(
        "uint8",
        description="Numbers of a stored transport: float32 keeps every bit; uint16 and uint8 "
        "round a leaf's factors, by about 1e-5 and 3e-3 of their values. uint8 takes a quarter of "
        "float32's bytes; uint16 is for tolerances below 1e-4 without noise.",
    )


class ReportConfig(_Settings):
    """What the report shows."""

    title: str = Field(
        "Light transport of four scenes", min_length=1, description="The report's title."
    )
    tolerances: tuple[Tolerance, ...] = Field(
        (1e-2, 3e-3, 1e-3, 3e-4),
        min_length=1,
        description="Tolerances of the plot of speed against error, as fractions of the floodlit "
        "image's maximum, between 0 and 1.",
    )
    resolutions: tuple[Extent, ...] = Field(
        (8, 16, 32, 64),
        min_length=1,
        description="Sides, in pixels, of the square domains in the plot of patterns against "
        "resolution [Fig. 3.8], 1 to 4096.",
    )


def _each_once(methods: tuple[MethodName, ...]) -> tuple[MethodName, ...]:
    if len(set(methods)) < len(methods):
        raise ValueError("should name each method once")
    return methods


def _thesis_scenes() -> dict[str, SceneConfig]:
    """Scenes I to IV of [Fig. 2.1], at a fifth of their size."""
    return {
        "planes_i": SceneConfig(geometry="plane", surfaces=("texture",)),
        "planes_ii": SceneConfig(geometry="wedge", surfaces=("white", "white")),
        "planes_iii": SceneConfig(geometry="wedge", surfaces=("white", "texture")),
        "planes_iv": SceneConfig(geometry="wedge", surfaces=("texture", "texture")),
    }


class Config(_Settings):
    """All settings of a run."""

    seed: int = Field(1, ge=0, description="Seed of the captures' noise, an integer of at least 0.")
    scenes: dict[SceneName, SceneConfig] = Field(
        default_factory=_thesis_scenes,
        min_length=1,
        description="The scenes by name: lower-case letters, digits and _. The default are "
        "scenes I to IV of Fig. 2.1.",
    )
    methods: tuple[MethodName, ...] = Field(
        ("symmetric", "dual"),
        min_length=1,
        description="Methods to acquire each scene with: brute_force, dual, symmetric.",
    )
    acquisition: AcquisitionConfig = Field(
        default_factory=AcquisitionConfig, description="When a method stops subdividing."
    )
    camera: CameraConfig | None = Field(
        default_factory=CameraConfig,
        description="The simulated camera, or null for exact radiance.",
    )
    capture: CaptureConfig = Field(
        default_factory=CaptureConfig, description="How patterns are shown and pictures taken."
    )
    merge: MergeConfig = Field(
        default_factory=MergeConfig, description="How a bracket becomes a radiance image."
    )
    normalization: Normalization = Field(
        "per_channel",
        description="Scaling of a level's images to add up to the floodlit image [B.2]: none, "
        "per_channel, or total_energy (the thesis' own: the floodlit image's colour in proportion "
        "to each image's energy, for the colours that a mosaic loses).",
    )
    storage: StorageConfig = Field(
        default_factory=StorageConfig, description="How the transport is stored."
    )
    resources: ResourcesConfig = Field(
        default_factory=ResourcesConfig, description="What a job may use; no result depends on it."
    )
    report: ReportConfig = Field(default_factory=ReportConfig, description="What the report shows.")

    def methods_of(self, scene: str) -> tuple[MethodName, ...]:
        """Methods to acquire a scene with: its own, or those of the run."""
        return self.scenes[scene].methods or self.methods

    def tolerance_of(self, scene: str) -> float:
        """Tolerance to acquire a scene with: its own, or that of the run."""
        return self.scenes[scene].tolerance or self.acquisition.tolerance

    @property
    def acquisitions(self) -> list[tuple[str, MethodName]]:
        """Scene and method of every acquisition."""
        return [(scene, method) for scene in self.scenes for method in self.methods_of(scene)]

    @field_validator("methods", mode="after")
    @classmethod
    def _no_method_twice(cls, methods: tuple[MethodName, ...]) -> tuple[MethodName, ...]:
        return _each_once(methods)

    @model_validator(mode="after")
    def _mosaic_has_colour(self) -> Self:
        if self.camera is not None and self.camera.bayer is not None:
            for name, scene in self.scenes.items():
                if scene.channels != 3:
                    raise ValueError(
                        f"camera.bayer {self.camera.bayer} needs scenes of 3 channels, but "
                        f"scenes.{name}.channels is {scene.channels}; set it to 3, or bayer to null"
                    )
        return self
