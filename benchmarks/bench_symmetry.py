"""Asymmetry measured by random patterns, and the errors of symmetric photography it predicts.

Usage: ``python -m benchmarks.bench_symmetry [SCENE ...]``, ``wedge`` or scenes of Mitsuba by name
(ten minutes). A scene's matrix at 32 x 32 is spoilt as usual rigs spoil it: a camera that stands
beside the projector by a part of a pixel, vignetting, a camera out of focus, less light. For each:
the error that the check predicts, and the error of relit pictures by symmetric photography.
Writes results/bench/symmetry.csv.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

import rfpipe
from benchmarks.harness import errors, given, write
from benchmarks.localise_errors import recorded
from rfpipe.array_types import Double
from rfpipe.calibration.symmetry import (
    measure_symmetry,
    merged_pictures,
    random_signs,
    symmetry_test_patterns,
)
from rfpipe.mitsuba.worlds import WORLDS
from rfpipe.photometry import CameraModel
from rfpipe.scenes import planes_scene
from rfpipe.scenes.relighting import relighting_patterns

SCENES = ("wedge", "two_blocks", "translucent")
SIDE = 32
SEEDS = (0, 1, 2)
FRAMES = (4, 6, 8)
_BRIGHTEST = 1.9  # radiance of the floodlit image, of 2 that the camera takes
_FLOODLIT = 64
_LIGHT = CameraModel().electrons_per_radiance


def matrix_of(scene: str) -> Double:
    """Return a scene's matrix, (N, N), as bright as the camera takes it."""
    if scene == "wedge":
        made: Any = planes_scene("wedge", ("white", "texture"), (SIDE, SIDE), channels=1, seed=0)
    else:
        made = recorded(scene, SIDE)
    matrix = made.apply(np.eye(SIDE * SIDE))[..., 0].T.astype(np.float64)
    return np.asarray(matrix * _BRIGHTEST / matrix.sum(axis=1).max())


def beside(pixels: float) -> Callable[[Double], Double]:
    """Shift the camera against the projector."""

    def spoil(matrix: Double) -> Double:
        images = matrix.reshape(SIDE, SIDE, -1)
        moved = np.concatenate([images[:, :1], images[:, :-1]], axis=1)
        return np.asarray((1 - pixels) * images + pixels * moved).reshape(matrix.shape)

    return spoil


def vignetted(share: float) -> Callable[[Double], Double]:
    """Let the camera lose light from one side to the other."""
    gain = np.broadcast_to(np.linspace(1 - share, 1, SIDE), (SIDE, SIDE)).reshape(-1, 1)
    return lambda matrix: np.asarray(gain * matrix)


def blurred(pixels: float) -> Callable[[Double], Double]:
    """Let the camera be out of focus, by a Gaussian's standard deviation."""

    def spoil(matrix: Double) -> Double:
        images = matrix.reshape(SIDE, SIDE, -1)
        return np.asarray(gaussian_filter(images, (pixels, pixels, 0))).reshape(matrix.shape)

    return spoil


RIGS: dict[str, tuple[Callable[[Double], Double], float]] = {
    "right": (beside(0), 1.0),
    "right, a sixteenth of the light": (beside(0), 1 / 16),
    "a tenth of a pixel beside": (beside(0.1), 1.0),
    "a quarter": (beside(0.25), 1.0),
    "half a pixel": (beside(0.5), 1.0),
    "half a pixel, a sixteenth of the light": (beside(0.5), 1 / 16),
    "one pixel": (beside(1), 1.0),
    "10 % vignetting": (vignetted(0.1), 1.0),
    "30 % vignetting": (vignetted(0.3), 1.0),
    "camera's blur of 0.5 pixels": (blurred(0.5), 1.0),
    "camera's blur of 1 pixel": (blurred(1), 1.0),
}


def predicted(rig: rfpipe.OperatorRig, count: int, seed: int) -> float:
    """Return the error that `count` random patterns of single rays predict."""
    signs = random_signs((SIDE, SIDE), count, seed)
    lit = symmetry_test_patterns(signs, _FLOODLIT).astype(np.float32)
    frames = rig.capture(lit, [(0, index) for index in range(len(lit))])
    return measure_symmetry(*merged_pictures(frames, rig.sensor, signs, _FLOODLIT))[0]


def rows() -> Iterator[dict[str, Any]]:
    """Yield a row a scene and rig."""
    lit = np.stack(list(relighting_patterns((SIDE, SIDE)).values())).astype(np.float32)
    for scene in given("scene", str, SCENES, ("wedge", *WORLDS)):
        right = matrix_of(scene)
        for name, (spoil, light) in RIGS.items():
            matrix = spoil(right)
            camera = replace(CameraModel(), electrons_per_radiance=light * _LIGHT)
            rig = rfpipe.OperatorRig(matrix, (SIDE, SIDE), (SIDE, SIDE), camera)
            row = {
                f"predicted_{count}": np.mean([predicted(rig, count, seed) for seed in SEEDS])
                for count in FRAMES
            }
            result = rfpipe.acquire(
                rig, "symmetric", tolerance=3e-3, symmetry_brackets=0, progress=False
            )
            truth = lit.reshape(len(lit), -1) @ matrix.T
            images = result.transport.relight_batch(lit).reshape(truth.shape)
            error = errors(images, truth).mean()
            yield {"scene": scene, "rig": name, **row, "symmetric": error}


if __name__ == "__main__":
    write("symmetry", rows())
