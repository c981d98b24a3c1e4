"""Noise of pictures, estimated from combinations of them that should vanish.

Patterns and complements add up to white, repeated patterns are alike: with patterns P (K, N) and
ambient light, every ``a`` of the left null space, ``a^T [P, 1] = 0``, makes ``a^T y`` noise alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.fitting.series import Series

# Eigenvalues below this part of the largest one are zero; so is noise below this part of the light.
_ROUNDING = 1e-9
_EXACT = 1e-6
# Side in camera rays of the squares over which the estimate is averaged.
_SIDE = 5


def with_estimated_noise(series: Series) -> Series:
    """Raise the variance of pictures to what their dependent combinations show.

    Without dependent patterns, or where the combinations vanish as exactly as float32 does, the
    series is returned as it is.
    """
    combinations = vanishing_combinations(series.patterns)
    if not combinations.shape[1] or not series.known.any():
        return series
    residual = np.tensordot(combinations.T, series.radiance, 1)
    power = np.square(residual, dtype=np.float64).mean(axis=0)
    if power[:, series.known].max() <= np.square(_EXACT * np.abs(series.radiance).max()):
        return series
    noise = _averaged(power, series.known, series.camera_shape)
    return replace(series, variance=np.maximum(series.variance, noise))


def vanishing_combinations(patterns: Float) -> NDArray[np.float64]:
    """Return an orthonormal basis of the combinations of pictures that contain no light.

    Parameters
    ----------
    patterns : ndarray of float32, shape (K, C, N)

    Returns
    -------
    ndarray of float64, shape (K, combinations)
    """
    rows = patterns.reshape(len(patterns), -1).astype(np.float64)
    rows /= max(float(np.linalg.norm(rows, axis=1).max()), np.finfo(np.float64).tiny)
    gram = rows @ rows.T + 1.0  # ambient light is one more ray
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors[:, values < _ROUNDING * values[-1]])


def _averaged(
    power: NDArray[np.float64], known: NDArray[np.bool_], camera_shape: tuple[int, ...]
) -> Float:
    """Average over squares of known camera rays, (C, M)."""
    from scipy.ndimage import uniform_filter

    stack = RayDomain(camera_shape).stack_shape
    size = (1, _SIDE, _SIDE)
    weight = uniform_filter(known.reshape(stack).astype(np.float64), size, mode="constant")
    noise = [
        uniform_filter(np.where(known, plane, 0).reshape(stack), size, mode="constant")
        / np.maximum(weight, 1e-9)
        for plane in power
    ]
    averaged = np.stack(noise).reshape(power.shape)
    return np.where(known, averaged, np.inf).astype(np.float32)
