"""Footprint acquisition of light fields: footprints on every view, one chart for all views."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.rigs.known_matrix import dense, picture_error

from rfpipe.methods.footprints.method import Footprints, patterns_in_round
from rfpipe.scenes import room_scene
from rfpipe.stages.evaluate import relative_rms
from rfpipe.testing.methods import MethodContract, run_method

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

VIEWS, IMAGE = 3, (10, 12)
SHAPE = (VIEWS, *IMAGE)


@cache
def room() -> np.ndarray:
    """Return the transport (1, N, N) of a room for three views in a row."""
    scene = room_scene(("texture", "white", "white"), IMAGE, views=(1, VIEWS), channels=1)
    matrix = scene.dense(0)[None]
    return matrix / matrix.sum(axis=2).max()


def relighting_error(transport: Any, matrix: np.ndarray) -> float:
    """Return the mean relighting error under half of each view, noise, a spot and one view."""
    patterns = np.zeros((4, *SHAPE))
    patterns[0, :, :, :6] = 1
    patterns[1] = np.random.default_rng(3).random(SHAPE) < 0.5
    patterns[2, 0, 3:7, 4:8] = 1
    patterns[3, 1] = 1
    return picture_error(transport, matrix, patterns)


class OnViews(MethodContract):
    """The contract of methods on stacks of views."""

    options = {"target_error": 0.001}  # noqa: RUF012

    def make_method(self) -> Footprints:
        return Footprints()

    def _shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return (2, 3, 4), (3, 3, 4)


def test_a_state_of_views_is_restored() -> None:
    OnViews().test_a_state_is_restored_from_its_arrays()


def test_light_field_needs_two_rounds_for_2_percent() -> None:
    matrix, target = room(), 0.015
    acquired = run_method(Footprints(), matrix, SHAPE, SHAPE, sigma=2e-4, target_error=target)
    assert sum(acquired.patterns) <= 1 + 6 + patterns_in_round(0, VIEWS) + patterns_in_round(
        1, VIEWS
    )
    error, estimate = (
        relighting_error(acquired.transport, matrix),
        acquired.states[-1].estimates[-1].error,
    )
    assert error < 1.3 * target
    assert 1 / 2 < estimate / error < 2


@pytest.mark.slow
def test_views_of_separate_cameras_and_projectors_are_acquired() -> None:
    # two cameras and three projectors; one camera is upside down
    matrix = room().reshape(VIEWS, *IMAGE, -1)[[0, 2], ::-1].reshape(1, 240, 360)
    camera = (2, *IMAGE)
    acquired = run_method(Footprints(), matrix, camera, SHAPE, sigma=2e-4, target_error=0.02)
    patterns = np.random.default_rng(0).random((360, 5)) < 0.4
    actual = dense(acquired.transport)[0] @ patterns
    assert relative_rms(actual, matrix[0] @ patterns) < 0.03
