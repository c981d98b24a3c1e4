"""A scene whose light transport is known as a matrix."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.base import Scene
from rfpipe.transport.operators import Transportish, as_pattern_operator

__all__ = ["MatrixScene"]


class MatrixScene(Scene):
    """Light transport that is given, such as one that another program measured or rendered.

    Parameters
    ----------
    matrix : Transportish
        As `rfpipe.OperatorRig` takes it.
    camera_shape, projector_shape : tuple of int
    brightest : float, optional
        Radiance of the brightest camera ray under floodlight, above 0, to which the matrix is
        scaled; None leaves it as it stands.

    Raises
    ------
    InputError
        When the matrix doesn't fit the shapes, holds an entry that is negative or not finite, or
        is black and to be scaled.
    """

    def __init__(
        self,
        matrix: Transportish,
        camera_shape: Sequence[int],
        projector_shape: Sequence[int],
        brightest: float | None = None,
    ) -> None:
        camera, projector = tuple(camera_shape), tuple(projector_shape)
        self._operator = as_pattern_operator(matrix, prod(camera), prod(projector))
        super().__init__(camera, projector, self._operator.channels)
        self._scale = np.float32(1)
        if brightest is not None:
            largest = float(self.apply(np.ones((1, prod(projector)), np.float32)).max())
            if not largest > 0:
                raise InputError(
                    "the matrix has no light under floodlight; brightest can't be reached. Set it "
                    "to null"
                )
            self._scale = np.float32(brightest / largest)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, M, C) under patterns (B, N) or (B, *projector_shape)."""
        weights = np.asarray(patterns, np.float32)
        rays = prod(self.projector_shape)
        if weights.ndim < 2 or prod(weights.shape[1:]) != rays:
            raise InputError(
                f"patterns of shape {weights.shape}: expected (patterns, {rays}) or (patterns, "
                f"{', '.join(map(str, self.projector_shape))})"
            )
        if not np.isfinite(weights).all():
            raise InputError("patterns: every weight should be finite, found NaN or infinity")
        images = self._operator.apply(weights.reshape(len(weights), rays))
        # a stored transport rounds, below zero, too
        light: NDArray[np.float32] = np.maximum(np.asarray(images, np.float32), 0) * self._scale
        return light

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        describe = getattr(self._operator, "describe", None)
        return {
            "kind": "matrix",
            "operator": describe() if describe else type(self._operator).__name__,
            "scale": float(self._scale),
        }
