"""After each round an acquisition goes on, goes another way, or ends."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers import acquire_matrix

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.estimate import Estimate, Held
from rfpipe.methods.adaptive.footprints.method import Footprints
from rfpipe.methods.adaptive.near_far import ROUNDS, NearFar, NearFarState
from rfpipe.methods.adaptive.residual import Residual
from rfpipe.methods.adaptive.rounds import AdaptiveState
from rfpipe.methods.base import ErrorOptions
from rfpipe.methods.images import Pictures
from rfpipe.methods.states import level_row
from rfpipe.scenes import reference_scene

METHOD = NearFar()


@pytest.fixture(scope="module")
def after_a_round() -> NearFarState:
    matrix = reference_scene("IV", (8, 8), channels=1).dense()
    state: NearFarState = acquire_matrix(METHOD, matrix, (8, 8), (8, 8)).states[4]
    assert state.residual is not None
    return replace(state, following="model", residual=None, news={})


def decided(state: NearFarState, errors: Sequence[float], noise: bool = False) -> str:
    """What follows when the rounds so far had these errors, all of it on lit pixels if of noise."""
    share = 0.1 if noise else 0.6
    estimates = tuple(Estimate(error, error, error, share * error, 10 * error) for error in errors)
    assert all(found.is_noise is noise for found in estimates)
    return METHOD.decided(
        replace(state, following=METHOD.slot(state)[0], estimates=estimates)
    ).following


def test_after_a_round_that_leaves_most_of_the_error_come_blocks(
    after_a_round: NearFarState,
) -> None:
    assert decided(after_a_round, [0.3, 0.2, 0.86 * 0.2]) == "residual"
    assert decided(after_a_round, [0.3, 0.2, 0.86 * 0.2], noise=True) == "done"
    for errors in ([0.3, 0.2, 0.84 * 0.2], [0.2, 0.19], [0.2]):
        assert decided(after_a_round, errors) == "model"
    nothing = np.zeros((2, 0), np.int32), np.zeros((1, 0), np.float32)
    found = replace(after_a_round, residual=Residual(*nothing))
    assert decided(found, [0.3, 0.2, 0.1]) == "residual"


@pytest.mark.parametrize(("left", "expected"), [(0.95, "hierarchy"), (0.9, "residual")])
def test_blocks_that_hardly_help_are_followed_by_a_hierarchy(
    after_a_round: NearFarState, left: float, expected: str
) -> None:
    """The error should fall with the fifth root of the patterns, here to 0.936."""
    rows = ({"level": 1, "patterns": 72}, {"level": len(ROUNDS) + 1, "patterns": 28})
    state = replace(after_a_round, level=len(ROUNDS) + 2, rows=rows)
    or_done = "done" if expected == "hierarchy" else expected
    assert decided(state, [0.3, 0.2, left * 0.2]) == expected
    assert decided(state, [0.3, 0.2, left * 0.2], noise=True) == or_done
    # where the number of patterns is limited, nothing takes over
    limited = replace(state, options=ErrorOptions(patterns=1000))
    assert decided(limited, [0.3, 0.2, left * 0.2]) == or_done


@pytest.mark.parametrize(("target", "expected"), [(0.195, "residual"), (0.01, "hierarchy")])
def test_blocks_that_would_take_more_than_a_hierarchy_are_followed_by_one(
    after_a_round: NearFarState, target: float, expected: str
) -> None:
    """It halves from 81 to 256 patterns: a fortieth less takes 13, a twentieth of it 100,000."""
    asked = ((1, 81), (len(ROUNDS) + 1, 63), (len(ROUNDS) + 2, 112))
    rows = tuple({"level": level, "patterns": count} for level, count in asked)
    options = ErrorOptions(target_error=target)
    state = replace(after_a_round, level=len(ROUNDS) + 3, rows=rows, options=options)
    assert decided(state, [0.5, 0.4, 0.28, 0.2]) == expected
    assert decided(state, [0.5, 0.4, 0.28, 0.0]) == "done"


def test_the_first_estimate_ends_it_where_nothing_is_indirect(after_a_round: NearFarState) -> None:
    """It knows neither strip nor spots."""
    target = after_a_round.options.target_error
    held = Held(after_a_round.held.lit[:2], after_a_round.held.radiance[:2])
    shapes = replace(after_a_round, held=held)
    for indirect, expected in ((0.9 * target, "done"), (1.1 * target, "model")):
        found = Estimate(*[0.9 * target] * 3, 0.0, indirect)
        assert METHOD.decided(replace(shapes, estimates=(found,))).following == expected
        both = replace(after_a_round, estimates=(found, found))
        assert METHOD.decided(both).following == "done"


def stalled(error: float, before: float = 1.01) -> AdaptiveState:
    """A state of footprints whose last round has hardly helped."""
    rays = RayDomain((12, 16))
    state = Footprints().start(rays, rays, 1, ErrorOptions(target_error=0.005))
    light = np.ones((1, 1, rays.size), np.float32)
    lit = np.ones((1, rays.size), np.bool_)
    return replace(
        state,
        level=4,
        rows=tuple(level_row(level, count) for level, count in enumerate((1, 30, 26, 36))),
        estimates=tuple(Estimate(e, e, e) for e in (2 * error, before * error, error)),
        held=Held(np.repeat(lit, 6, 0), np.repeat(light, 6, 0)),
        taken=Pictures(lit, light, 1e-6 * light),
    )


@pytest.mark.parametrize(
    ("state", "following"),
    [
        (stalled(0.0049), "done"),
        (stalled(0.0058), "done"),
        (stalled(0.0065), "hierarchy"),
        (stalled(0.0051, before=1.14), "model"),
        (replace(stalled(0.0058), unfit=True), "hierarchy"),
    ],
)
def test_footprints_give_way_where_they_do_not_fit_or_have_stalled_clearly_off_the_target(
    state: AdaptiveState, following: str
) -> None:
    assert Footprints().decided(state).following == following
