"""Rounds of an adaptive acquisition: the largest number of patterns of each, and the next one."""

from __future__ import annotations

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.decisions import next_pattern_count
from rfpipe.methods.adaptive.state import AdaptiveState, Phase, Round
from rfpipe.methods.held_out import HELD_OUT, HELD_OUT_OF_PRIOR
from rfpipe.methods.multiplexed.blocks import block_levels

RESIDUAL_ROUNDS = (12, 20, 28, 40, 60, 88, 124, 170)
"""Largest number of patterns of each round for a residual: about 1.5 times that of the last."""

DENSE_ROUNDS = RESIDUAL_ROUNDS[3:7]
"""Largest number of patterns of each round for a residual after a hierarchy."""

HIERARCHY_RAY_ROUNDS = 24
"""Largest number of further rounds of single rays in a hierarchy: more than any has, since each
takes a third as many patterns as all before it."""

Rounds = dict[Phase, tuple[int, ...]]
"""Largest number of random patterns of each round, for each phase after the floodlit one."""


def hierarchy_rounds(projector: RayDomain) -> Rounds:
    """Return the rounds of a hierarchy, which chooses their patterns, after it, and of a prior."""
    return {
        Phase.HIERARCHY: (0,) * (len(block_levels(projector)) + HIERARCHY_RAY_ROUNDS),
        Phase.DENSE: DENSE_ROUNDS,
        # last, so that a prior doesn't change the random patterns of other phases
        Phase.PRIOR: (0,),
    }


def random_pattern_count(rounds: Rounds) -> int:
    """Sum up the largest numbers of random patterns of all rounds before a hierarchy."""
    return sum(sum(counts) for phase, counts in rounds.items() if phase is not Phase.DENSE)


def next_round(
    state: AdaptiveState, rounds: Rounds, phase: Phase, *, is_suitable: bool
) -> Round | None:
    """Return the next round of a phase; None if it has no patterns left.

    Parameters
    ----------
    state : AdaptiveState
        State after the round `state.next_round`, whose pictures are fitted.
    rounds : Rounds
    phase : Phase
    is_suitable : bool
        Whether the model fits the light, so that more patterns for it are useful.
    """
    shown = state.next_round
    assert shown is not None
    index = shown.index + 1 if phase is shown.phase else 0
    if index >= len(rounds[phase]):
        return None
    phases = list(rounds)
    before = sum(len(rounds[earlier]) for earlier in phases[: phases.index(phase)])
    key = 1 + before + index
    if phase is Phase.HIERARCHY:
        return Round(phase, index, key, count=_most_of_hierarchy(state))
    largest_count = rounds[phase][index]
    is_useful = largest_count > 0 and (phase is not Phase.MODEL or is_suitable)
    count = next_pattern_count(state, largest_count) if is_useful else 0
    held_out, count = _within_limit(state, phase, count)
    return Round(phase, index, key, held_out, count) if held_out + count else None


def _most_of_hierarchy(state: AdaptiveState) -> int:
    """Limit a round of a hierarchy to about as many patterns as the target lacks; 0 for no limit.

    Three rounds of single rays show how fast errors fall: those of coarser blocks predict nothing.
    """
    inner = state.hierarchy_state
    has_trend = inner is not None and len(state.hierarchy_levels) >= len(inner.levels) + 2
    return next_pattern_count(state, state.projector.size) if has_trend else 0


def _within_limit(state: AdaptiveState, phase: Phase, count: int) -> tuple[int, int]:
    """Return the numbers of held-out and of random patterns, within the options' limit."""
    total = HELD_OUT_OF_PRIOR if phase is Phase.PRIOR else len(HELD_OUT)
    held_out = total - (0 if state.held_out is None else len(state.held_out.lit))
    if not state.options.patterns:
        return held_out, count
    remaining = state.options.patterns - state.patterns_shown
    if remaining >= held_out + min(count, 1):
        return held_out, min(count, remaining - held_out)
    # without held-out pictures a round gives no estimate
    return 0, 0 if held_out else min(count, max(remaining, 0))
