"""The settings of the simulated camera."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, NonNegativeInt, model_validator

from rfpipe.config.base import Gamma, Settings, Share, setting

Exposure = Annotated[float, Field(gt=0, le=60)]


class CameraConfig(Settings):
    """The simulated camera [App. B]; radiance is in units of the coaxial transport matrix."""

    exposures: tuple[Exposure, ...] = setting(
        (1 / 64, 1 / 16, 1 / 4, 1.0),
        "Exposure times of a bracket in seconds, ascending, above 0 and at most 60.",
        min_length=1,
    )
    electrons_per_radiance: float = setting(
        640_000.0, "Photo-electrons a second for a radiance of 1.", gt=0
    )
    full_well_electrons: float = setting(20_000.0, "Electrons at which a pixel saturates.", gt=0)
    read_noise_electrons: float = setting(
        5.0, "Standard deviation of the read noise in electrons.", ge=0
    )
    dark_current_electrons: float = setting(1.0, "Dark current in electrons a second.", ge=0)
    black_level_counts: NonNegativeInt = setting(
        64, "Counts of a pixel without light; at least 0 and below full scale."
    )
    bits: int = setting(12, "Bits of the analogue-to-digital converter.", ge=1, le=16)
    psf_sigma: float = setting(0.0, "Standard deviation of the lens blur in pixels.", ge=0, le=10)
    vignetting: Share = setting(0.0, "Share of light lost in the image's corners, below 1.")
    flare: Share = setting(0.0, "Share of light that the lens spreads over the image, below 1.")
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = setting(
        None, "Colour mosaic: RGGB, BGGR, GRBG, GBRG, or null for three full channels."
    )
    response_gamma: Gamma = setting(
        1.0, "Exponent g of the response, counts ~ electrons^(1/g), above 0, at most 5."
    )
    white_level_counts: int | None = setting(
        None, "Counts at which the sensor saturates; null: full scale.", ge=1
    )

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if any(a >= b for a, b in zip(self.exposures, self.exposures[1:], strict=False)):
            raise ValueError(f"exposures is {self.exposures}; it should ascend without repeats")
        black, full = self.black_level_counts, 2**self.bits - 1
        white = full if self.white_level_counts is None else self.white_level_counts
        if not black < white <= full:
            raise ValueError(
                f"black_level_counts is {black}; it should be below white_level_counts, {white}, "
                f"which is at most full scale, {full} at {self.bits} bits"
            )
        return self
