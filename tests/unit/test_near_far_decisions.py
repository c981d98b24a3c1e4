"""After each round near/far acquisition goes on, ends, or hands over to symmetric photography."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
from tests.helpers import acquire_matrix

from rfpipe.methods.near_far.estimate import Estimate
from rfpipe.methods.near_far.method import NearFar, NearFarState
from rfpipe.scenes import reference_scene
from rfpipe.transport.hierarchical.transport import HierarchicalTransport


@pytest.fixture(scope="module")
def after_a_round() -> NearFarState:
    matrix = reference_scene("IV", (8, 8), channels=1).dense()
    return acquire_matrix(NearFar(), matrix, (8, 8), (8, 8)).states[4]


def decided(state: NearFarState, errors: Sequence[float], noise: bool = False) -> NearFarState:
    """What follows when the rounds so far had these errors, all of it on lit pixels if of noise."""
    share = 0.1 if noise else 0.6
    estimates = tuple(Estimate(error, error, share * error, 10 * error) for error in errors)
    assert all(found.is_noise is noise for found in estimates)
    return NearFar()._decide(replace(state, done=False, symmetric=None, estimates=estimates))


@pytest.mark.parametrize("left", [0.86, 0.95, 1.3])
def test_a_round_that_leaves_most_of_the_error_is_the_last(
    after_a_round: NearFarState, left: float
) -> None:
    after = decided(after_a_round, [0.3, 0.2, left * 0.2])
    assert after.done
    assert after.symmetric is not None
    after = decided(after_a_round, [0.3, 0.2, left * 0.2], noise=True)
    assert after.done
    assert after.symmetric is None


@pytest.mark.parametrize("errors", [[0.3, 0.2, 0.84 * 0.2], [0.3, 0.2, 0.1], [0.2, 0.19], [0.2]])
@pytest.mark.parametrize("noise", [False, True])
def test_a_round_that_helps_or_has_none_to_compare_with_is_followed_by_another(
    after_a_round: NearFarState, errors: list[float], noise: bool
) -> None:
    after = decided(after_a_round, errors, noise)
    assert not after.done
    assert after.symmetric is None


def test_what_is_left_dark_after_a_handover_is_known_from_the_hierarchy(
    after_a_round: NearFarState,
) -> None:
    """The model may be better still, and be returned; normalization rests on what is refined."""
    method, before = NearFar(), decided(after_a_round, [0.3, 0.2, 0.19])
    assert before.symmetric is not None
    for of_hierarchy, better in (((), True), ((0.5,), True), ((0.5, 0.1), False)):
        state = replace(before, of_hierarchy=of_hierarchy)
        assert state.model_is_better is better
        assert isinstance(method.known(state), HierarchicalTransport)
        [*parts] = method.transport(state).parts
        assert isinstance(parts[0], HierarchicalTransport) is not better
    assert method.known(after_a_round).nbytes == method.transport(after_a_round).nbytes
