"""Footprint acquisition of light fields: each view's footprints on each, one chart for all."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.rigs.known_matrix import dense, picture_error

from rfpipe.methods.adaptive.footprints.method import Footprints, in_round
from rfpipe.scenes import room_scene
from rfpipe.stages.evaluate import relative_rms
from rfpipe.testing.methods import MethodContract, run_method

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

VIEWS, IMAGE = 3, (10, 12)
SHAPE = (VIEWS, *IMAGE)


@cache
def room() -> np.ndarray:
    """The transport of a room seen by three views side by side, (1, N, N)."""
    scene = room_scene(("texture", "white", "white"), IMAGE, views=(1, VIEWS), channels=1)
    matrix = scene.dense(0)[None]
    return matrix / matrix.sum(axis=2).max()


def errors(transport: Any, matrix: np.ndarray) -> float:
    """Mean error of relit pictures: half of all views, noise, a spot in one, one view."""
    shown = np.zeros((4, *SHAPE))
    shown[0, :, :, :6] = 1
    shown[1] = np.random.default_rng(3).random(SHAPE) < 0.5
    shown[2, 0, 3:7, 4:8] = 1
    shown[3, 1] = 1
    return picture_error(transport, matrix, shown)


class OnViews(MethodContract):
    """The contract where there are views."""

    options = {"target_error": 0.001}  # noqa: RUF012

    def make_method(self) -> Footprints:
        return Footprints()

    def _shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return (2, 3, 4), (3, 3, 4)


def test_a_state_of_views_is_restored() -> None:
    OnViews().test_a_state_is_restored_from_its_packs()


def test_a_light_field_is_good_after_few_patterns() -> None:
    matrix, target = room(), 0.015
    done = run_method(Footprints(), matrix, SHAPE, SHAPE, sigma=2e-4, target_error=target)
    assert sum(done.patterns) <= 1 + 6 + in_round(0, VIEWS) + in_round(1, VIEWS)
    error, told = errors(done.transport, matrix), done.states[-1].estimates[-1].error
    assert error < 1.3 * target
    assert 1 / 2 < told / error < 2


@pytest.mark.slow
def test_cameras_that_stand_beside_the_projectors() -> None:
    # two cameras' views of what three projectors light, one turned upside down
    matrix = room().reshape(VIEWS, *IMAGE, -1)[[0, 2], ::-1].reshape(1, 240, 360)
    camera = (2, *IMAGE)
    done = run_method(Footprints(), matrix, camera, SHAPE, sigma=2e-4, target_error=0.02)
    found, truth = dense(done.transport)[0], matrix[0]
    shown = np.random.default_rng(0).random((360, 5)) < 0.4
    assert relative_rms(found @ shown, truth @ shown) < 0.03
