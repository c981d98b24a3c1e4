"""The settings of a rig whose pictures are taken by hand or by another program."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from rfpipe.config.base import Extent, Gamma, Settings, Text
from rfpipe.config.calibration import Corners

__all__ = ["OfflineConfig"]


class OfflineConfig(Settings):
    """A rig whose pictures come and go as files, with capture.rig offline."""

    projector_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the pictures to show, the projector's in pixels, 1 to "
        "4096 each: each ray is a square of as many whole pixels as fit, in the middle. null: "
        "those of the calibration, or each pixel is a ray.",
    )
    projector_gamma: Gamma = Field(
        2.2,
        description="Exponent g of the projector, light ~ code^g, above 0 and at most 5; patterns "
        "of light and dark alone don't depend on it.",
    )
    picture_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the camera's pictures in pixels, 1 to 4096 each, where "
        "camera_corners are set; null where each pixel is a ray.",
    )
    camera_corners: Corners | None = Field(
        None,
        description="Where the rays lie in the camera's pictures, for each view: (x, y) of the "
        "upper left, upper right, lower right and lower left corner, in pixels from the picture's "
        "upper left corner. null: those of the calibration, or each pixel is a ray.",
    )
    calibration: Text | None = Field(
        None,
        description="Folder of a calibration that knows where rays lie on projector and camera, "
        "relative to where rfpipe runs, or null.",
    )

    @model_validator(mode="after")
    def _knows_the_picture(self) -> Self:
        if (self.picture_shape is None) != (self.camera_corners is None):
            raise ValueError(
                "picture_shape and camera_corners should be set together, or both be null"
            )
        return self
