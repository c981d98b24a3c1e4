"""Conjugate gradients, for the fits of all models.

M. R. Hestenes and E. Stiefel, *Methods of conjugate gradients for solving linear systems*, J. Res.
Natl. Bur. Stand. 49 (1952); with a preconditioner as in Y. Saad, *Iterative Methods for Sparse
Linear Systems*, 2nd ed., SIAM 2003, algorithm 9.1.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rfpipe.array_types import Float


def conjugate_gradients(
    normal: Callable[[Float], Float],
    target: Float,
    precondition: Callable[[Float], Float],
    start: Float | None,
    tolerance: float,
    iterations: int,
    *,
    preconditioned_norm: bool = True,
) -> Float:
    """Solve ``normal(x) = target`` by preconditioned conjugate gradients.

    Parameters
    ----------
    normal : callable
        Product with a symmetric, positive definite matrix.
    target : ndarray of float32
        Right-hand side.
    precondition : callable
        Product with an approximate inverse of that matrix.
    start : ndarray of float32, optional
        First estimate of x; zeros by default.
    tolerance : float
        Norm of the residual at which to stop, relative to the norm of `target`.
    iterations : int
        Largest number of iterations.
    preconditioned_norm : bool
        Measure both norms with the preconditioner, as ``sqrt(r^T precondition(r))``.
    """
    solution = np.zeros_like(target) if start is None else start.copy()
    residual = target.copy() if start is None else target - normal(start)
    step = precondition(residual)
    direction = step.copy()
    energy = _dot(residual, step)
    end = tolerance**2 * _dot(target, precondition(target) if preconditioned_norm else target)
    for _ in range(iterations):
        if energy <= 0 or (energy if preconditioned_norm else _dot(residual, residual)) <= end:
            break
        image = normal(direction)
        curvature = _dot(direction, image)
        if curvature <= 0:  # the residual is rounding
            break
        length = np.float32(energy / curvature)
        solution += length * direction
        residual -= length * image
        step = precondition(residual)
        previous, energy = energy, _dot(residual, step)
        direction *= np.float32(energy / previous)
        direction += step
    return solution


def _dot(a: Float, b: Float) -> float:
    # not BLAS: its threads change the sum's last bits, and wait for each other on a busy machine
    axes = "ij"[: a.ndim]
    return float(np.einsum(f"{axes},{axes}->", a, b, dtype=np.float64))
