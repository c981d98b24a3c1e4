"""After each round an acquisition goes on, goes another way, or ends."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.decisions import going_on, next_round
from rfpipe.methods.adaptive.footprints.method import ROUNDS as FOOTPRINTS
from rfpipe.methods.adaptive.footprints.method import Footprints
from rfpipe.methods.adaptive.near_far import ROUNDS, NearFar
from rfpipe.methods.adaptive.state import SURE, AdaptiveState
from rfpipe.methods.base import ErrorOptions
from rfpipe.methods.error_estimate import Estimate
from rfpipe.methods.images import Pictures
from rfpipe.methods.residual.model import Residual
from rfpipe.methods.states import level_row

RAYS = RayDomain((48, 48))
NOTHING = Residual(np.zeros((2, 0), np.int32), np.zeros((1, 0), np.float32),
                   np.zeros((1, 0), np.float32))  # fmt: skip


def after(
    method: NearFar | Footprints, errors: Sequence[float], target: float, noise: float = 1e-4
) -> AdaptiveState:
    """Return the state after a round of the model for each error."""
    light = np.ones((1, 1, RAYS.size), np.float32)
    lit = np.ones((1, RAYS.size), np.bool_)
    counts = [1, *(ROUNDS if isinstance(method, NearFar) else FOOTPRINTS)][: len(errors) + 1]
    return replace(
        method.start(RAYS, RAYS, 1, ErrorOptions(target_error=target)),
        level=len(counts),
        rows=tuple(level_row(level, count) for level, count in enumerate(counts)),
        estimates=tuple(Estimate(error, error, error) for error in errors),
        held=Pictures(lit, light, light),
        taken=Pictures(lit, light, noise**2 * light),
    )


def in_blocks(
    state: AdaptiveState, counts: Sequence[int], errors: Sequence[float]
) -> AdaptiveState:
    """Return the state after rounds of blocks, too."""
    first = len(ROUNDS) + 1
    rows = (level_row(first + index, count) for index, count in enumerate(counts))
    more = (Estimate(error, error, error) for error in errors)
    return replace(
        state, following="residual", residual=NOTHING, level=first + len(counts),
        rows=(*state.rows, *rows), estimates=(*state.estimates, *more),
    )  # fmt: skip


def decided(method: NearFar | Footprints, state: AdaptiveState) -> str:
    return method.decided(replace(state, tolerance=0.0)).following


@pytest.mark.parametrize(
    ("errors", "following"),
    [
        ([0.05], "model"),
        ([0.009], "done"),
        ([0.11], "hierarchy"),
        ([0.05, 0.03, 0.84 * 0.03], "model"),
        ([0.05, 0.03, 0.86 * 0.03], "residual"),
    ],
)
def test_smooth_light_goes_on_while_it_helps(errors: list[float], following: str) -> None:
    state = after(NearFar(), errors, 0.01)
    assert decided(NearFar(), state) == following
    unlimited = following == "hierarchy"
    limited = replace(state, options=ErrorOptions(target_error=0.01, patterns=500))
    assert decided(NearFar(), limited) == ("model" if unlimited else following)


def test_noise_is_no_reason_to_go_on() -> None:
    for noise, following in ((0.02, "done"), (0.01, "residual")):
        state = after(NearFar(), [0.05, 0.03, 0.86 * 0.03], 0.01, noise)
        assert decided(NearFar(), state) == following


@pytest.mark.parametrize(
    ("errors", "target", "following"),
    [((0.016, 0.0125), 0.01, "residual"), ((0.0199, 0.0198), 0.005, "hierarchy")],
)
def test_blocks_that_would_take_more_than_a_hierarchy_are_followed_by_one(
    errors: tuple[float, ...], target: float, following: str
) -> None:
    state = in_blocks(after(NearFar(), [0.04, 0.02], target), (12, 20), errors)
    assert decided(NearFar(), state) == following


@pytest.mark.parametrize(
    ("errors", "target", "following"),
    [
        ((0.04, 0.02, 0.009), 0.01, "done"),
        ((0.04, 0.03, 0.025), 0.02, "model"),
        ((0.04, 0.039, 0.038), 0.01, "hierarchy"),
        ((0.12,), 0.01, "hierarchy"),
        ((0.04, 0.02, 0.015, 0.014, 0.013, 0.012, 0.0113), 0.01, "done"),
        ((0.04, 0.02, 0.015, 0.014, 0.013, 0.0125, 0.0122), 0.01, "hierarchy"),
    ],
)
def test_footprints_give_way_where_they_cost_more_than_dual_photography(
    errors: tuple[float, ...], target: float, following: str
) -> None:
    assert decided(Footprints(), after(Footprints(), errors, target)) == following


def test_a_round_has_the_patterns_that_are_missing() -> None:
    """Errors that fall with the root of the patterns take four times as many for a half."""
    shown = 1 + sum(ROUNDS[:2])
    before, now = 0.02 * np.sqrt(shown / (1 + ROUNDS[0])), 0.02
    state = after(NearFar(), [before, now], 0.0199 / SURE)
    assert next_round(state, 100) == 6
    for target in (0.018, 0.015):
        state = after(NearFar(), [before, now], target)
        missing = shown * ((now / (SURE * target)) ** 2 - 1)
        assert going_on(state) == pytest.approx(missing, rel=1e-6)
        assert next_round(state, 100) == max(6, round(1.1 * missing))
    assert next_round(state, 7) == 7


def test_both_targets_are_to_be_met() -> None:
    state = after(NearFar(), [0.04, 0.009], 0.01)
    for indirect, following in ((0.2, "done"), (0.05, "model")):
        options = ErrorOptions(target_error=0.01, target_indirect=indirect)
        told = replace(state, options=options)
        told = replace(told, estimates=[replace(each, indirect=0.1) for each in state.estimates])
        assert told.excess[-1] == pytest.approx(max(0.9, 0.1 / indirect) / SURE)
        assert decided(NearFar(), told) == following


def test_blocks_end_where_more_of_them_hardly_help() -> None:
    """Nearly at the target, errors that fall by a tenth while patterns double are the end."""
    state = after(NearFar(), [0.04, 0.02], 0.01)
    for last, following in ((0.0105, "done"), (0.0125, "hierarchy")):
        errors = (last * 1.1, last * 1.05, last)
        assert going_on(in_blocks(state, (12, 20, 28), errors)) == np.inf
        assert decided(NearFar(), in_blocks(state, (12, 20, 28), errors)) == following
