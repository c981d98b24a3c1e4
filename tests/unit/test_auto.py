"""A method for any rig: it looks at the rig, and goes on by what suits it."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from tests.helpers import scene_matrices

import rfpipe
from rfpipe.methods import Method
from rfpipe.methods.adaptive.footprints.method import Footprints
from rfpipe.methods.adaptive.near_far import NearFar
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import OperatorRig

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
    told = [record.message for record in caplog.records if "going on by" in record.message]
    # rigs of two shapes are not asked
    assert len(told) == (len(seen) == SIDE**2)
    assert all(message.endswith(chosen.title.lower()) for message in told)
    by_hand = rfpipe.acquire(rig(seen), chosen(), patterns=24, **FRAMES)
    light = generator(1).random((3, *SHAPE)).astype(np.float32)
    same = result.transport.relight_batch(light), by_hand.transport.relight_batch(light)
    np.testing.assert_array_equal(*same)
    assert result.patterns == by_hand.patterns <= 24
    assert "estimated_error" in result.history
