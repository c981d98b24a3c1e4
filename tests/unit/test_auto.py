"""A method for any rig: it looks at the rig, and goes on by what suits it."""

from __future__ import annotations

import logging
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from tests.rigs.known_matrix import scene_matrices

import rfpipe
from rfpipe import steps
from rfpipe.methods import Method, get_method
from rfpipe.methods.footprints.method import Footprints
from rfpipe.methods.near_far.method import NearFar
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import OperatorRig
from rfpipe.testing.methods import run_method

SIDE = 12
SHAPE = (SIDE, SIDE)
FRAMES = {"black_frames": 2, "floodlit_frames": 8, "progress": False}


def coaxial() -> np.ndarray:
    return scene_matrices("IV", SHAPE)[0]


def beside(shift: int = 1) -> np.ndarray:
    """The same with a camera that stands some pixels beside the projector."""
    images = coaxial().reshape(SIDE, SIDE, -1)
    return np.concatenate([images[:, :shift], images[:, :-shift]], axis=1).reshape(SIDE**2, -1)


def halved() -> np.ndarray:
    """The same with a camera of half as many rows."""
    return coaxial().reshape(SIDE // 2, 2, SIDE, -1).mean(axis=1).reshape(SIDE**2 // 2, -1)


def rig(matrix: np.ndarray) -> OperatorRig:
    light = 1.5 / matrix.sum(axis=1).max()
    camera = (len(matrix) // SIDE, SIDE)
    return OperatorRig(light * matrix, camera, SHAPE, noise=CameraModel(), seed=1)


@pytest.mark.parametrize(
    ("seen", "chosen"),
    [(coaxial(), NearFar), (beside(), Footprints), (halved(), Footprints)],
    ids=["coaxial", "beside", "of two shapes"],
)
def test_what_the_rig_is_decides(
    seen: np.ndarray, chosen: type[Method], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "rfpipe"):
        result = rfpipe.acquire(rig(seen), "auto", patterns=24, **FRAMES)
    told = [record.message for record in caplog.records if "continuing with" in record.message]
    # rigs of two shapes are not asked
    assert len(told) == (len(seen) == SIDE**2)
    assert all(message.endswith(chosen.title.lower()) for message in told)
    by_hand = rfpipe.acquire(rig(seen), chosen(), patterns=24, **FRAMES)
    light = generator(1).random((3, *SHAPE)).astype(np.float32)
    same = result.transport.relight_batch(light), by_hand.transport.relight_batch(light)
    np.testing.assert_array_equal(*same)
    assert result.patterns == by_hand.patterns <= 24
    assert "estimated_error" in result.history


@pytest.mark.parametrize("brackets", [2, 5])
def test_ctrl_c_keeps_what_the_levels_before_told(brackets: int) -> None:
    """Without the floodlit image there is nothing to keep."""

    class Stopped(OperatorRig):
        shown = 0

        def capture(self, patterns: Any, keys: Any) -> Any:
            self.shown += len(patterns)
            if self.shown > brackets:
                raise KeyboardInterrupt
            return super().capture(patterns, keys)

    stopped = Stopped(coaxial(), SHAPE, SHAPE, noise=None)
    if brackets < 3:  # a dark one, two of full light
        with pytest.raises(KeyboardInterrupt):
            rfpipe.acquire(stopped, "near_far", symmetry_frames=0, **FRAMES)
    else:
        result = rfpipe.acquire(stopped, "near_far", symmetry_frames=0, **FRAMES)
        relit = result.transport.relight(np.ones(SHAPE))
        assert np.allclose(relit.ravel(), coaxial().sum(axis=1), rtol=1e-4)


@pytest.mark.parametrize(("seen", "method"), [(coaxial(), "near_far"), (beside(), "footprints")])
def test_fits_count_their_steps(seen: np.ndarray, method: str) -> None:
    counter = MagicMock()
    with steps.counted_by(counter):
        run_method(get_method(method), seen[None], SHAPE, SHAPE, target_error=1e-4, patterns=40)
    total = sum(call.args[1] for call in counter.call_args_list)
    counted = counter.return_value.__enter__.return_value.advance.call_count
    assert 0.7 * total <= counted <= total


def test_the_floodlit_image_has_the_noise_of_all_its_brackets() -> None:
    spread = []

    class Noting(NearFar):
        def refine(self, state: Any, images: Any, *more: Any) -> Any:
            if state.level == 0:
                spread.append(images.read(0, 1)[1].mean())
            return super().refine(state, images, *more)

    for count in (1, 16):
        frames = FRAMES | {"floodlit_frames": count}
        rfpipe.acquire(rig(coaxial()), Noting(), patterns=13, **frames)
    assert spread[1] == pytest.approx(spread[0] / 16, rel=0.1)
