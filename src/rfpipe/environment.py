"""What lights make of a panorama of the light around: for transports of one light at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError

Float = NDArray[np.float32]


def as_directions(lights: ArrayLike, name: str = "lights", count: int | None = None) -> Float:
    """Return directions of `count` lights, of any length, as (lights, 3).

    InputError, by `name`, for another shape or number, and a light without a direction.
    """
    directions = np.asarray(lights, np.float32)
    if directions.ndim != 2 or directions.shape[1] != 3 or not len(directions):
        raise InputError(f"{name}: an array {directions.shape}; expected directions, (lights, 3)")
    if not (np.isfinite(directions).all() and directions.any(axis=1).all()):
        raise InputError(f"{name}: one has no direction: its numbers are 0, or not finite")
    if count not in (None, len(directions)):
        raise InputError(f"{name}: {len(directions)} directions of lights for {count} lights")
    return directions


def as_panorama(environment: ArrayLike, name: str = "the panorama") -> NDArray[np.float64]:
    """Return radiance by latitude and longitude, (H, 2 H, channels).

    InputError, by `name`, for other shapes, values that aren't finite and negative radiance.
    """
    panorama = np.asarray(environment, np.float64)
    shape = panorama.shape
    if panorama.ndim not in (2, 3) or not panorama.size or shape[1] != 2 * shape[0]:
        raise InputError(
            f"{name}: an array {shape}; by latitude and longitude it is twice as wide as high"
        )
    if not np.isfinite(panorama).all() or (panorama < 0).any():
        raise InputError(f"{name}: holds NaN, infinite or negative radiance")
    return panorama.reshape(*shape[:2], -1)


def environment_weights(environment: ArrayLike, lights: ArrayLike, turned: float = 0.0) -> Float:
    """Return the weights of lights that stand for a panorama, (lights, channels).

    Each light takes the panorama's light from all directions to which it is the nearest, so that
    all weights add up to the integral of radiance over the sphere.

    Parameters
    ----------
    environment : array, shape (H, 2 H) or (H, 2 H, channels)
        Radiance by latitude and longitude: the upper row is +y, the middle +z, its right +x.
    lights : array, shape (lights, 3)
        Directions from the scene, of any length.
    turned : float
        Degrees by which the panorama turns to the right.

    Raises
    ------
    InputError
        For other shapes, values that aren't finite, negative radiance, a light without a direction.
    """
    from scipy.spatial import cKDTree

    panorama, directions = as_panorama(environment), as_directions(lights).astype(np.float64)
    height, width, channels = panorama.shape
    up = np.pi / 2 - (np.arange(height)[:, None] + 0.5) * np.pi / height
    right = (np.arange(width) + 0.5 - height) * np.pi / height + np.radians(turned)
    way = np.stack(
        [np.cos(up) * np.sin(right), np.sin(up) + 0 * right, np.cos(up) * np.cos(right)], axis=-1
    )
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    nearest = cKDTree(directions).query(way.reshape(-1, 3))[1]
    edges = np.sin(np.pi / 2 - np.arange(height + 1) * np.pi / height)
    angle = np.repeat(-np.diff(edges) * np.pi / height, width)
    light = panorama.reshape(-1, channels) * angle[:, None]
    weights = [np.bincount(nearest, plane, len(directions)) for plane in light.T]
    return np.stack(weights, axis=1).astype(np.float32)
