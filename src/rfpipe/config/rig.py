"""The settings of what is acquired, and with what: scenes, and the simulated camera."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from rfpipe.config.base import Extent, MethodSettings, SectionsOf, Settings
from rfpipe.config.sections import no_list

__all__ = ["CameraConfig", "OccluderConfig", "SceneConfig", "Surface"]

Surface = Literal["white", "texture"]
GeometryName = Literal[
    "plane",
    "wedge",
    "wedge_30",
    "wedge_120",
    "tilted_wedge",
    "corner",
    "sphere_on_plane",
    "room",
    "captured",
]
Exposure = Annotated[float, Field(gt=0, le=60)]
ViewCount = Annotated[int, Field(ge=1, le=16)]
SpanDegrees = Annotated[float, Field(ge=0, le=45)]
Vector = tuple[float, float, float]


_SURFACES: dict[GeometryName, int] = {
    "plane": 1,
    "wedge": 2,
    "wedge_30": 2,
    "wedge_120": 2,
    "tilted_wedge": 2,
    "corner": 3,
    "sphere_on_plane": 3,
    "room": 3,
    "captured": 0,
}


class OccluderConfig(Settings):
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


class SceneConfig(Settings):
    """A scene: a simulated one seen by a coaxial rig, or one before a real rig."""

    geometry: GeometryName = Field(
        description="plane: one plane across the line of sight; wedge: two planes that meet at "
        "right angles in a concave edge, farthest from the camera; wedge_30, wedge_120: the same "
        "at 30 and 120 degrees; tilted_wedge: a wedge whose edge is neither upright nor across "
        "the line of sight; corner: three planes at right angles, seen along the diagonal; "
        "sphere_on_plane: a sphere on a floor before a wall; room: the corner of a room with a "
        "box, a poster and a card in it; captured: a real scene, without ground truth."
    )
    surfaces: tuple[Surface, ...] = Field(
        (),
        max_length=3,
        description="Albedo of each surface: one for a plane, left and right for a wedge, left, "
        "right and floor for a corner, floor, wall and sphere for a sphere_on_plane, left wall, "
        "right wall and floor for a room. white: albedo 0.8; texture: text-like strokes of "
        "albedo 0.15 and 0.85. A room's surfaces are tinted, too; a "
        "captured scene has none here.",
    )
    shape: tuple[Extent, Extent] = Field(
        (62, 70),
        description="Rays of the rig, or of each of its views: height and width in pixels, 1 to "
        "4096 each.",
    )
    views: tuple[ViewCount, ViewCount] | None = Field(
        None,
        description="The rig of a room or a captured scene as a planar array of coaxial "
        "projectors and cameras, a light field [5.2]: rows and columns, 1 to 16 each; null for a "
        "single pair.",
    )
    camera_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the camera's rays of a captured scene whose rig is not "
        "coaxial, 1 to 4096 each; null where camera and projector share their rays.",
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
        description="Parallelograms that block light between surfaces; none in a room.",
    )
    seed: int = Field(0, ge=0, description="Seed of the texture's strokes, at least 0.")
    methods: Annotated[
        dict[str, dict[str, Any] | None] | None, SectionsOf(MethodSettings, partial=True)
    ] = Field(
        None,
        min_length=1,
        description="Methods to acquire this scene with, each with the options that differ from "
        "its section among the run's methods, such as {symmetric: {tolerance: 2.0e-3}}; null for "
        "all methods of the run as they are.",
    )
    sweep: bool = Field(
        True,
        description="Whether to acquire the scene again with other options, for the plot of speed "
        "against error: true or false.",
    )

    @property
    def ray_shape(self) -> tuple[int, ...]:
        """Shape of the ray domain: (H, W), or (V, H, W) for an array of views."""
        return self.shape if self.views is None else (math.prod(self.views), *self.shape)

    @property
    def camera_ray_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain, the same as `ray_shape` for a coaxial rig."""
        return self.ray_shape if self.camera_shape is None else self.camera_shape

    @property
    def is_captured(self) -> bool:
        """Whether it is a real scene, without ground truth."""
        return self.geometry == "captured"

    @property
    def is_swept(self) -> bool:
        """Whether it is acquired at several tolerances; a real one isn't."""
        return self.sweep and not self.is_captured

    @field_validator("methods", mode="before")
    @classmethod
    def _have_sections(cls, methods: object) -> object:
        return no_list(methods)

    @model_validator(mode="after")
    def _fits_the_geometry(self) -> Self:
        expected = _SURFACES[self.geometry]
        if len(self.surfaces) != expected:
            raise ValueError(
                f"geometry {self.geometry} should have {expected} surfaces, "
                f"not {len(self.surfaces)} ({', '.join(self.surfaces)})"
            )
        if self.views is not None and self.geometry not in ("room", "captured"):
            raise ValueError(
                f"views should be null with geometry {self.geometry}, not {self.views}: only a "
                "room is seen by an array of views"
            )
        if self.camera_shape is not None and not self.is_captured:
            raise ValueError(
                f"camera_shape should be null with geometry {self.geometry}, not "
                f"{self.camera_shape}: simulated scenes have coaxial rigs"
            )
        if self.occluders and self.geometry == "room":
            raise ValueError("occluders should be empty with geometry room, which has its own")
        if self.occluders and self.is_captured:
            raise ValueError("occluders should be empty with geometry captured")
        return self


class CameraConfig(Settings):
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
