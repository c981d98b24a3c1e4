"""Preconditioned conjugate gradients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rfpipe.methods.base import Float

__all__ = ["conjugate_gradients"]


def conjugate_gradients(
    normal: Callable[[Float], Float],
    goal: Float,
    scaling: Float,
    start: Float,
    tolerance: float,
    most: int,
) -> Float:
    """Solve ``normal(x) = goal``, normal symmetric and positive.

    Parameters
    ----------
    normal : callable
    goal, start : ndarray of float32, shape (n,)
    scaling : ndarray of float32, shape (n,)
        About the inverse of normal's diagonal.
    tolerance : float
        Part of the goal's norm that may be left.
    most : int
        Iterations at most.
    """
    known = start.copy()
    rest = goal - normal(start) if start.any() else goal.copy()
    step = scaling * rest
    direction = step.copy()
    energy, enough = _dot(rest, step), tolerance**2 * _dot(goal, scaling * goal)
    for _ in range(most):
        if energy <= enough:
            break
        image = normal(direction)
        curvature = _dot(direction, image)
        if curvature <= 0:  # rounding is all that is left
            break
        length = np.float32(energy / curvature)
        known += np.multiply(direction, length, out=step)
        rest -= np.multiply(image, length, out=step)
        np.multiply(scaling, rest, out=step)
        before, energy = energy, _dot(rest, step)
        direction *= np.float32(energy / before)
        direction += step
    return known


def _dot(a: Float, b: Float) -> float:
    # not BLAS: its threads change the sum's last bits, and wait for each other on a busy machine
    return float(np.einsum("i,i->", a, b, dtype=np.float64))
