"""Acquisitions of known matrices in memory, commands in process, and settings of a small run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typer.testing import CliRunner

from rfpipe.cli import app
from rfpipe.config import Config, parse_config
from rfpipe.methods import Method
from rfpipe.scenes import reference_scene
from rfpipe.stages.evaluate import relative_rms
from rfpipe.testing.methods import MethodRun, matrix_of, run_method
from rfpipe.transport import Transport

dense = matrix_of


def acquire_matrix(
    method: Method[Any],
    matrix: NDArray[Any],
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    tolerance: float = 1e-3,
    sigma: float = 0.0,
    seed: int = 0,
) -> MethodRun:
    """Acquire a matrix (M, N) or (C, M, N); `tolerance` is ignored by methods without it."""
    options = {"tolerance": tolerance} if "tolerance" in method.Options.model_fields else {}
    shapes = camera_shape, projector_shape
    return run_method(method, matrix, *shapes, sigma=sigma, seed=seed, **options)


def picture_error(transport: Transport, matrix: NDArray[Any], pictures: NDArray[Any]) -> float:
    """Return the mean relighting error under patterns (P, *projector) against a matrix."""
    relit = transport.relight_batch(pictures.astype(np.float32))
    matrices = matrix.reshape(-1, *matrix.shape[-2:])
    truth = np.einsum("cmn,pn->pmc", matrices, pictures.reshape(len(pictures), -1))
    pairs = zip(relit, truth.reshape(relit.shape), strict=True)
    return float(np.mean([relative_rms(*pair) for pair in pairs]))


def scene_matrices(name: str, shape: tuple[int, ...], channels: int = 1) -> NDArray[np.float64]:
    """Return a reference scene's matrices, (C, N, N)."""
    scene = reference_scene(name, shape, channels=channels)
    return np.stack([np.asarray(scene.dense(channel), np.float64) for channel in range(channels)])


def settings_of_a_plane(**settings: Any) -> Config:
    """Return the settings of a run of one white plane, with further settings."""
    scenes = {"plane": {"kind": "plane", "surfaces": ["white"]}}
    return parse_config({"scenes": scenes, **settings}, "the test")


def run(*arguments: object, status: int = 0) -> str:
    """Run a command of rfpipe in this process and return its output; exceptions propagate."""
    result = CliRunner().invoke(app, [*map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == status, result.output
    return result.output


def contents(path: Path) -> dict[str, bytes]:
    """Bytes of all files in a folder, or of one file, by relative path."""
    files = path.rglob("*") if path.is_dir() else [path]
    return {str(file.relative_to(path)): file.read_bytes() for file in files if file.is_file()}
