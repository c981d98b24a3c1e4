"""Panoramas of the light around a scene, as weights of lights in known directions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.lights.interpolation import between, unit

_SKY_ROWS = 64
"""Rows of cells into which the pixels of a panorama are joined."""


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


def environment_weights(
    environment: ArrayLike, lights: ArrayLike, turned: float = 0.0, mirrored: bool = False
) -> Float:
    """Return the weights of lights that together light a scene as a panorama does.

    The weights depend on directions alone; `Relightable.relight_environment` also adapts them to
    the pictures. For a map of constant radiance they add up to that radiance times the solid angle
    that the lights cover, 4 pi for lights all around.

    Parameters
    ----------
    environment : array, shape (H, 2 H) or (H, 2 H, channels)
        Radiance by latitude and longitude, as in OpenEXR and USD: the upper row is +y, the centre
        +z, and +x is left of the centre, a quarter of the width from the left edge.
    lights : array, shape (lights, 3)
        Directions from the scene, of any length.
    turned : float
        Degrees by which the panorama turns to the right, about +y.
    mirrored : bool
        Whether +x is right of the centre instead, as in some other programs.

    Returns
    -------
    ndarray of float32, shape (lights, channels)
        Some may be negative. Light from farther than twice the lights' spacing from any light is
        left out, see `environment_coverage`.

    Raises
    ------
    InputError
        For other shapes, values that aren't finite, negative radiance, a light without a direction.
    """
    sky = sky_of(environment, turned, mirrored)
    weights = between(as_directions(lights)).weights(sky.directions)[0]
    return (weights.T @ sky.light).astype(np.float32)


def environment_coverage(
    environment: ArrayLike, lights: ArrayLike, turned: float = 0.0, mirrored: bool = False
) -> float:
    """Return the share of a panorama's light that comes from directions that lights cover.

    A direction is covered if it is within twice the lights' spacing of a light. The spacing is the
    angle from a light to its nearest other, at most that for nine lights in ten.

    For parameters and errors see `environment_weights`.

    Returns
    -------
    float
        0 to 1; 1 for a black panorama.
    """
    sky = sky_of(environment, turned, mirrored)
    covered = between(as_directions(lights)).covered(sky.directions)
    total = float(sky.light.sum())
    return float(sky.light[covered].sum()) / total if total else 1.0


class Sky(NamedTuple):
    """A panorama as light from D directions.

    Attributes
    ----------
    directions : ndarray of float64, shape (D, 3)
        Unit vectors from the scene.
    light : ndarray of float64, shape (D, channels)
        Radiance times solid angle.
    """

    directions: NDArray[np.float64]
    light: NDArray[np.float64]


def sky_of(environment: ArrayLike, turned: float = 0.0, mirrored: bool = False) -> Sky:
    """Return a panorama's light in cells of at most 64 rows and 128 columns.

    Each cell has one direction, the mean of its pixels' directions weighted by their light. Cells
    without light are left out. For parameters and errors see `environment_weights`.
    """
    panorama = as_panorama(environment)
    height, width, channels = panorama.shape
    up = np.pi / 2 - (np.arange(height)[:, None] + 0.5) * np.pi / height
    right = (np.arange(width) + 0.5 - height) * np.pi / height + np.radians(turned)
    side = 1 if mirrored else -1
    directions = np.stack(
        [side * np.cos(up) * np.sin(right), np.sin(up) + 0 * right, np.cos(up) * np.cos(right)],
        axis=-1,
    )
    edges = np.sin(np.pi / 2 - np.arange(height + 1) * np.pi / height)
    light = panorama * (-np.diff(edges) * np.pi / height)[:, None, None]
    step = -(-height // _SKY_ROWS)
    row, column = np.arange(height) // step, np.arange(width) // step
    cell = (row[:, None] * (column[-1] + 1) + column).ravel()

    def summed(values: NDArray[np.float64]) -> NDArray[np.float64]:
        planes = values.reshape(-1, values.shape[-1]).T
        return np.stack([np.bincount(cell, plane) for plane in planes], axis=1)

    total = light.sum(axis=-1, keepdims=True)
    cells, means = summed(light), summed(directions * total)
    lit = np.linalg.norm(means, axis=1) > 0
    if not lit.any():
        return Sky(np.array([[0.0, 0.0, 1.0]]), np.zeros((1, channels)))
    return Sky(unit(means[lit]), cells[lit])
