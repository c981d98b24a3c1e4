"""The pattern that makes a scene look as wished, with all its inter-reflections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.transport.algebra import MatrixAlgebra

Float = NDArray[np.float32]

_TINY = float(np.finfo(np.float32).tiny)
_ITERATIONS = 200
_OUT_OF_REACH = 0.02  # of the wished picture's root mean square


@dataclass(frozen=True)
class Compensation:
    """A pattern, and what the scene looks like under it.

    Attributes
    ----------
    pattern : ndarray of float32, shape (*projector_shape, channels)
        Weights between 0 and 1.
    picture : ndarray of float32, shape (*camera_shape, channels)
        The scene under the pattern.
    residual : float
        Norm of what differs from the wished picture, relative to its norm.
    out_of_reach : ndarray of bool, shape (*camera_shape)
        Pixels that differ by more than 2 % of the wished picture's root mean square.
    """

    pattern: Float
    picture: Float
    residual: float
    out_of_reach: NDArray[np.bool_]


def compensation_for(transport: MatrixAlgebra, wished: Float) -> Compensation:
    """Find weights between 0 and 1 under which the scene looks most like a picture.

    That is ``min |T p - picture|`` for ``0 <= p <= 1`` in each channel, by limited-memory BFGS with
    bounds [Byrd et al. 1995], from the weights that direct light alone would take. The picture is
    planar, (channels, camera rays); see `Relightable.pattern_for`.
    """
    if (wished < 0).any():
        raise InputError("a wished picture holds negative values; light has none")
    if not (transport @ np.ones(transport.shape[2])).any():
        raise InputError("no pixel sees light of the projector: no pattern makes a picture")
    channels, camera = range(transport.channels), transport.camera_shape
    weights = np.stack([_weights(transport, index, wished[index]) for index in channels])
    reached = transport.forward(weights[None], channels)[0]
    wrong = np.sqrt(np.square(reached - wished, dtype=np.float64).mean(axis=0))
    level = float(np.sqrt(np.square(wished, dtype=np.float64).mean()))
    residual = float(np.sqrt(np.square(wrong).mean()) / max(level, _TINY))
    pattern = weights.T.reshape(*transport.projector_shape, -1)
    picture, far_off = reached.T.reshape(*camera, -1), wrong > _OUT_OF_REACH * level
    return Compensation(pattern, picture, residual, far_off.reshape(camera))


def _weights(transport: MatrixAlgebra, channel: int, wished: Float) -> Float:
    """Return the weights of one channel, (projector rays,), for a picture (camera rays,)."""
    from scipy.optimize import minimize

    def back(image: Float) -> Float:
        sent: Float = transport.adjoint(image[None, None], [channel])[0, 0]
        return sent

    def cost(pattern: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        image = transport.forward(pattern.astype(np.float32)[None, None], [channel])[0, 0]
        left = image - wished
        return float(left @ left) / scale, 2 / scale * back(left).astype(np.float64)

    scale = max(float(wished @ wished), _TINY)
    brightest = max(float(wished.max(initial=0)), _TINY)
    # the mean of what is wished where a ray's light falls
    light = back(np.ones_like(wished))
    start = np.clip(back(wished / brightest) / np.maximum(light, _TINY), 0, 1)
    found = minimize(
        cost, start, jac=True, bounds=[(0, 1)] * len(start), method="L-BFGS-B",
        options={"maxiter": _ITERATIONS},
    )  # fmt: skip
    weights: Float = found.x.astype(np.float32)
    return weights
