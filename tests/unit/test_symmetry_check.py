"""A method for coaxial rigs refuses misaligned rigs and accepts aligned ones."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from tests.rigs.displaced_rigs import DIM, SHAPE, beside, wedge
from tests.rigs.known_matrix import picture_error
from tests.workflow.stagewise import FaultyRig

import rfpipe
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.units import SYMMETRY_KEY

RAYS = SHAPE[0] * SHAPE[1]
COAXIAL = ("symmetric", "near_far")
FEW = {"all_on_brackets": 8, "progress": False}


def vignetted(matrix: np.ndarray) -> np.ndarray:
    """Matrix of a camera that loses 10 % of the light from one side to the other."""
    share = np.broadcast_to(np.linspace(0.9, 1, SHAPE[1]), SHAPE)
    return np.asarray(share.reshape(-1, 1) * matrix)


def rig(matrix: np.ndarray, camera: CameraModel | None) -> rfpipe.OperatorRig:
    return rfpipe.OperatorRig(matrix, SHAPE, SHAPE, camera)


@pytest.mark.parametrize("camera", [None, CameraModel(), DIM])
@pytest.mark.parametrize("method", COAXIAL)
@pytest.mark.parametrize("pixels", [0.25, 0.5, 1.0])
def test_a_misaligned_rig_is_refused(
    method: str, pixels: float, camera: CameraModel | None
) -> None:
    with pytest.raises(CaptureError, match=r"not symmetric.*dual"):
        rfpipe.acquire(rig(beside(wedge(), pixels)[0], camera), method, **FEW)


@pytest.mark.parametrize("camera", [None, CameraModel(), DIM])
@pytest.mark.parametrize("change", [lambda matrix: matrix, vignetted])
def test_an_aligned_rig_is_accepted(change, camera: CameraModel | None, caplog) -> None:
    matrix = change(wedge()[0])
    with caplog.at_level(logging.WARNING):
        result = rfpipe.acquire(rig(matrix, camera), "symmetric", tolerance=1e-2, **FEW)
    assert "not symmetric" not in caplog.text
    assert picture_error(result.transport, matrix, generator(1).random((3, *SHAPE)) < 0.5) < 0.03


def test_the_accepted_asymmetry_is_a_setting(caplog) -> None:
    wrong = rig(beside(wedge(), 0.25)[0], CameraModel())
    with caplog.at_level(logging.WARNING):
        rfpipe.acquire(wrong, "symmetric", asymmetry=0.5, tolerance=1e-2, **FEW)
    assert "capture.asymmetry" in caplog.text
    caplog.clear()
    off = {"symmetry_brackets": 0}
    rfpipe.acquire(wrong, "symmetric", tolerance=1e-2, **off, **FEW)
    rfpipe.acquire(wrong, "dual", tolerance=1e-2, **FEW)
    assert not caplog.text
    for frames in (1, 2):
        with pytest.raises(InputError, match=f"symmetry_brackets is {frames}"):
            rfpipe.acquire(wrong, "symmetric", symmetry_brackets=frames, **FEW)


def test_a_black_scene_has_no_asymmetry() -> None:
    result = rfpipe.acquire(rig(np.zeros((RAYS, RAYS)), None), "symmetric", **FEW)
    assert result.patterns == 1


def spreading() -> np.ndarray:
    """A body that spreads all light."""
    half = generator(6).random((RAYS, RAYS))
    return (half + half.T) / RAYS


@pytest.mark.parametrize(
    ("matrix", "share"), [(wedge()[0], 0.1), (spreading(), 0.01), (spreading(), 0.1)]
)
def test_dead_pixels_are_no_asymmetry(matrix: np.ndarray, share: float) -> None:
    dead = generator(2).random(SHAPE) < share
    spoilt = FaultyRig(
        rig(matrix, CameraModel()),
        lambda _, frames: np.where(dead[..., None], np.uint16(5), frames),
    )
    result = rfpipe.acquire(spoilt, "symmetric", tolerance=0.1, **FEW)
    assert np.array_equal(result.masked, dead)


class Lit(FaultyRig):
    """A rig whose room light or lamp changes after the white pictures."""

    def __init__(self, room: float = 0.0, boost: float = 1.0) -> None:
        self._room = rig(wedge()[0], CameraModel())
        self._light, self._boost = room, boost

    def __getattr__(self, name: str):
        return getattr(self._room, name)

    def capture(self, patterns, keys):
        is_random = np.array([key[0] == SYMMETRY_KEY for key in keys])[:, None, None]
        light = np.where(is_random, self._boost * patterns + self._light, patterns)
        return self._room.capture(np.clip(light, 0, 1).astype(np.float32), keys)


@pytest.mark.parametrize("room", [Lit(room=0.1), Lit(boost=0.9)])
@pytest.mark.parametrize("method", ["near_far", "symmetric"])
def test_a_change_of_light_is_not_reported_as_asymmetry(room: Lit, method: str) -> None:
    with pytest.raises(CaptureError, match=r"room's light changed .*dynamic contrast") as caught:
        rfpipe.acquire(room, method, **FEW)
    assert "Align" not in str(caught.value)
