"""The settings of a rig's calibration."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from rfpipe.config.base import Corners, Fraction, Settings, ViewCount

Count = Annotated[int, Field(ge=2, le=1000)]


class CalibrationConfig(Settings):
    """How a rig is calibrated: what is shown and taken, and how good the rig is to be."""

    tolerance: Fraction = Field(
        0.02,
        description="Error of a relit picture that verdicts allow, a fraction above 0, below 1.",
    )
    coaxial: bool = Field(
        True,
        description="Whether camera and projector share their rays; symmetry is then checked.",
    )
    dark_frames: Count = Field(8, description="Brackets of the all-off picture, 2 to 1000.")
    levels: Count = Field(
        8, description="Flat pictures of the photon-transfer curve, from dark to bright, 2 to 1000."
    )
    repeats: Count = Field(
        2, description="Brackets of each of them, taken in pairs, 2 to 1000; an even number."
    )
    codes: int = Field(
        33, ge=5, le=256, description="Codes at which the projector's light is measured, 5 to 256."
    )
    period_pixels: int = Field(
        16,
        ge=8,
        le=1024,
        multiple_of=4,
        description="Period of the stripes in projector pixels, a multiple of 4, 8 to 1024.",
    )
    phase_steps: int = Field(
        6, ge=3, le=64, description="Pictures of stripes an axis, 3 to 64, beside the Gray code."
    )
    views: tuple[ViewCount, ViewCount] | None = Field(
        None,
        description="Rows and columns of an array of views, 1 to 16 each; null: a single one.",
    )
    corners: Corners | None = Field(
        None,
        description="Corners of each view in projector pixels, from the upper left one clockwise; "
        "null: measured, or the middle of the projector.",
    )
    symmetry_patterns: Count = Field(
        12,
        ge=3,
        description="Random patterns of each size that symmetry is checked with, 3 to 1000.",
    )

    @model_validator(mode="after")
    def _pairs_and_views(self) -> Self:
        if self.repeats % 2:
            raise ValueError(f"repeats should be even, not {self.repeats}: they are taken in pairs")
        if self.corners is not None and self.views is not None:
            count = self.views[0] * self.views[1]
            if len(self.corners) != count:
                raise ValueError(
                    f"corners should name four points for each of {count} views, not for "
                    f"{len(self.corners)}"
                )
        return self
