"""Forecast of the methods that go down a block tree, from the thesis' numbers of patterns."""

from __future__ import annotations

from typing import Any, ClassVar

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.base import Forecast, Method, S, check_rays


class BlockTreeMethod(Method[S]):
    """A method that goes down the projector's block tree, from the floodlit root to its rays.

    Attributes
    ----------
    thesis_patterns : int
        Patterns of a scene of the thesis of 310 x 350 rays, in ten levels.
    """

    trades = "tolerance"
    thesis_patterns: ClassVar[int]

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> Forecast:
        """Forecast as many patterns per level as the thesis' scene took."""
        check_rays(self, camera, projector)
        levels = BlockTree(projector).n_levels
        patterns = min(projector.size, round(levels * self.thesis_patterns / 10))
        return self.forecast_of(camera, channels, patterns, patterns)
