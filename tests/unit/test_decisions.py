"""Decisions of the adaptive methods after a round."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.decisions import (
    ALL_SHOWN,
    BRUTE_FORCE,
    NOT_SUITABLE,
    Decision,
    after_dense_round,
    after_hierarchy_round,
    end,
    next_pattern_count,
)
from rfpipe.methods.adaptive.forecast import (
    TYPICAL_POWER,
    hierarchy_patterns,
    patterns_to_target,
)
from rfpipe.methods.adaptive.loop import AdaptiveMethod
from rfpipe.methods.adaptive.rounds import next_round
from rfpipe.methods.adaptive.state import (
    STOPPING_FRACTION,
    AdaptiveState,
    Phase,
    Round,
    hierarchy_start,
)
from rfpipe.methods.base import ErrorOptions
from rfpipe.methods.error_estimate import Estimate
from rfpipe.methods.footprints.method import Footprints
from rfpipe.methods.images import Pictures
from rfpipe.methods.near_far.method import ROUNDS, NearFar
from rfpipe.methods.residual.model import Residual
from rfpipe.methods.states import level_row

RAYS = RayDomain((48, 48))
EMPTY_RESIDUAL = Residual(
    np.zeros((2, 0), np.int32), np.zeros((1, 0), np.float32), np.zeros((1, 0), np.float32)
)


def after_model_rounds(
    method: AdaptiveMethod, errors: Sequence[float], target: float, noise: float = 1e-4
) -> AdaptiveState:
    """Return the state after a round of the model for each estimated error.

    `noise` is the relative noise of the floodlit image.
    """
    light = np.ones((1, 1, RAYS.size), np.float32)
    floodlit = Pictures(np.ones((1, RAYS.size), np.bool_), light, noise**2 * light)
    state = method.start(RAYS, RAYS, 1, ErrorOptions(target_error=target))
    counts = [1, *method.rounds(RAYS)[Phase.MODEL][: len(errors)]]
    return replace(
        state,
        rows=tuple(level_row(level, count) for level, count in enumerate(counts)),
        estimates=tuple(Estimate(error, error, error) for error in errors),
        floodlit=floodlit,
        held_out=floodlit,
        model=method.first_model(state, floodlit),
    )


def after_residual_rounds(
    state: AdaptiveState, counts: Sequence[int], errors: Sequence[float]
) -> AdaptiveState:
    """Return the state after further rounds for the residual."""
    rows = (level_row(len(state.rows) + index, count) for index, count in enumerate(counts))
    estimates = (Estimate(error, error, error) for error in errors)
    return replace(
        state,
        residual=EMPTY_RESIDUAL,
        rows=(*state.rows, *rows),
        estimates=(*state.estimates, *estimates),
    )


def decision(method: AdaptiveMethod, state: AdaptiveState, phase: Phase, is_last: bool) -> Decision:
    """Return the decision after a round."""
    return end(state) or method.decide(state, phase, is_last)


@pytest.mark.parametrize(
    ("errors", "phase"),
    [
        ([0.05], Phase.MODEL),
        ([0.009], None),
        ([0.11], Phase.HIERARCHY),
        ([0.05, 0.03, 0.81 * 0.03], Phase.MODEL),
        ([0.05, 0.03, 0.84 * 0.03], Phase.RESIDUAL),
    ],
)
def test_near_far_continues_its_model_while_the_error_falls(
    errors: list[float], phase: Phase | None
) -> None:
    state = after_model_rounds(NearFar(), errors, 0.01)
    assert decision(NearFar(), state, Phase.MODEL, False).phase is phase
    # with a limit on patterns no hierarchy begins
    options = ErrorOptions(target_error=0.01, patterns=500)
    limited = decision(NearFar(), replace(state, options=options), Phase.MODEL, False).phase
    assert limited is (Phase.MODEL if phase is Phase.HIERARCHY else phase)


@pytest.mark.parametrize(("patterns", "phase"), [(8, Phase.RESIDUAL), (3, Phase.MODEL)])
def test_a_short_round_may_reduce_the_error_less(patterns: int, phase: Phase) -> None:
    state = after_model_rounds(NearFar(), [0.05, 0.03, 0.9 * 0.03], 0.01)
    state = replace(state, rows=(*state.rows[:-1], level_row(3, patterns)))
    assert decision(NearFar(), state, Phase.MODEL, False).phase is phase


def test_an_error_of_noise_ends_the_acquisition() -> None:
    for noise, phase in ((0.02, None), (0.01, Phase.RESIDUAL)):
        state = after_model_rounds(NearFar(), [0.05, 0.03, 0.86 * 0.03], 0.01, noise)
        assert decision(NearFar(), state, Phase.MODEL, False).phase is phase


def test_a_useful_residual_gets_further_rounds() -> None:
    state = after_model_rounds(NearFar(), [0.05, 0.03], 0.01)
    helped = replace(state, residual=EMPTY_RESIDUAL)
    assert decision(NearFar(), state, Phase.MODEL, False).phase is Phase.MODEL
    assert decision(NearFar(), helped, Phase.MODEL, False).phase is Phase.RESIDUAL


@pytest.mark.parametrize(
    ("errors", "target", "phase"),
    [
        ((0.016, 0.0125), 0.01, Phase.RESIDUAL),
        ((0.0199, 0.0198), 0.005, Phase.HIERARCHY),
    ],
)
def test_a_hierarchy_begins_where_blocks_would_take_more_patterns(
    errors: tuple[float, ...], target: float, phase: Phase
) -> None:
    state = after_model_rounds(NearFar(), [0.04, 0.02], target)
    state = after_residual_rounds(state, (12, 20), errors)
    assert decision(NearFar(), state, Phase.RESIDUAL, False).phase is phase


@pytest.mark.parametrize(
    ("errors", "target", "phase"),
    [
        ((0.04, 0.02, 0.009), 0.01, None),
        ((0.04, 0.03, 0.022), 0.02, Phase.MODEL),
        ((0.04, 0.03, 0.025), 0.02, Phase.HIERARCHY),
        ((0.04, 0.039, 0.038), 0.01, Phase.HIERARCHY),
        ((0.12,), 0.01, Phase.HIERARCHY),
        ((0.04, 0.02, 0.015, 0.014, 0.013, 0.012, 0.0113), 0.01, None),
        ((0.04, 0.02, 0.015, 0.014, 0.013, 0.0125, 0.0122), 0.01, Phase.HIERARCHY),
    ],
)
def test_a_hierarchy_begins_where_footprints_would_take_more_patterns(
    errors: tuple[float, ...], target: float, phase: Phase | None
) -> None:
    state = after_model_rounds(Footprints(), errors, target)
    assert decision(Footprints(), state, Phase.MODEL, False).phase is phase


def test_a_scene_that_footprints_do_not_fit_ends_at_a_limit_of_patterns() -> None:
    state = after_model_rounds(Footprints(), [0.04], 0.01)
    state = replace(state, model=replace(state.model, is_suitable=False))
    assert decision(Footprints(), state, Phase.MODEL, False) == (Phase.HIERARCHY, NOT_SUITABLE)
    limited = replace(state, options=ErrorOptions(target_error=0.01, patterns=500))
    assert decision(Footprints(), limited, Phase.MODEL, False) == (None, NOT_SUITABLE)


def test_a_tight_target_of_indirect_light_tightens_the_hierarchy() -> None:
    tolerances = []
    for indirect in (None, 0.3, 0.03):
        state = after_model_rounds(NearFar(), [0.12], 0.01)
        options = ErrorOptions(target_error=0.01, target_indirect=indirect)
        tolerances.append(hierarchy_start(replace(state, options=options)).options.tolerance)
    assert tolerances[0] == tolerances[1] > tolerances[2]


def after_hierarchy_rounds(counts: Sequence[int], errors: Sequence[float]) -> AdaptiveState:
    """Return the state of near/far acquisition after rounds of a hierarchy."""
    before = after_model_rounds(NearFar(), [0.12], 0.01)
    state = after_residual_rounds(before, counts, errors)
    levels = tuple(range(len(before.rows), len(state.rows)))
    return replace(state, hierarchy_state=hierarchy_start(state), hierarchy_levels=levels)


def test_the_residual_follows_a_hierarchy_that_would_take_more_patterns_than_brute_force() -> None:
    """Errors above the level of single rays, and of fewer than five rounds there, show no trend."""
    counts, coarse = (8, 8, 12, 16, 16, 10, 14, 18), (0.9, 0.8, 0.7)
    for errors, phase in (
        (coarse, Phase.HIERARCHY),
        ((*coarse, 0.5, 0.4), Phase.HIERARCHY),
        ((*coarse, 0.1, 0.099, 0.098), Phase.HIERARCHY),
        ((*coarse, 0.3, 0.2, 0.1, 0.05, 0.02), Phase.HIERARCHY),
        ((*coarse, 0.1, 0.0998, 0.0996, 0.0993, 0.099), Phase.DENSE),
    ):
        state = after_hierarchy_rounds(counts[: len(errors)], errors)
        assert after_hierarchy_round(state, errors[-1]).phase is phase
    complete = replace(state, hierarchy_state=replace(state.hierarchy_state, is_complete=True))
    assert after_hierarchy_round(complete, errors[-1]) == (None, ALL_SHOWN)


def test_light_that_is_not_sparse_has_further_rounds_for_the_residual() -> None:
    """The first round of single rays, here the fourth, shows whether a hierarchy suits it."""
    for levels, share, phase in (
        (3, 4.0, Phase.HIERARCHY),
        (4, 1.0, Phase.HIERARCHY),
        (4, 1.1, Phase.DENSE),
        (5, 4.0, Phase.HIERARCHY),
    ):
        state = after_hierarchy_rounds((8, 8, 12, 16, 16)[:levels], (0.02,) * levels)
        assert len(state.hierarchy_state.levels) == 4
        assert after_hierarchy_round(state, 0.02 * share).phase is phase


def test_a_later_round_of_a_hierarchy_has_about_the_patterns_that_the_target_lacks() -> None:
    """Three rounds of single rays, here the fourth to the sixth, show how fast errors fall."""
    counts, errors = (8, 8, 12, 16, 16, 10), (0.9, 0.9, 0.9, 0.02, 0.014, 0.0125)
    for levels, is_limited in ((4, False), (5, False), (6, True)):
        state = after_hierarchy_rounds(counts[:levels], errors[:levels])
        state = replace(state, next_round=Round(Phase.HIERARCHY, levels - 1))
        coming = next_round(state, NearFar().rounds(RAYS), Phase.HIERARCHY, is_suitable=True)
        assert coming.index == levels
        missing = round(1.1 * patterns_to_target(state))
        assert coming.count == (max(6, missing) if is_limited else 0)


def test_rounds_after_a_hierarchy_end_where_brute_force_would_take_fewer_patterns() -> None:
    counts, before = (8, 8, 12, 16), (0.02,) * 4
    for errors, decision in (
        ((0.0199, 0.0198), (Phase.DENSE, "")),
        ((0.018, 0.016, 0.014), (Phase.DENSE, "")),
        ((0.0199, 0.0198, 0.0197), (None, BRUTE_FORCE)),
    ):
        shown = (*counts, *(40, 60, 88)[: len(errors)])
        state = after_hierarchy_rounds(shown, (*before, *errors))
        state = replace(state, hierarchy_levels=state.hierarchy_levels[: len(counts)])
        assert after_dense_round(state, is_last=False) == decision
    assert after_dense_round(state, is_last=True) == (None, ALL_SHOWN)


def test_a_round_has_the_patterns_missing_by_extrapolation() -> None:
    """If errors fall with the root of the patterns, half the error takes four times as many."""
    patterns = 1 + sum(ROUNDS[:2])
    before, error = 0.02 * np.sqrt(patterns / (1 + ROUNDS[0])), 0.02
    state = after_model_rounds(NearFar(), [before, error], 0.0199 / STOPPING_FRACTION)
    assert next_pattern_count(state, 100) == 6
    for target in (0.018, 0.015):
        state = after_model_rounds(NearFar(), [before, error], target)
        missing = patterns * ((error / (STOPPING_FRACTION * target)) ** 2 - 1)
        assert patterns_to_target(state) == pytest.approx(missing, rel=1e-6)
        assert next_pattern_count(state, 100) == max(6, round(1.1 * missing))
    assert next_pattern_count(state, 7) == 7


def test_remaining_patterns_follow_from_the_error_so_far() -> None:
    method, patterns = NearFar(), 1 + ROUNDS[0]
    coming = Round(Phase.MODEL, 1, 2, 0, 10)
    one_round = replace(after_model_rounds(method, [0.03], 0.01), next_round=coming)
    typical = patterns * ((0.03 / 0.0095) ** (1 / TYPICAL_POWER) - 1)
    assert method.remaining_patterns(one_round) == round(typical)

    # errors that fall slower than typical, and so slowly that a hierarchy takes fewer patterns
    shown = patterns + ROUNDS[1]
    first = 0.012 * (shown / patterns) ** 0.4
    two_rounds = replace(after_model_rounds(method, [first, 0.012], 0.01), next_round=coming)
    by_rounds = shown * ((0.012 / 0.0095) ** (1 / 0.4) - 1)
    assert method.remaining_patterns(two_rounds) == round(by_rounds)
    stalled = replace(after_model_rounds(method, [0.03, 0.029], 0.01), next_round=coming)
    hierarchy = hierarchy_patterns(RAYS, 0.01)
    assert method.remaining_patterns(stalled) == round(hierarchy)
    next_level = replace(one_round, next_round=Round(Phase.HIERARCHY))
    assert method.remaining_patterns(next_level) == round(hierarchy)


def test_remaining_patterns_are_those_of_the_next_round_at_least_and_of_the_limit_at_most() -> None:
    method = NearFar()
    begun = method.start(RAYS, RAYS, 1, ErrorOptions(target_error=0.01))
    assert method.remaining_patterns(begun) == 33
    state = after_model_rounds(method, [0.0096], 0.01)
    assert method.remaining_patterns(replace(state, next_round=None)) == 0
    coming = replace(state, next_round=Round(Phase.MODEL, 1, 2, 0, 10))
    assert method.remaining_patterns(coming) == 10
    limited = replace(coming, options=ErrorOptions(target_error=0.01, patterns=12))
    assert method.remaining_patterns(limited) == 12 - (1 + ROUNDS[0])


def test_both_targets_must_be_met() -> None:
    state = after_model_rounds(NearFar(), [0.04, 0.009], 0.01)
    for indirect, phase in ((0.2, None), (0.05, Phase.MODEL)):
        options = ErrorOptions(target_error=0.01, target_indirect=indirect)
        estimates = tuple(replace(estimate, indirect=0.1) for estimate in state.estimates)
        state = replace(state, options=options, estimates=estimates)
        assert state.excess[-1] == pytest.approx(max(0.9, 0.1 / indirect) / STOPPING_FRACTION)
        assert decision(NearFar(), state, Phase.MODEL, False).phase is phase


def test_blocks_end_near_the_target_if_further_ones_hardly_help() -> None:
    """The errors fall by 10 % while the number of patterns doubles."""
    state = after_model_rounds(NearFar(), [0.04, 0.02], 0.01)
    for last, phase in ((0.0105, None), (0.0125, Phase.HIERARCHY)):
        errors = (last * 1.1, last * 1.05, last)
        after = after_residual_rounds(state, (12, 20, 28), errors)
        assert patterns_to_target(after) == np.inf
        assert decision(NearFar(), after, Phase.RESIDUAL, False).phase is phase
