"""Settings of the simulated camera."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, NonNegativeInt, model_validator

from rfpipe.config.base import Gamma, Settings, Share

Exposure = Annotated[float, Field(gt=0, le=60)]


class CameraConfig(Settings):
    """The simulated camera [App. B]; radiance is in units of the coaxial transport matrix."""

    exposures: tuple[Exposure, ...] = Field(
        (1 / 64, 1 / 16, 1 / 4, 1.0),
        description="Exposure times of a bracket in seconds, ascending.",
        min_length=1,
    )
    electrons_per_radiance: float = Field(
        640_000.0, description="Photo-electrons per second at a radiance of 1.", gt=0
    )
    full_well_electrons: float = Field(
        20_000.0, description="Electrons at which a pixel saturates.", gt=0
    )
    read_noise_electrons: float = Field(
        5.0, description="Standard deviation of the read noise in electrons.", ge=0
    )
    dark_current_electrons: float = Field(
        1.0, description="Dark current in electrons per second.", ge=0
    )
    black_level_counts: NonNegativeInt = Field(
        64, description="Counts of a pixel without light; must be below full scale."
    )
    bits: int = Field(12, description="Bits of the analogue-to-digital converter.", ge=1, le=16)
    psf_sigma: float = Field(
        0.0, description="Standard deviation of the lens blur in pixels.", ge=0, le=10
    )
    vignetting: Share = Field(
        0.0, description="Fraction of the light that is lost in the corners of the image."
    )
    flare: Share = Field(
        0.0, description="Fraction of the light that the lens scatters evenly over the image."
    )
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = Field(
        None, description="Colour mosaic of the sensor; null: three full channels."
    )
    response_gamma: Gamma = Field(
        1.0, description="Exponent g of the response, counts ~ electrons^(1/g)."
    )
    white_level_counts: int | None = Field(
        None, description="Counts at which the sensor saturates; null: full scale.", ge=1
    )

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if any(first >= second for first, second in pairwise(self.exposures)):
            raise ValueError(f"exposures is {self.exposures}; it should ascend without repeats")
        black, full = self.black_level_counts, 2**self.bits - 1
        white = full if self.white_level_counts is None else self.white_level_counts
        if not black < white <= full:
            raise ValueError(
                f"black_level_counts is {black}; it should be below white_level_counts, {white}, "
                f"which is at most full scale, {full} at {self.bits} bits"
            )
        return self
