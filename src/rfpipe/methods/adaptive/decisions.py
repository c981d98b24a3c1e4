"""Quantities and rules by which an adaptive acquisition continues, changes its phase, or ends.

Each method decides after each round, see `rfpipe.methods.near_far.method` and
`rfpipe.methods.footprints.method`. The numbers here were chosen on the benchmark's tuning scenes;
`benchmarks/methods/thresholds.py` measures the effect of changing each of them. Methods are
developed with the tuning scenes alone, and evaluated on the benchmark's test scenes last
(``docs/benchmark.md``).
"""

from __future__ import annotations

from typing import NamedTuple

from rfpipe.methods.adaptive.forecast import (
    error_power,
    hierarchy_patterns,
    most_hierarchy_patterns,
    patterns_to_target,
)
from rfpipe.methods.adaptive.state import AdaptiveState, Phase
from rfpipe.methods.multiplexed.method import largest_pattern_count

STALLED = 0.5
"""A round has stalled if the error falls by less than this power of the number of patterns: a round
of 40 % of the patterns before it then leaves more than 85 % of the error."""

LEAST_PATTERNS, LEAST_SHARE = 6, 0.1
"""Least number of patterns of a round, and least share of all patterns before it."""

EXTRAPOLATION_MARGIN = 1.1
"""Patterns of a round, over the number that extrapolation of the errors gives."""

NEARLY = 1.2
"""An error of at most this many times 95 % of the target isn't given up for a hierarchy, which
takes a round for each level and at least two of single rays."""

MOSTLY_NOISE = 1.5
"""An error of at most this many times the noise of the floodlit image is mostly that noise."""

NOT_SUITABLE = "the model doesn't fit the light"
NOT_SPARSE = "the light isn't sparse"
ALL_SHOWN = "all rounds are shown"
BRUTE_FORCE = "more rounds would take more patterns than brute force"
CLOSE = "the error is close to the target"
LIMIT_REACHED = "the largest number of patterns is reached"


class Decision(NamedTuple):
    """The phase of the next round, None to end, and the reason if it differs from the last."""

    phase: Phase | None
    reason: str = ""


# --- progress


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
    """Test whether the last round, the third or later, hardly reduced the error."""
    errors = state.errors
    return len(errors) > 2 and error_power(state, errors[-2:]) < STALLED


def is_mostly_noise(state: AdaptiveState) -> bool:
    """Test whether the error is at most 1.5 times the noise of the floodlit image."""
    assert state.floodlit is not None
    return state.errors[-1] <= MOSTLY_NOISE * state.floodlit.noise


def is_nearly_met(state: AdaptiveState) -> bool:
    """Test whether the error is at most 1.2 times 95 % of the target."""
    return state.excess[-1] <= NEARLY


def exceeds_hierarchy(state: AdaptiveState) -> bool:
    """Test whether the target takes more patterns by further rounds than by a hierarchy."""
    hierarchy = hierarchy_patterns(state.projector, state.options.total_target)
    return patterns_to_target(state) > hierarchy


def end(state: AdaptiveState) -> Decision | None:
    """Decide to end at the target or at the largest number of patterns; None to continue."""
    if state.meets_target:
        return Decision(None)
    if 0 < state.options.patterns <= state.patterns_shown:
        return Decision(None, LIMIT_REACHED)
    return None


def after_round_before_hierarchy(state: AdaptiveState, phase: Phase, *, is_last: bool) -> Decision:
    """Decide after a round of a phase that only the hierarchy can follow."""
    if not is_last and not exceeds_hierarchy(state):
        return Decision(phase)
    if is_nearly_met(state):
        return Decision(None, CLOSE)
    if state.allows_hierarchy:
        return Decision(Phase.HIERARCHY, "more rounds would take more patterns")
    return Decision(None, ALL_SHOWN) if is_last else Decision(phase)


def after_dense_round(state: AdaptiveState, *, is_last: bool) -> Decision:
    """Decide after a round for the residual that follows a hierarchy."""
    if is_last or state.patterns_shown >= largest_pattern_count(state.projector):
        return Decision(None, ALL_SHOWN)
    rounds = len(state.rows) - 1 - state.hierarchy_levels[-1]
    if rounds >= 3 and patterns_to_target(state) > state.projector.size:
        return Decision(None, BRUTE_FORCE)
    return Decision(Phase.DENSE)


def after_hierarchy_round(state: AdaptiveState, hierarchy_error: float) -> Decision:
    """Decide after a round of the hierarchy, whose own transport has an estimated error.

    Where light is sparse, the first round of single rays leaves less error than the model with its
    residual does, on `glass_and_ring` and `bottle` a seventh and a fifth, and further rounds reduce
    it. Otherwise rounds for the residual follow, which use all pictures.
    """
    inner = state.hierarchy_state
    assert inner is not None
    is_first_of_rays = len(state.hierarchy_levels) == len(inner.levels)
    if is_first_of_rays and hierarchy_error > state.errors[-1]:
        return Decision(Phase.DENSE, NOT_SPARSE)
    if inner.is_complete:
        return Decision(None, ALL_SHOWN)
    rays, target = state.projector.size, state.options.total_target
    # rounds of single rays follow those of the coarser levels; the first five have 74 patterns, and
    # after three, with 42, `venetian_blind` ended too early
    has_trend = len(state.hierarchy_levels) >= len(inner.levels) + 4
    is_slow = has_trend and patterns_to_target(state) > rays
    if is_slow and rays > most_hierarchy_patterns(state.projector, target):
        return Decision(Phase.DENSE, NOT_SPARSE)
    return Decision(Phase.HIERARCHY)
