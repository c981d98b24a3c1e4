"""Driving a method on a known matrix, in memory and without noise unless asked for; settings."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from rfpipe.config import Config, parse_config
from rfpipe.methods import Method
from rfpipe.testing.methods import MatrixImages, MethodRun, matrix_of, run_method

__all__ = ["Acquisition", "MatrixImages", "acquire_matrix", "dense", "settings_of_a_plane"]

Acquisition = MethodRun
dense = matrix_of


def acquire_matrix(
    method: Method[Any],
    matrix: NDArray[Any],
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    tolerance: float = 1e-3,
    sigma: float = 0.0,
    seed: int = 0,
    subtract_stored: bool = True,
) -> MethodRun:
    """Acquire a matrix (M, N) or (C, M, N) level by level, with those options that a method has."""
    asked = {"tolerance": tolerance, "subtract_stored": subtract_stored}
    own = {name: asked[name] for name in method.Options.model_fields if name in asked}
    shapes = camera_shape, projector_shape
    return run_method(method, matrix, *shapes, sigma=sigma, seed=seed, **own)


def settings_of_a_plane(**others: Any) -> Config:
    """Return the settings of a run of one white plane, and others that are given."""
    scenes = {"plane": {"kind": "plane", "surfaces": ["white"]}}
    return parse_config({"scenes": scenes, **others}, "the test")
