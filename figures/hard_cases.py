"""Numerically hard scenes: patterns and errors of the methods, from exact radiance and a camera."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from figures.common import TOLERANCE, Items, Size, Table, error
from figures.hard_scenes import hard_cases
from rfpipe import CameraModel, acquire
from rfpipe.errors import RfpipeError
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes.relighting import relighting_patterns

_DARK = ("photon_starved",)  # cases that the camera isn't exposed for: hard for being dark
_RUNS: tuple[tuple[str, bool, dict[str, float]], ...] = (
    ("symmetric", False, {"tolerance": TOLERANCE}),
    ("symmetric", True, {"tolerance": TOLERANCE}),
    ("dual", False, {"tolerance": TOLERANCE}),
    ("near_far", False, {}),
)


def items(_size: Size) -> Items:
    """Acquire every hard scene."""
    rows = [
        {"case": name, "method": method, "camera": "12 bits" if noisy else "exact",
         **_acquired(name, make(), method, noisy, options)}
        for name, make in hard_cases().items()
        for method, noisy, options in _RUNS
    ]  # fmt: skip
    caption = (
        "Relative Frobenius error of the matrix; the largest relative RMS error of a relit "
        "picture; and the floodlit image summed in float32 by relighting against a sum in float64. "
        "Misalignment by half a pixel breaks the symmetry that symmetric photography builds on."
    )
    yield Table("stability", "Hard cases", caption, pd.DataFrame(rows))


def _acquired(
    name: str, scene: Any, method: str, noisy: bool, options: dict[str, float]
) -> dict[str, Any]:
    """Acquire one small scene and compare the whole matrix with the truth."""
    rays = int(np.prod(scene.shape))
    row: dict[str, Any] = {"rays": rays, "patterns": None, "happened": "acquired"}
    camera = None
    if noisy:
        camera = CameraModel()
        brightest = float(scene.apply(np.ones((1, rays), np.float32)).max())
        if name not in _DARK and brightest > 0:
            electrons = camera.electrons_per_radiance / brightest
            camera = replace(camera, electrons_per_radiance=electrons)
    try:
        result = acquire(SimulatedRig(scene, camera, 1), method, progress=False, **options)
    except RfpipeError as refusal:
        return {**row, "happened": f"refused: {str(refusal).partition(':')[0]}"}
    transport = result.transport
    if result.patterns > rays:
        row["happened"] = "acquired, with more patterns than brute force"
    truth = np.stack([scene.dense(channel) for channel in range(scene.channels)])
    pixels = np.eye(rays, dtype=np.float32).reshape(rays, *scene.shape)
    columns = transport.relight_batch(pixels).reshape(rays, rays, scene.channels)
    matrix = columns.transpose(2, 1, 0).astype(np.float64)
    floodlit = transport.relight(np.ones(scene.shape, np.float32))
    patterns = np.stack(list(relighting_patterns(scene.shape).values()))
    relit = transport.relight_batch(patterns)
    true = scene.apply(patterns.reshape(len(patterns), -1)).reshape(relit.shape)
    return {
        **row,
        "patterns": result.patterns,
        "matrix_error": error(matrix, truth),
        "relight_error": pd.Series(list(map(error, relit, true))).max(),
        "accumulation": error(floodlit, matrix.sum(axis=2).T.reshape(floodlit.shape)),
    }
