"""The error of a prediction, from held-out pictures that were each taken twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float

__all__ = ["Estimate", "estimate"]


@dataclass(frozen=True)
class Estimate:
    """Errors relative to the norm of a held-out picture, their root mean square over pictures.

    Attributes
    ----------
    error : float
        Of the prediction.
    dark : float
        Of it, the part on pixels that the projector leaves dark, where light is indirect.
    indirect : float
        All light on those pixels, in the same unit.
    """

    error: float
    dark: float
    indirect: float


def estimate(predicted: Float, taken: Float, lit: NDArray[np.bool_]) -> Estimate:
    """Compare predicted with held-out pictures.

    Two pictures of one pattern have independent noise, so that the mean product of what is wrong
    with either is the squared error of the prediction alone, whatever the camera's noise may be.

    Parameters
    ----------
    predicted : ndarray of float32, shape (2 K, C, N)
        Pictures ``2 k`` and ``2 k + 1`` are of one pattern.
    taken : ndarray of float32, shape (2 K, C, N)
    lit : ndarray of bool, shape (2 K, N)
    """
    wrong = (predicted.astype(np.float64) - taken)[:, :]
    squares = []
    for first in range(0, len(taken), 2):
        dark = ~lit[first]
        product = (wrong[first] * wrong[first + 1]).sum(axis=0)
        light = (taken[first].astype(np.float64) * taken[first + 1]).sum(axis=0)
        energy = max(float(light.sum()), np.finfo(np.float64).tiny)
        parts = (product.sum(), product[dark].sum(), light[dark].sum())
        squares.append([max(float(part), 0.0) / energy for part in parts])
    error, dark_part, indirect = np.sqrt(np.mean(squares, axis=0)).tolist()
    return Estimate(error, dark_part, indirect)
