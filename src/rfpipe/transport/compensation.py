"""Projector compensation: the pattern under which a scene looks like a given picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Float
from rfpipe.errors import InputError
from rfpipe.transport.algebra import MatrixAlgebra

_ITERATIONS = 200
_LIMIT = 0.02  # error of a pixel in reach, relative to the root mean square of the picture


@dataclass(frozen=True)
class Compensation:
    """A pattern, and the picture of the scene under it.

    Attributes
    ----------
    pattern : ndarray of float32, shape (*projector_shape, channels)
        Weights between 0 and 1.
    picture : ndarray of float32, shape (*camera_shape, channels)
        The scene under the pattern.
    residual : float
        Norm of the difference from the given picture, relative to its norm.
    out_of_reach : ndarray of bool, shape (*camera_shape)
        Pixels that differ by more than 2 % of the given picture's root mean square.
    """

    pattern: Float
    picture: Float
    residual: float
    out_of_reach: NDArray[np.bool_]


def compensation_for(transport: MatrixAlgebra, target: Float) -> Compensation:
    """Minimize ``|T p - picture|`` for weights ``0 <= p <= 1`` in each channel.

    The solver is limited-memory BFGS with bounds [Byrd et al. 1995], from the solution for direct
    light. The target picture is planar, (channels, camera rays); see `Relightable.pattern_for`.
    """
    if (target < 0).any():
        raise InputError("the picture has negative values; radiance is 0 or more")
    if not (transport @ np.ones(transport.shape[2])).any():
        raise InputError(
            "no camera pixel receives light from the projector; no pattern can make a picture"
        )
    channels, camera = range(transport.channels), transport.camera_shape
    weights = np.stack([_weights(transport, index, target[index]) for index in channels])
    image = transport.forward(weights[None], channels)[0]
    error = np.sqrt(np.square(image - target, dtype=np.float64).mean(axis=0))
    level = float(np.sqrt(np.square(target, dtype=np.float64).mean()))
    residual = float(np.sqrt(np.square(error).mean()) / max(level, TINY))
    pattern = weights.T.reshape(*transport.projector_shape, -1)
    picture, out_of_reach = image.T.reshape(*camera, -1), error > _LIMIT * level
    return Compensation(pattern, picture, residual, out_of_reach.reshape(camera))


def _weights(transport: MatrixAlgebra, channel: int, target: Float) -> Float:
    """Return the weights of one channel, (projector rays,), for a picture (camera rays,)."""
    from scipy.optimize import minimize

    def adjoint(image: Float) -> Float:
        dual: Float = transport.adjoint(image[None, None], [channel])[0, 0]
        return dual

    def cost(pattern: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        image = transport.forward(pattern.astype(np.float32)[None, None], [channel])[0, 0]
        residual = image - target
        gradient = 2 / scale * adjoint(residual).astype(np.float64)
        return float(residual @ residual) / scale, gradient

    scale = max(float(target @ target), TINY)
    brightest = max(float(target.max(initial=0)), TINY)
    # start: mean of the target over the camera pixels that a projector ray lights
    light = adjoint(np.ones_like(target))
    start = np.clip(adjoint(target / brightest) / np.maximum(light, TINY), 0, 1)
    solution = minimize(
        cost, start, jac=True, bounds=[(0, 1)] * len(start), method="L-BFGS-B",
        options={"maxiter": _ITERATIONS},
    )  # fmt: skip
    weights: Float = solution.x.astype(np.float32)
    return weights
