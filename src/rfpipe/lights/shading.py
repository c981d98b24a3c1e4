"""Lambertian shading of each pixel, fitted robustly to pictures of single lights.

A matt surface of normal ``n`` and albedo ``a`` under a light in direction ``l`` has the radiance::

    y(l) = max(b . l, 0),    b = a n

Photometric stereo [R. J. Woodham, Photometric method for determining surface orientation from
multiple images, Optical Engineering 19 (1980)] solves it for ``b`` by least squares. Lights behind
the surface (``b . l <= 0``) are left out. Each of the others has the weight of a Cauchy
distribution, ``1 / (1 + (residual / c s)^2)``, where ``s`` is the median absolute residual: cast
shadows and highlights, which are far from the fit, have little influence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float

_ROUNDS = 8
"""Rounds of reweighted least squares."""

_RIDGE = 1e-3
"""Added to the normal matrix, whose trace is the number of lights, so that it is invertible."""


class Shading(NamedTuple):
    """Lambertian fits of P pixels.

    Attributes
    ----------
    vectors : ndarray of float32, shape (P, 3)
        Albedo times normal; 0 for black pixels.
    uncertainty : ndarray of float32, shape (P,)
        Standard deviation of the normal's direction, radians, at most pi / 2.
    lit : ndarray of int32, shape (P,)
        Number of lights in front of the surface that are not rejected as shadow or highlight.
    """

    vectors: Float
    uncertainty: Float
    lit: NDArray[np.int32]


def fit_shading(
    pictures: NDArray[np.floating], directions: NDArray[np.floating], cutoff: float = 2.0
) -> Shading:
    """Fit Lambertian shading to pictures of single lights.

    Parameters
    ----------
    pictures : ndarray, shape (L, P)
        Radiance of P pixels under each of L lights.
    directions : ndarray, shape (L, 3)
        Unit vectors towards the lights.
    cutoff : float
        ``c``, in median absolute residuals.
    """
    by_pixel = np.ascontiguousarray(np.asarray(pictures, np.float32).T)
    return Shading(*_fit(by_pixel, np.ascontiguousarray(directions, np.float64), cutoff))


def shaded(vectors: NDArray[np.floating], directions: NDArray[np.floating]) -> Double:
    """Return ``max(b . l, 0)`` of vectors (P, 3) under directions (D, 3), shape (D, P)."""
    return np.maximum(np.asarray(directions, np.float64) @ np.asarray(vectors, np.float64).T, 0)


@njit(cache=True, nogil=True)
def _fit(pictures, directions, cutoff):  # type: ignore[no-untyped-def]
    """Fit each row of pictures (P, L); directions are (L, 3)."""
    pixels, count = pictures.shape
    vectors = np.zeros((pixels, 3), np.float32)
    uncertainty = np.full(pixels, np.pi / 2, np.float32)
    lit = np.zeros(pixels, np.int32)
    weights, residual = np.empty(count), np.empty(count)
    for pixel in range(pixels):
        y = pictures[pixel].astype(np.float64)
        top = np.abs(y).max()
        if top == 0:
            continue
        weights[:] = 1
        for _ in range(_ROUNDS + 1):
            inverse, moment = _normal_equations(y, weights, directions)
            b = inverse @ moment
            for light in range(count):
                residual[light] = y[light] - max(_along(directions, light, b), 0)
            scale = cutoff * (np.median(np.abs(residual)) + 0.005 * top)
            for light in range(count):
                facing = _along(directions, light, b) > 0
                weights[light] = facing / (1 + (residual[light] / scale) ** 2)
        length = np.sqrt(np.dot(b, b))
        used = np.sum(weights > 0.5)
        vectors[pixel], lit[pixel] = b, used
        if used < 3 or length == 0:
            continue
        noise = np.sum(weights * residual**2) / max(used - 3, 1) + (0.5 / 255 * top) ** 2
        across = np.trace(inverse) - np.dot(b, inverse @ b) / length**2
        uncertainty[pixel] = min(np.sqrt(noise * across) / length, np.pi / 2)
    return vectors, uncertainty, lit


@njit(cache=True, nogil=True)
def _along(directions, light, b):  # type: ignore[no-untyped-def]
    """Return ``l . b`` of one light."""
    x = directions[light]
    return x[0] * b[0] + x[1] * b[1] + x[2] * b[2]


@njit(cache=True, nogil=True)
def _normal_equations(y, weights, directions):  # type: ignore[no-untyped-def]
    """Return the inverse of the normal matrix, and the right side, of weighted least squares."""
    a00 = a11 = a22 = _RIDGE
    a01 = a02 = a12 = 0.0
    moment = np.zeros(3)
    for light in range(len(y)):
        w = weights[light]
        x0, x1, x2 = directions[light, 0], directions[light, 1], directions[light, 2]
        a00 += w * x0 * x0
        a11 += w * x1 * x1
        a22 += w * x2 * x2
        a01 += w * x0 * x1
        a02 += w * x0 * x2
        a12 += w * x1 * x2
        moment[0] += w * y[light] * x0
        moment[1] += w * y[light] * x1
        moment[2] += w * y[light] * x2
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    inverse = np.empty((3, 3))
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = c00, c01, c02
    inverse[1, 0], inverse[1, 1], inverse[1, 2] = c01, c11, c12
    inverse[2, 0], inverse[2, 1], inverse[2, 2] = c02, c12, c22
    return inverse / determinant, moment
