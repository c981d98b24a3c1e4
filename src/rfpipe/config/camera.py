"""The settings of the simulated camera."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rfpipe.config.base import Settings

__all__ = ["CameraConfig"]

Exposure = Annotated[float, Field(gt=0, le=60)]


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
