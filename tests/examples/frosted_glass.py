"""A user-defined scene in one file: a white wall behind frosted glass.

The glass blurs light on its way to the wall and back by a Gaussian, so that each projector ray
lights several pixels.
"""

from typing import Any

import numpy as np
from pydantic import Field

from rfpipe.config import SceneSettings
from rfpipe.scenes import CoaxialScene, apply_in_batches


class GlassOptions(SceneSettings):
    """Options of the glass, besides the kind, shape, channels and methods of every scene."""

    blur: float = Field(1.0, gt=0, le=100, description="Standard deviation in pixels, 0 to 100.")
    albedo: float = Field(0.8, ge=0, lt=1, description="Albedo of the wall, 0 to below 1.")


class FrostedGlass(CoaxialScene):
    """A white wall behind frosted glass."""

    Options = GlassOptions

    def __init__(self, options: GlassOptions) -> None:
        super().__init__(options.shape, options.channels)
        self.options = options
        places = (np.arange(length) for length in self.shape)
        spread = [np.exp(-(((x[:, None] - x) / options.blur) ** 2) / 2) for x in places]
        self._down, self._across = (kernel / kernel.sum(axis=1).max() for kernel in spread)

    def apply(self, patterns):
        return apply_in_batches(self._radiance, patterns, self.shape, self.channels)

    def _radiance(self, weights):
        """Return radiance (N, B, C) of patterns (N, B), for a fixed batch size B."""
        lit = weights.reshape(*self.shape, -1)
        blurred = self.options.albedo * np.einsum("ij,jlb,kl->ikb", self._down, lit, self._across)
        return np.repeat(blurred.reshape(*weights.shape, 1), self.channels, axis=2)

    def describe(self) -> dict[str, Any]:
        return {"scene": "frosted glass", **self.options.options()}
