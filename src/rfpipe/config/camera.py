"""The settings of the simulated camera."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, model_validator

from rfpipe.config.base import Gamma, Settings, Share

Exposure = Annotated[float, Field(gt=0, le=60)]


class CameraConfig(Settings):
    """The simulated camera [App. B]; radiance is in units of the coaxial transport matrix."""

    exposures: tuple[Exposure, ...] = Field(
        (1 / 64, 1 / 16, 1 / 4, 1.0),
        min_length=1,
        description="Exposure times of a bracket in seconds, ascending, above 0 and at most 60.",
    )
    electrons_per_radiance: PositiveFloat = Field(
        640_000.0,
        description="Photo-electrons a second for a radiance of 1, above 0.",
    )
    full_well_electrons: PositiveFloat = Field(
        20_000.0, description="Electrons at which a pixel saturates, above 0."
    )
    read_noise_electrons: NonNegativeFloat = Field(
        5.0, description="Standard deviation of the read noise in electrons, at least 0."
    )
    dark_current_electrons: NonNegativeFloat = Field(
        1.0, description="Dark current in electrons a second, at least 0."
    )
    black_level_counts: NonNegativeInt = Field(
        64, description="Counts of a pixel without light; at least 0 and below full scale."
    )
    bits: int = Field(
        12, ge=1, le=16, description="Bits of the analogue-to-digital converter, 1 to 16."
    )
    psf_sigma: float = Field(
        0.0,
        ge=0,
        le=10,
        description="Standard deviation of the lens blur in pixels, 0 (none) to 10.",
    )
    vignetting: Share = Field(
        0.0,
        description="Fraction of the light lost in the image's corners, from 0 (none) to below 1.",
    )
    flare: Share = Field(
        0.0,
        description="Fraction of the light that the lens spreads over the image, 0 to below 1.",
    )
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = Field(
        None,
        description="Colour mosaic: RGGB, BGGR, GRBG, GBRG, or null for three full channels.",
    )
    response_gamma: Gamma = Field(
        1.0,
        description="Exponent g of the response, counts ~ electrons^(1/g), above 0, at most 5.",
    )
    white_level_counts: int | None = Field(
        None,
        ge=1,
        description="Counts at which the sensor saturates; null: full scale.",
    )

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if any(a >= b for a, b in zip(self.exposures, self.exposures[1:], strict=False)):
            raise ValueError(f"exposures is {self.exposures}; it should ascend without repeats")
        white = self.white_level_counts
        if white is not None and not self.black_level_counts < white < 2**self.bits:
            raise ValueError(
                f"white_level_counts is {white}; it should be above black_level_counts, "
                f"{self.black_level_counts}, and at most {2**self.bits - 1} at {self.bits} bits"
            )
        if self.black_level_counts >= 2**self.bits - 1:
            raise ValueError(
                f"black_level_counts is {self.black_level_counts}; it should be below full scale, "
                f"{2**self.bits - 1} at {self.bits} bits"
            )
        return self
