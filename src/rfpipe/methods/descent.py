"""Forecast of the methods that go down a block tree, from their tolerance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.base import Forecast, Method, S, check_rays

_LARGEST_RATIO = 7.0
"""Largest number of patterns over the expected one, in all acquisitions of the benchmark."""

_QUARTILES = 0.7, 1.3
"""Numbers of patterns over the expected one between which half of the tuning acquisitions are."""


class BlockTreeMethod(Method[S]):
    """A method that goes down the projector's block tree, from the floodlit root to its rays.

    Attributes
    ----------
    level_patterns, power : float
        Expected patterns for each level and projector view at a tolerance of 1 %, and the power of
        1 / tolerance by which they grow. Chosen on the tuning scenes of ``docs/benchmark.md``.
    """

    trades = "tolerance"
    level_patterns: ClassVar[float]
    power: ClassVar[float]

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> Forecast:
        """Forecast the patterns from the tolerance and the levels of the block tree."""
        check_rays(self, camera, projector)
        tree = BlockTree(projector)
        of_level = self.level_patterns * (0.01 / options.tolerance) ** self.power
        typical = max(1.0, projector.views * tree.n_levels * of_level)
        blocks = sum(tree.n_blocks(level) for level in range(tree.n_levels))
        patterns = min(round(typical), projector.size)
        max_patterns = max(patterns, min(round(_LARGEST_RATIO * typical), blocks))
        lower, upper = (min(round(ratio * typical), max_patterns) for ratio in _QUARTILES)
        forecast = self.forecast_of(camera, channels, patterns, max_patterns)
        return replace(forecast, quartiles=(lower, upper))
