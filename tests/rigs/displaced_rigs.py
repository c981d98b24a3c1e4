"""Rigs with a displaced camera, or with one that moves during the capture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import rfpipe
from rfpipe.photometry import CameraModel
from rfpipe.scenes import planes_scene

SHAPE = (12, 16)
DIM = replace(CameraModel(), electrons_per_radiance=CameraModel().electrons_per_radiance / 16)


def wedge(channels: int = 1, seed: int = 3) -> np.ndarray:
    """Return the matrices of a wedge, (C, N, N)."""
    scene = planes_scene("wedge", ("white", "texture"), SHAPE, channels=channels, seed=seed)
    images = scene.apply(np.eye(SHAPE[0] * SHAPE[1])).astype(np.float64)
    matrices = np.ascontiguousarray(images.transpose(2, 1, 0))
    return np.asarray(matrices * 1.9 / matrices.sum(axis=2).max())


def beside(matrices: np.ndarray, pixels: float) -> np.ndarray:
    """Return the matrices of a camera displaced to the side by up to one pixel."""
    images = matrices.reshape(len(matrices), *SHAPE, -1)
    moved = np.concatenate([images[:, :, :1], images[:, :, :-1]], axis=2)
    return np.asarray((1 - pixels) * images + pixels * moved).reshape(matrices.shape)


class Knocked(rfpipe.OperatorRig):
    """A rig whose camera moves after a number of patterns, and whose lamp may drift."""

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
