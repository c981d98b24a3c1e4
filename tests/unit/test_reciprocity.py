"""A coaxial rig that isn't one, or that is knocked, is noticed in the pictures it takes anyway."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rfpipe
from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.scenes import planes_scene

SHAPE = (12, 16)
METHODS = ("symmetric", "near_far")
FEW = {"floodlit_frames": 8, "progress": False, "symmetry_frames": 0}
DIM = replace(CameraModel(), electrons_per_radiance=CameraModel().electrons_per_radiance / 16)


def wedge(channels: int = 1, seed: int = 3) -> np.ndarray:
    """Return the matrices of a wedge, (C, N, N)."""
    scene = planes_scene("wedge", ("white", "texture"), SHAPE, channels=channels, seed=seed)
    images = scene.apply(np.eye(SHAPE[0] * SHAPE[1])).astype(np.float64)
    matrices = np.ascontiguousarray(images.transpose(2, 1, 0))
    return np.asarray(matrices * 1.9 / matrices.sum(axis=2).max())


def beside(matrices: np.ndarray, pixels: float) -> np.ndarray:
    """What a camera sees that stands some pixels, up to one, beside the projector."""
    images = matrices.reshape(len(matrices), *SHAPE, -1)
    moved = np.concatenate([images[:, :, :1], images[:, :, :-1]], axis=2)
    return np.asarray((1 - pixels) * images + pixels * moved).reshape(matrices.shape)


class Knocked(rfpipe.OperatorRig):
    """A rig that is knocked after some patterns, and whose lamp may drift."""

    def __init__(
        self, before: np.ndarray, after: np.ndarray, at: int, camera: Any, drift: float = 0.0
    ) -> None:
        super().__init__(list(before), SHAPE, SHAPE, camera)
        self.after = rfpipe.OperatorRig(list(after), SHAPE, SHAPE, camera)
        self.at, self.drift, self.keys = at, drift, list[tuple[int, ...]]()

    def capture(self, patterns: Any, keys: Any) -> Any:
        frames = []
        for pattern, key in zip(patterns, keys, strict=True):
            self.keys += [tuple(key)] if key[0] < 1000 else []
            light = np.float32(1 - self.drift * len(self.keys) / 100) * pattern[None]
            is_after = len(self.keys) > self.at
            rig: Any = self.after if is_after else super()
            frames.append(rig.capture(light, [key])[0])
        return np.stack(frames)


@pytest.mark.parametrize("camera", [CameraModel(), DIM, None])
@pytest.mark.parametrize("method", METHODS)
def test_half_a_pixel_is_noticed_within_ten_patterns(
    method: str, camera: CameraModel | None, caplog: pytest.LogCaptureFixture
) -> None:
    rig = Knocked(wedge(), beside(wedge(), 0.5), 0, camera)
    with pytest.raises(CaptureError, match=r"doesn't go from camera to projector.*capture.watch"):
        rfpipe.acquire(rig, method, watch="refuse", **FEW)
    batch = 16  # of which the last may be some patterns after the one that told
    assert len(rig.keys) <= 10 + batch
    with caplog.at_level(logging.WARNING):
        found = rfpipe.acquire(rig, method, **FEW)
    said = [record for record in caplog.records if "not aligned" in record.message]
    assert 1 <= len(said) <= len(found.reciprocity)  # once a level
    first = next(level["first"] for level in found.reciprocity if level["first"] is not None)
    assert first < 10


@pytest.mark.parametrize("method", ["symmetric", "near_far"])
@pytest.mark.parametrize("at", [4, 9])
def test_a_knock_is_noticed_within_ten_patterns(method: str, at: int) -> None:
    rig = Knocked(wedge(), beside(wedge(), 0.5), at, CameraModel())
    found = rfpipe.acquire(rig, method, **FEW)
    counts = [level["judged"] for level in found.reciprocity]
    level = next(i for i, told in enumerate(found.reciprocity) if told["first"] is not None)
    noticed = 1 + sum(counts[:level]) + found.reciprocity[level]["first"] + 1
    assert at < noticed <= at + 10


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("camera", [CameraModel(), DIM])
def test_right_rigs_raise_no_alarm(channels: int, camera: CameraModel) -> None:
    rig = rfpipe.OperatorRig(list(wedge(channels)), SHAPE, SHAPE, camera)
    for method, options in (("symmetric", {"tolerance": 1e-2}), ("near_far", {})):
        found = rfpipe.acquire(rig, method, watch="refuse", **options, **FEW)
        assert all(level["first"] is None for level in found.reciprocity)
        assert max(level["deviations"] for level in found.reciprocity) < 4


def test_a_lamp_that_drifts_is_no_asymmetry() -> None:
    rig = Knocked(wedge(), wedge(), 0, CameraModel(), drift=0.2)
    found = rfpipe.acquire(rig, "symmetric", watch="refuse", tolerance=1e-2, **FEW)
    assert max(level["deviations"] for level in found.reciprocity) < 4


def test_methods_for_any_rig_believe_nothing() -> None:
    rig = Knocked(wedge(), beside(wedge(), 0.5), 0, CameraModel())
    assert rfpipe.acquire(rig, "dual", watch="refuse", tolerance=1e-2, **FEW).reciprocity == ()
    assert rfpipe.acquire(rig, "symmetric", watch="off", **FEW).reciprocity == ()
