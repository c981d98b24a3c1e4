"""Number of patterns of an adaptive acquisition: expected, largest, and remaining.

Before the first picture only the target error and the projector are known. The expected number is
the median of the benchmark's tuning scenes (`expected_patterns`); the largest number is that of all
rounds and of a complete hierarchy (`most_patterns`).

The estimated errors of two rounds show how fast errors fall on the scene at hand. With the errors
``e_0`` and ``e_1`` after ``n_0`` and ``n_1`` patterns, a target ``t`` takes (`patterns_to_target`)

    n = n_1 (e_1 / t)^(1 / p),    p = log(e_0 / e_1) / log(n_1 / n_0)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.adaptive.state import AdaptiveState
from rfpipe.methods.base import ErrorOptions
from rfpipe.methods.error_estimate import HELD_OUT

EXPECTED_PATTERNS, EXPECTED_POWER = 33.0, 0.8
"""Patterns of a projector view for an error of 1 %, and the power of 1 / error by which they grow.

They do not depend on the number of rays or the light. On the benchmark's tuning scenes 55 % of the
acquisitions took 0.67 to 1.5 times as many, one in ten more than 7 times; on its test scenes, with
glass, mirrors and gloss among them, 19 % did, and half of them took 4 to 11 times as many.
"""

SLOWEST_POWER = 0.25
"""Errors fall with a power of the number of patterns. Below this power more patterns hardly help:
half the error would take sixteen times as many."""

INDIRECT_RATIO = 6.0
"""Typical error of indirect light over the total error."""

# Largest number of patterns of a hierarchy, over the number that its `HierarchyCost` expects.
_HIERARCHY_MARGIN = 4.0


@dataclass(frozen=True)
class HierarchyCost:
    """Cost and accuracy of the hierarchy: symmetric or dual photography, down the block tree.

    Attributes
    ----------
    patterns, power : float
        Patterns per level of the block tree for an error of 1 %, and the power of 1 / error by
        which they grow.
    tolerance : float
        The hierarchy's tolerance, relative to the target error.
    """

    patterns: float
    power: float
    tolerance: float

    def expected_patterns(self, projector: RayDomain, target: float) -> float:
        """Compute the expected number of patterns for a total error."""
        depth = BlockTree(projector).n_levels
        return float(self.patterns * depth * (0.01 / target) ** self.power)

    def most_patterns(self, projector: RayDomain, target: float) -> int:
        """Bound the number of patterns below the floodlit one.

        A hierarchy shows each block of each level at most once, and hardly more than 4 times the
        expected number of patterns.
        """
        tree = BlockTree(projector)
        blocks = sum(tree.n_blocks(level) for level in range(1, tree.n_levels))
        return min(blocks, round(_HIERARCHY_MARGIN * self.expected_patterns(projector, target)))


def target_of(options: ErrorOptions) -> float:
    """Compute the total error that meets both targets, of all light and of indirect light."""
    indirect = options.target_indirect or np.inf
    return float(min(options.target_error, indirect / INDIRECT_RATIO))


def expected_patterns(views: int, target: float) -> float:
    """Compute the expected number of patterns for a total error, before any picture is taken."""
    return float(views * EXPECTED_PATTERNS * (0.01 / target) ** EXPECTED_POWER)


def most_patterns(
    projector: RayDomain, random_patterns: int, cost: HierarchyCost, options: ErrorOptions
) -> int:
    """Bound the number of patterns of all phases.

    Parameters
    ----------
    projector : RayDomain
    random_patterns : int
        Largest number of random patterns of all rounds.
    cost : HierarchyCost
        Cost of the hierarchy that may follow.
    options : ErrorOptions
    """
    hierarchy = cost.most_patterns(projector, target_of(options))
    total = 1 + len(HELD_OUT) + random_patterns + hierarchy
    return min(total, options.patterns or total)


def patterns_to_target(state: AdaptiveState) -> float:
    """Extrapolate the number of patterns that the target still takes.

    The power law goes through the last round and the one two rounds before, or the one before if
    there are only two rounds. The number is infinite if errors hardly fall, and 0 after a single
    round or if the target is met.
    """
    excess = state.excess[-3:]
    if len(excess) < 2 or excess[-1] <= 1:
        return 0.0
    level_patterns = [row["patterns"] for row in state.rows]
    before = state.patterns_shown - sum(level_patterns[1 - len(excess) :])
    power = np.log(excess[0] / excess[-1]) / np.log(state.patterns_shown / before)
    if power < SLOWEST_POWER:
        return np.inf
    return float(state.patterns_shown * (excess[-1] ** (1 / power) - 1))
