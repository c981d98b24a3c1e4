"""Quantities and rules by which an adaptive acquisition continues, changes its phase, or ends.

Each method decides after each round, see `rfpipe.methods.near_far.method` and
`rfpipe.methods.footprints.method`. The numbers here were chosen on the benchmark's tuning scenes;
`benchmarks/methods/thresholds.py` measures the effect of changing each of them. Methods are
developed with the tuning scenes alone, and evaluated on the benchmark's test scenes last
(``docs/benchmark.md``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.adaptive.state import AdaptiveState, Phase
from rfpipe.methods.base import ErrorOptions

STALLED = 0.85
"""A round has stalled if it leaves more than this share of the error before it."""

SLOWEST_POWER = 0.25
"""Errors fall with a power of the number of patterns. Below this power more patterns hardly help:
half the error would take sixteen times as many."""

LEAST_PATTERNS, LEAST_SHARE = 6, 0.1
"""Least number of patterns of a round, and least share of all patterns before it."""

EXTRAPOLATION_MARGIN = 1.1
"""Patterns of a round, over the number that extrapolation of the errors gives."""

INDIRECT_RATIO = 6.0
"""Typical error of indirect light over the total error."""

NEARLY = 1.2
"""An error of at most this many times 95 % of the target isn't given up for a hierarchy, which
starts from the floodlit picture alone. On fields of 9 x 12 x 16 rays, 680 patterns of dual
photography reduced no such error."""

MOSTLY_NOISE = 1.5
"""An error of at most this many times the noise of the floodlit image is mostly that noise."""

EXPECTED_PATTERNS, EXPECTED_POWER = 33.0, 0.8
"""Patterns of a projector view for an error of 1 %, and the power of 1 / error by which they grow.

They do not depend on the number of rays or the light. On the benchmark's tuning scenes 55 % of the
acquisitions took 0.67 to 1.5 times as many, one in ten more than 7 times; on its test scenes, with
glass, mirrors and gloss among them, 19 % did, and half of them took 4 to 11 times as many.
"""

NOT_SUITABLE = "the model doesn't fit the light"
ALL_SHOWN = "all rounds are shown"
CLOSE = "the error is close to the target"
LIMIT_REACHED = "the largest number of patterns is reached"


class Decision(NamedTuple):
    """The phase of the next round, None to end, and the reason if it differs from the last."""

    phase: Phase | None
    reason: str = ""


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


def expected_patterns(views: int, target: float) -> float:
    """Compute the expected number of patterns for a total error, before any picture is taken."""
    return float(views * EXPECTED_PATTERNS * (0.01 / target) ** EXPECTED_POWER)


def target_of(options: ErrorOptions) -> float:
    """Compute the total error that meets both targets, of all light and of indirect light."""
    indirect = options.target_indirect or np.inf
    return float(min(options.target_error, indirect / INDIRECT_RATIO))


# --- progress


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


def next_pattern_count(state: AdaptiveState, largest_count: int) -> int:
    """Compute the number of patterns of the next round: about as many as the target lacks.

    It is at most `largest_count`, and a multiple of the number of views, which are lit in turn.
    """
    missing = patterns_to_target(state)
    if not missing:
        return largest_count
    least = max(LEAST_PATTERNS, round(LEAST_SHARE * state.patterns_shown))
    count = max(least, round(min(EXTRAPOLATION_MARGIN * missing, largest_count)))
    views = state.projector.views
    return min(largest_count, -(-count // views) * views)


def has_stalled(state: AdaptiveState) -> bool:
    """Test whether the last round, the third or later, reduced the error by less than 15 %."""
    errors = state.errors
    return len(errors) > 2 and errors[-1] > STALLED * errors[-2]


def is_mostly_noise(state: AdaptiveState) -> bool:
    """Test whether the error is at most 1.5 times the noise of the floodlit image."""
    assert state.floodlit is not None
    return state.errors[-1] <= MOSTLY_NOISE * state.floodlit.noise


def is_nearly_met(state: AdaptiveState) -> bool:
    """Test whether the error is at most 1.2 times 95 % of the target."""
    return state.excess[-1] <= NEARLY


def exceeds_hierarchy(state: AdaptiveState, cost: HierarchyCost) -> bool:
    """Test whether the target takes more patterns by further rounds than by a hierarchy."""
    target = target_of(state.options)
    return patterns_to_target(state) > cost.expected_patterns(state.projector, target)


def end(state: AdaptiveState) -> Decision | None:
    """Decide to end at the target or at the largest number of patterns; None to continue."""
    if state.meets_target:
        return Decision(None)
    if 0 < state.options.patterns <= state.patterns_shown:
        return Decision(None, LIMIT_REACHED)
    return None


def after_round_before_hierarchy(
    state: AdaptiveState, phase: Phase, cost: HierarchyCost, *, is_last: bool
) -> Decision:
    """Decide after a round of a phase that only the hierarchy can follow."""
    if not is_last and not exceeds_hierarchy(state, cost):
        return Decision(phase)
    if is_nearly_met(state):
        return Decision(None, CLOSE)
    if state.allows_hierarchy:
        return Decision(Phase.HIERARCHY, "more rounds would take more patterns")
    return Decision(None, ALL_SHOWN) if is_last else Decision(phase)


def after_hierarchy_residual_round(state: AdaptiveState, is_last: bool) -> Decision:
    """Decide after a round for the hierarchy's residual; only brute force would remain."""
    if is_last:
        return Decision(None, ALL_SHOWN)
    if patterns_to_target(state) > state.projector.size:
        return Decision(None, "more rounds would take more patterns than brute force")
    return Decision(Phase.HIERARCHY_RESIDUAL)
