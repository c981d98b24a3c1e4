"""Preconditioned conjugate gradients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rfpipe.methods.base import Float


def conjugate_gradients(
    normal: Callable[[Float], Float],
    goal: Float,
    precondition: Callable[[Float], Float],
    start: Float | None,
    tolerance: float,
    most: int,
    *,
    weighed: bool = True,
) -> Float:
    """Solve ``normal(x) = goal``, normal symmetric and positive.

    Parameters
    ----------
    normal : callable
    goal : ndarray of float32
    precondition : callable
        About the inverse of normal.
    start : ndarray of float32 or None
        None for 0.
    tolerance : float
        Part of the goal's norm that may be left.
    most : int
        Iterations at most.
    weighed : bool
        Whether the norm is that which `precondition` makes, or the plain one.
    """
    solution = np.zeros_like(goal) if start is None else start
    rest = goal if start is None else goal - normal(start)
    step = direction = precondition(rest)
    energy = _dot(rest, step)
    enough = tolerance**2 * _dot(goal, precondition(goal) if weighed else goal)
    for _ in range(most):
        if energy <= 0 or (energy if weighed else _dot(rest, rest)) <= enough:
            break
        image = normal(direction)
        curvature = _dot(direction, image)
        if curvature <= 0:  # rounding is all that is left
            break
        length = np.float32(energy / curvature)
        solution, rest = solution + length * direction, rest - length * image
        step = precondition(rest)
        before, energy = energy, _dot(rest, step)
        direction = step + np.float32(energy / before) * direction
    return solution


def _dot(a: Float, b: Float) -> float:
    # not BLAS: its threads change the sum's last bits, and wait for each other on a busy machine
    axes = "ij"[: a.ndim]
    return float(np.einsum(f"{axes},{axes}->", a, b, dtype=np.float64))
