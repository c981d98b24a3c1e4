"""Automatic acquisition: the choice of a method, and common behaviour of adaptive methods."""

from __future__ import annotations

import logging
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from tests.rigs.known_matrix import scene_matrices

import rfpipe
from rfpipe import steps
from rfpipe.blocks import RayDomain
from rfpipe.methods import Method, get_method
from rfpipe.methods.auto import Auto
from rfpipe.methods.footprints.method import Footprints
from rfpipe.methods.near_far.method import NearFar
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import OperatorRig
from rfpipe.testing.methods import run_method

SIDE = 12
SHAPE = (SIDE, SIDE)
FRAMES = {"all_off_brackets": 2, "all_on_brackets": 8, "progress": False}


def coaxial() -> np.ndarray:
    return scene_matrices("IV", SHAPE)[0]


def displaced(columns: int = 1) -> np.ndarray:
    """Return the coaxial matrix for a camera that is displaced by some columns of pixels."""
    images = coaxial().reshape(SIDE, SIDE, -1)
    shifted = [images[:, :columns], images[:, :-columns]]
    return np.concatenate(shifted, axis=1).reshape(SIDE**2, -1)


def halved() -> np.ndarray:
    """Return the coaxial matrix for a camera of half as many rows."""
    return coaxial().reshape(SIDE // 2, 2, SIDE, -1).mean(axis=1).reshape(SIDE**2 // 2, -1)


def noisy_rig(matrix: np.ndarray) -> OperatorRig:
    light = 1.5 / matrix.sum(axis=1).max()
    camera = (len(matrix) // SIDE, SIDE)
    return OperatorRig(light * matrix, camera, SHAPE, noise=CameraModel(), seed=1)


@pytest.mark.parametrize(
    ("camera", "projector", "is_coaxial", "chosen"),
    [
        ((12, 12), (12, 12), None, NearFar),
        ((12, 12), (12, 12), True, NearFar),
        ((12, 12), (12, 12), False, Footprints),
        ((6, 12), (12, 12), None, Footprints),
        ((2, 12, 12), (2, 12, 12), None, Footprints),
    ],
)
def test_auto_chooses_a_method_by_the_rig(
    camera: tuple[int, ...], projector: tuple[int, ...], is_coaxial: bool | None, chosen: type
) -> None:
    method = Auto().for_rig(RayDomain(camera), RayDomain(projector), is_coaxial)
    assert type(method) is chosen


@pytest.mark.parametrize(
    ("matrix", "chosen"),
    [(coaxial(), NearFar), (displaced(), Footprints), (halved(), Footprints)],
    ids=["coaxial", "displaced", "of two shapes"],
)
def test_auto_returns_the_transport_of_the_chosen_method(
    matrix: np.ndarray, chosen: type[Method], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "rfpipe.references.symmetry"):
        result = rfpipe.acquire(noisy_rig(matrix), "auto", patterns=24, **FRAMES)
    messages = [r.message for r in caplog.records if r.name == "rfpipe.references.symmetry"]
    # the symmetry of two ray domains isn't measured
    assert len(messages) == (len(matrix) == SIDE**2)
    assert all(message.endswith(chosen.title.lower()) for message in messages)
    expected = rfpipe.acquire(noisy_rig(matrix), chosen(), patterns=24, **FRAMES)
    light = generator(1).random((3, *SHAPE)).astype(np.float32)
    np.testing.assert_array_equal(
        result.transport.relight_batch(light), expected.transport.relight_batch(light)
    )
    assert result.patterns == expected.patterns <= 24
    assert "estimated_error" in result.history


class InterruptedRig(OperatorRig):
    """A rig at which the user presses Ctrl-C after some brackets."""

    brackets: int
    shown = 0

    def capture(self, patterns: Any, keys: Any) -> Any:
        self.shown += len(patterns)
        if self.shown > self.brackets:
            raise KeyboardInterrupt
        return super().capture(patterns, keys)


def test_ctrl_c_returns_the_transport_of_the_finished_levels() -> None:
    rig = InterruptedRig(coaxial(), SHAPE, SHAPE, noise=None)
    rig.brackets = 5
    result = rfpipe.acquire(rig, "near_far", symmetry_brackets=0, **FRAMES)
    relit = result.transport.relight(np.ones(SHAPE))
    assert np.allclose(relit.ravel(), coaxial().sum(axis=1), rtol=1e-4)


def test_ctrl_c_before_the_floodlit_image_returns_nothing() -> None:
    rig = InterruptedRig(coaxial(), SHAPE, SHAPE, noise=None)
    rig.brackets = 2  # a black bracket and a white one
    with pytest.raises(KeyboardInterrupt):
        rfpipe.acquire(rig, "near_far", symmetry_brackets=0, **FRAMES)


@pytest.mark.parametrize(
    ("matrix", "method"), [(coaxial(), "near_far"), (displaced(), "footprints")]
)
def test_announced_steps_of_fits_are_a_close_upper_bound(matrix: np.ndarray, method: str) -> None:
    factory = MagicMock()
    with steps.displayed_by(factory):
        run_method(get_method(method), matrix[None], SHAPE, SHAPE, target_error=1e-4, patterns=40)
    announced = sum(call.args[1] for call in factory.call_args_list)
    counted = factory.return_value.__enter__.return_value.advance.call_count
    assert 0.7 * announced <= counted <= announced


class RecordingMethod(NearFar):
    """Near/far acquisition that records the variance of the floodlit image."""

    def __init__(self, variances: list[float]) -> None:
        self.variances = variances

    def refine(self, state: Any, images: Any, *arguments: Any) -> Any:
        if state.level == 0:
            self.variances.append(float(images.read(0, 1)[1].mean()))
        return super().refine(state, images, *arguments)


def test_the_floodlit_image_is_the_mean_of_all_its_brackets() -> None:
    variances: list[float] = []
    for count in (1, 16):
        frames = FRAMES | {"all_on_brackets": count}
        method = RecordingMethod(variances)
        rfpipe.acquire(noisy_rig(coaxial()), method, patterns=13, **frames)
    assert variances[1] == pytest.approx(variances[0] / 16, rel=0.1)
