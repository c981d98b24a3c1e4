"""After each round near/far acquisition goes on, goes another way, or ends."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers import acquire_matrix

from rfpipe.methods.base import ErrorOptions
from rfpipe.methods.held_out.estimate import Estimate
from rfpipe.methods.near_far.method import NearFar
from rfpipe.methods.near_far.rounds import decide
from rfpipe.methods.near_far.state import BLOCKS, ROUNDS, NearFarState, kind_of
from rfpipe.methods.residual.estimate import Residual
from rfpipe.scenes import reference_scene
from rfpipe.transport.hierarchical.transport import HierarchicalTransport
from rfpipe.transport.low_rank import LowRankTransport


@pytest.fixture(scope="module")
def after_a_round() -> NearFarState:
    matrix = reference_scene("IV", (8, 8), channels=1).dense()
    state: NearFarState = acquire_matrix(NearFar(), matrix, (8, 8), (8, 8)).states[4]
    assert state.residual is not None
    return replace(state, following="smooth", residual=None)


def decided(state: NearFarState, errors: Sequence[float], noise: bool = False) -> NearFarState:
    """What follows when the rounds so far had these errors, all of it on lit pixels if of noise."""
    share = 0.1 if noise else 0.6
    estimates = tuple(Estimate(error, error, error, share * error, 10 * error) for error in errors)
    assert all(found.is_noise is noise for found in estimates)
    return decide(replace(state, following=state.kind, estimates=estimates))


@pytest.mark.parametrize("left", [0.86, 0.95, 1.3])
def test_after_a_round_that_leaves_most_of_the_error_come_blocks(
    after_a_round: NearFarState, left: float
) -> None:
    assert decided(after_a_round, [0.3, 0.2, left * 0.2]).following == "residual"
    assert decided(after_a_round, [0.3, 0.2, left * 0.2], noise=True).following == "done"


@pytest.mark.parametrize("errors", [[0.3, 0.2, 0.84 * 0.2], [0.3, 0.2, 0.1], [0.2, 0.19], [0.2]])
@pytest.mark.parametrize("noise", [False, True])
def test_a_round_that_helps_or_has_none_to_compare_with_is_followed_by_another(
    after_a_round: NearFarState, errors: list[float], noise: bool
) -> None:
    assert decided(after_a_round, errors, noise).following == "smooth"


def test_where_smooth_light_leaves_what_can_be_found_blocks_follow(
    after_a_round: NearFarState,
) -> None:
    nothing = np.zeros((2, 0), np.int32), np.zeros((1, 0), np.float32)
    found = replace(after_a_round, residual=Residual(*nothing))
    assert decided(found, [0.3, 0.2, 0.1]).following == "residual"


@pytest.mark.parametrize("first", [True, False])
def test_light_that_no_smooth_model_explains_needs_a_hierarchy(
    after_a_round: NearFarState, first: bool
) -> None:
    """The share of it that is unexplained decides; of the first round's few probes, a larger."""
    for unexplained, expected in ((0.55, "hierarchy"), (0.3, "smooth" if first else "hierarchy")):
        found = Estimate(0.5, 0.5, 0.5, unexplained * 0.4, 0.4)
        estimates = (found,) if first else (found, found)
        after = decide(replace(after_a_round, estimates=estimates))
        assert after.following == expected
        assert (after.symmetric is not None) is (expected == "hierarchy")


@pytest.mark.parametrize(("left", "expected"), [(0.95, "hierarchy"), (0.9, "residual")])
def test_blocks_that_hardly_help_are_followed_by_a_hierarchy(
    after_a_round: NearFarState, left: float, expected: str
) -> None:
    """The error should fall with the fifth root of the patterns, here to 0.936."""
    rows = ({"level": 1, "patterns": 72}, {"level": len(ROUNDS) + 1, "patterns": 28})
    state = replace(after_a_round, level=len(ROUNDS) + 2, rows=rows)
    assert decided(state, [0.3, 0.2, left * 0.2]).following == expected
    assert decided(state, [0.3, 0.2, left * 0.2], noise=True).following == (
        "done" if expected == "hierarchy" else expected
    )
    # where the number of patterns is limited, nothing takes over
    limited = replace(state, options=ErrorOptions(patterns=1000))
    after = decided(limited, [0.3, 0.2, left * 0.2]).following
    assert after == ("done" if expected == "hierarchy" else expected)


@pytest.mark.parametrize(("target", "expected"), [(0.195, "residual"), (0.01, "hierarchy")])
def test_blocks_that_would_take_more_than_a_hierarchy_are_followed_by_one(
    after_a_round: NearFarState, target: float, expected: str
) -> None:
    """It halves from 81 to 256 patterns: a fortieth less takes 13, a twentieth of it 100,000."""
    asked = ((1, 81), (len(ROUNDS) + 1, 63), (len(ROUNDS) + 2, 112))
    rows = tuple({"level": level, "patterns": count} for level, count in asked)
    options = ErrorOptions(target_error=target)
    state = replace(after_a_round, level=len(ROUNDS) + 3, rows=rows, options=options)
    assert decided(state, [0.5, 0.4, 0.28, 0.2]).following == expected
    assert decided(state, [0.5, 0.4, 0.28, 0.0]).following == "done"


def test_the_first_estimate_ends_it_where_nothing_is_indirect(after_a_round: NearFarState) -> None:
    """It knows neither strip nor spots."""
    target = after_a_round.options.target_error
    shapes = replace(
        after_a_round.held, lit=after_a_round.held.lit[:2], radiance=after_a_round.held.radiance[:2]
    )
    state = replace(after_a_round, held=shapes)
    for indirect, expected in ((0.9 * target, "done"), (1.1 * target, "smooth")):
        found = Estimate(*[0.9 * target] * 3, 0.0, indirect)
        assert decide(replace(state, estimates=(found,))).following == expected
        assert decide(replace(after_a_round, estimates=(found, found))).following == "done"


def test_every_level_is_for_one_thing() -> None:
    kinds = [kind_of(level, 5) for level in range(1 + len(ROUNDS) + 2 * len(BLOCKS) + 4)]
    blocks = ["residual"] * len(BLOCKS)
    assert kinds == [
        "floodlit", *["smooth"] * len(ROUNDS), *blocks, *["hierarchy"] * 4, *blocks
    ]  # fmt: skip


def test_what_is_left_dark_while_a_hierarchy_is_refined_is_known_from_it(
    after_a_round: NearFarState,
) -> None:
    """Smooth light may be better still, and be returned."""
    method = NearFar()
    found = Estimate(0.5, 0.5, 0.5, 0.3, 0.4)
    state = decide(replace(after_a_round, estimates=(found, found)))
    assert isinstance(method.known(state), HierarchicalTransport)
    assert method.known(after_a_round).nbytes == method.transport(after_a_round).nbytes
    [direct, *_] = method.transport(state).parts
    assert isinstance(direct, LowRankTransport)
