"""Positions and lenses of the cameras and projectors of a physically based scene.

`rfpipe.scenes.lenses` has the equation of a lens.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Self

from pydantic import Field, model_validator

from rfpipe.config.base import Settings
from rfpipe.errors import InputError
from rfpipe.scenes.lenses import Lens
from rfpipe.scenes.pinholes import Pinhole


class View(Settings):
    """Position, orientation and lens of a camera or projector."""

    origin: tuple[float, float, float] = Field(description="Position in scene units.")
    target: tuple[float, float, float] = Field(
        description="Point on its optical axis, in scene units."
    )
    up: tuple[float, float, float] = Field(
        (0.0, 1.0, 0.0), description="Direction that is up in its picture."
    )
    degrees: float = Field(40.0, gt=0, lt=180, description="Horizontal field of view in degrees.")
    aperture: float = Field(
        0.0, ge=0, description="Diameter of its lens in scene units; 0: a pinhole, all in focus."
    )
    focus: float | None = Field(
        None,
        gt=0,
        description="Distance in focus along the optical axis, in scene units; null: that of "
        "`target`.",
    )

    @property
    def lens(self) -> Lens:
        """The lens, in focus at `target` unless `focus` is set."""
        return Lens(self.aperture, self.focus or math.dist(self.origin, self.target))

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

    Attributes
    ----------
    pinholes : tuple of Pinhole
    lenses : tuple of Lens
        A lens for each pinhole, whose position is the middle of the lens; empty without lenses.

    Raises
    ------
    InputError
        If there are none, or if their pixels differ in number or size.
    """

    pinholes: tuple[Pinhole, ...]
    lenses: tuple[Lens, ...] = ()

    @classmethod
    def of(cls, views: tuple[View, ...], shape: tuple[int, int]) -> Self:
        """Build the side of these views, each with a picture of this height and width."""
        lenses = tuple(view.lens for view in views)
        has_lenses = any(lens.aperture for lens in lenses)
        return cls(tuple(view.pinhole(shape) for view in views), lenses if has_lenses else ())

    def __post_init__(self) -> None:
        if len({(pinhole.shape, pinhole.pitch) for pinhole in self.pinholes}) != 1:
            raise InputError(
                f"{len(self.pinholes)} views of one side of a rig: expected at least one, and all "
                "of the same field of view"
            )

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints."""
        described = asdict(self)
        if not self.lenses:
            del described["lenses"]
        return described

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
