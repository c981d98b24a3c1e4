"""When footprint acquisition ends, goes on, or gives way to dual photography."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.method import Footprints
from rfpipe.methods.footprints.rounds import decide
from rfpipe.methods.footprints.state import FootprintState
from rfpipe.methods.held_out.estimate import Estimate, Held
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.states import level_row

RAYS = RayDomain((12, 16))


def stalled(error: float, **options: float) -> FootprintState:
    """A state whose last round has hardly helped."""
    method = Footprints()
    state = method.start(RAYS, RAYS, 1, method.Options(target_error=0.005, **options))
    light = np.ones((1, RAYS.size), np.float32)
    nothing = np.zeros((0, 1, RAYS.size), np.float32)
    lit = np.zeros((0, RAYS.size), np.bool_)
    estimates = [Estimate(e, e, e, np.nan, np.nan) for e in (2 * error, 1.01 * error, error)]
    held = Held(np.ones((6, RAYS.size), np.bool_), np.ones((6, 1, RAYS.size), np.float32))
    return replace(
        state,
        level=4,
        rows=tuple(level_row(level, count) for level, count in enumerate((1, 30, 26, 36))),
        estimates=tuple(estimates),
        held=held,
        pictures=Pictures(light, light * 1e-6, lit, nothing, nothing),
    )


@pytest.mark.parametrize(
    ("error", "following"), [(0.0049, "done"), (0.0058, "done"), (0.0065, "hierarchy")]
)
def test_a_model_that_has_stalled_gives_way_only_where_it_is_clearly_off(
    error: float, following: str
) -> None:
    assert decide(stalled(error)).following == following


def test_a_model_that_still_gets_better_goes_on() -> None:
    state = stalled(0.0058)
    faster = (*state.estimates[:-1], Estimate(0.0051, 0.0051, 0.0051, np.nan, np.nan))
    assert decide(replace(state, estimates=faster)).following == "round"


def test_a_model_that_does_not_fit_gives_way_however_near_it_is() -> None:
    assert decide(replace(stalled(0.0058), unfit=True)).following == "hierarchy"
