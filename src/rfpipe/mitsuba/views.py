"""Positions of the cameras and projectors of a physically based scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from pydantic import Field, model_validator

from rfpipe.config.base import Settings
from rfpipe.errors import InputError
from rfpipe.scenes.pinholes import Pinhole


class View(Settings):
    """Position and orientation of a pinhole camera or projector."""

    origin: tuple[float, float, float] = Field(description="Position in scene units.")
    target: tuple[float, float, float] = Field(
        description="Point on its optical axis, in scene units."
    )
    up: tuple[float, float, float] = Field(
        (0.0, 1.0, 0.0), description="Direction that is up in its picture."
    )
    degrees: float = Field(40.0, gt=0, lt=180, description="Horizontal field of view in degrees.")

    def pinhole(self, shape: tuple[int, int]) -> Pinhole:
        """Build the pinhole with a picture of this height and width in pixels."""
        width = 2 * math.tan(math.radians(self.degrees) / 2)
        return Pinhole(shape, self.origin, self.target, self.up, width)

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        self.pinhole((1, 1))
        return self


@dataclass(frozen=True)
class Side:
    """The pinholes of all cameras, or of all projectors, of a rig.

    Raises
    ------
    InputError
        If there are none, or if their pixels differ in number or size.
    """

    pinholes: tuple[Pinhole, ...]

    def __post_init__(self) -> None:
        if len({(pinhole.shape, pinhole.pitch) for pinhole in self.pinholes}) != 1:
            raise InputError(
                f"{len(self.pinholes)} views of one side of a rig: expected at least one, and all "
                "of the same field of view"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of each view in pixels."""
        return self.pinholes[0].shape

    @property
    def pitch(self) -> float:
        """Width of a pixel on the image plane at distance 1."""
        return self.pinholes[0].pitch

    @property
    def rays(self) -> int:
        """Number of rays of all views."""
        return len(self.pinholes) * math.prod(self.shape)

    @property
    def domain(self) -> tuple[int, ...]:
        """Shape of the ray domain: (H, W) of a single view, else (V, H, W)."""
        count = len(self.pinholes)
        return self.shape if count == 1 else (count, *self.shape)
