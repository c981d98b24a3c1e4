"""What lights make of a panorama of the light around: for transports of one light at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

Float = NDArray[np.float32]


def read_lights(path: str | Path) -> Float:
    """Read the directions of lights from a file, (lights, 3).

    Parameters
    ----------
    path : path
        Text, the last three words of each line being numbers, as in the ``.lp`` files of RTI, whose
        first line is the number of lights.

    Raises
    ------
    InputError
        If the file isn't there, a line has no three numbers, or the number is another one.
    """
    try:
        text = Path(path).read_text("utf-8")
        lines = [line.split() for line in text.splitlines() if line.strip()]
        counted = [int(line[0]) for line in lines[:1] if len(line) == 1]
        lights = np.array([line[-3:] for line in lines[len(counted) :]], np.float32).reshape(-1, 3)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no lights, three numbers a line: {error}") from None
    if counted and counted[0] != len(lights):
        raise InputError(f"{path}: its first line counts {counted[0]} lights, it has {len(lights)}")
    return lights


def environment_weights(
    environment: NDArray[Any], lights: NDArray[Any], turned: float = 0.0
) -> Float:
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

    panorama, lights = np.asarray(environment, np.float64), np.asarray(lights, np.float64)
    height, width = panorama.shape[:2] if panorama.ndim in (2, 3) else (0, 0)
    if not height or width != 2 * height:
        raise InputError(
            f"a panorama by latitude and longitude is twice as wide as high, got {panorama.shape}"
        )
    if lights.ndim != 2 or lights.shape[1] != 3 or not len(lights):
        raise InputError(f"lights have the shape (lights, 3), got {lights.shape}")
    length = np.linalg.norm(lights, axis=1, keepdims=True)
    if not (np.isfinite(lights).all() and (length > 0).all()):
        raise InputError("a light has no direction: its numbers are 0, or not finite")
    if not np.isfinite(panorama).all() or (panorama < 0).any():
        raise InputError("the panorama holds NaN, infinite or negative radiance")
    up = np.pi / 2 - (np.arange(height)[:, None] + 0.5) * np.pi / height
    right = (np.arange(width) + 0.5 - height) * np.pi / height + np.radians(turned)
    way = np.stack(
        [np.cos(up) * np.sin(right), np.sin(up) + 0 * right, np.cos(up) * np.cos(right)], axis=-1
    )
    nearest = cKDTree(lights / length).query(way.reshape(-1, 3))[1]
    edges = np.sin(np.pi / 2 - np.arange(height + 1) * np.pi / height)
    angle = np.repeat(-np.diff(edges) * np.pi / height, width)
    light = panorama.reshape(height * width, -1) * angle[:, None]
    weights = [np.bincount(nearest, plane, len(lights)) for plane in light.T]
    return np.stack(weights, axis=1).astype(np.float32)
