"""What methods share that go down a block tree."""

from __future__ import annotations

from typing import Any, ClassVar

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.base import State
from rfpipe.methods.states import PackingMethod


class Descent(PackingMethod[State]):
    """A method that goes down the projector's block tree, from the floodlit root to its rays.

    `thesis_patterns` are those of a scene of the thesis at 310 x 350 rays, in ten levels.
    """

    trades = "tolerance"
    thesis_patterns: ClassVar[int]

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the depth of the block tree."""
        self.check(camera, projector)
        return BlockTree(projector).n_levels

    def asks(self, state: Any) -> bool:
        """Tell whether blocks are left to subdivide, without colouring them."""
        return state.level == 0 or len(state.frontier) > 0

    def expected_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Guess the patterns from those of the thesis' scene, so many a level."""
        levels = self.n_levels(camera, projector)
        return min(projector.size, round(levels * self.thesis_patterns / 10))
