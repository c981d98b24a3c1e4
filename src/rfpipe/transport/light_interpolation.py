"""Relighting a transport of single lights with light from directions between them.

See `rfpipe.lights.interpolation` for the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np

from rfpipe.array_types import Double, Float, Index
from rfpipe.environment import Sky
from rfpipe.lights.interpolation import MOST_LIGHTS, Interpolation, between, interpolate
from rfpipe.lights.shading import fit_shading, shaded
from rfpipe.transport.algebra import MEMORY_BUDGET, MatrixAlgebra

_SAMPLES = 1024
"""Values of each picture on which the models are compared."""

_FEW_DIRECTIONS = 64
"""Up to this number of directions, shading is summed for each pixel; beyond, read from a table."""

_TABLE_ROWS = 91
"""Rows of the table of shading, normals from pole to pole."""


@dataclass(frozen=True, eq=False)
class LightInterpolation:
    """Interpolation between the lights of a transport.

    Attributes
    ----------
    interpolation : Interpolation
    vectors : ndarray of float32, shape (channels, camera rays, 3), or None
        Albedo times normal; None if the interpolation has no Lambertian trend.
    """

    interpolation: Interpolation
    vectors: Float | None

    def relight(self, transport: MatrixAlgebra, sky: Sky) -> Float:
        """Return the picture (*camera_shape, channels) under the light of a sky."""
        weights, share, shading = self.interpolation.weights(sky.directions)
        colours = range(transport.channels)
        planes = (weights.T @ sky.light).T.astype(np.float32)
        if len(colours) == 1:
            image = transport.forward(planes[:, None], colours)[:, 0]
        else:
            planar = np.broadcast_to(planes, (len(colours), planes.shape[1]))
            image = transport.forward(np.ascontiguousarray(planar)[None], colours)[0]
        if self.vectors is not None:
            directions = np.vstack([sky.directions, self.interpolation.directions])
            light = np.vstack([share[:, None] * sky.light, -(shading.T @ sky.light)])
            strength = np.abs(light).max(axis=1)
            used = strength > 1e-9 * max(float(strength.max()), 1e-30)
            shading = _shading_image(self.vectors, directions[used], light[used])
            image = (image + shading).astype(np.float32)
        positive = np.maximum(image, 0)
        return np.moveaxis(positive, 0, -1).reshape(*transport.camera_shape, len(positive))

    def pictures_from(
        self, directions: Double, pictures: Float, rays: Index | slice = slice(None)
    ) -> Double:
        """Return the radiance of some rays under one light from each of several directions.

        Parameters
        ----------
        directions : ndarray of float64, shape (D, 3)
            Unit vectors.
        pictures : ndarray of float32, shape (channels, rays, lights)
            Radiance of these rays under the lights.
        rays
            Numbers of the rays.

        Returns
        -------
        ndarray of float64, shape (channels, rays, D)
        """
        weights, share, shading = self.interpolation.weights(directions)
        radiance: Double = pictures @ weights.T
        if self.vectors is not None:
            lights = self.interpolation.directions
            for channel, vectors in enumerate(self.vectors[:, rays]):
                radiance[channel] += (share[:, None] * shaded(vectors, directions)).T
                radiance[channel] -= shaded(vectors, lights).T @ shading.T
        return np.maximum(radiance, 0)


def interpolate_lights(transport: MatrixAlgebra, directions: Float) -> LightInterpolation:
    """Choose an interpolation between the lights of a transport by its pictures.

    Parameters
    ----------
    transport : MatrixAlgebra
        The projector's rays are single lights.
    directions : ndarray of float32, shape (lights, 3)

    Notes
    -----
    Models with a Lambertian trend are fitted to all pixels. They are left out if all pictures take
    more than the memory budget.
    """
    lights = len(directions)
    if lights > MOST_LIGHTS:
        return LightInterpolation(between(directions), None)
    white = np.ones((1, 1, lights), np.float32).repeat(transport.channels, axis=1)
    bright = np.flatnonzero(transport.forward(white, range(transport.channels))[0].any(axis=0))
    if not len(bright):
        return LightInterpolation(between(directions), None)
    chosen = np.linspace(0, len(bright) - 1, -(-_SAMPLES // transport.channels)).astype(int)
    rays = bright[np.unique(chosen)]
    samples = np.moveaxis(transport.toarray(rays), -1, 0).reshape(lights, -1)
    fits_memory = 4 * prod(transport.shape) <= MEMORY_BUDGET
    interpolation = interpolate(samples, directions, with_shading=fits_memory)
    if not interpolation.has_shading:
        return LightInterpolation(interpolation, None)
    vectors = [
        fit_shading(pictures.T, interpolation.directions).vectors
        for pictures in transport.toarray()
    ]
    return LightInterpolation(interpolation, np.stack(vectors))


def _shading_image(vectors: Float, directions: Double, light: Double) -> Double:
    """Return Lambertian shading (channels, rays) of vectors (C, rays, 3) under lights (D, C')."""
    channels = np.broadcast_to(np.arange(len(vectors)), max(len(vectors), light.shape[1]))
    lit = np.broadcast_to(np.arange(light.shape[1]), len(channels))
    pairs = zip(channels, lit, strict=True)
    if len(directions) <= _FEW_DIRECTIONS:
        return np.stack([light[:, k] @ shaded(vectors[c], directions) for c, k in pairs])
    table = _table(directions, light)
    return np.stack([_interpolate_table(vectors[c], table[..., k]) for c, k in pairs])


def _table(directions: Double, light: Double) -> Double:
    """Return the shading of albedo 1 by latitude and longitude of the normal, (H, W, channels)."""
    up = np.linspace(np.pi / 2, -np.pi / 2, _TABLE_ROWS)[:, None]
    around = np.linspace(-np.pi, np.pi, 2 * _TABLE_ROWS - 1)
    normals = np.stack(
        [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up) + 0 * around], axis=-1
    )
    rows = [shaded(row, directions).T @ light for row in normals]
    return np.stack(rows)


def _interpolate_table(vectors: Float, table: Double) -> Double:
    """Interpolate a table (H, W) at the directions of vectors (rays, 3), times their length."""
    from scipy.ndimage import map_coordinates

    b = vectors.astype(np.float64)
    length = np.linalg.norm(b, axis=1)
    up = np.arcsin(np.clip(b[:, 2] / np.maximum(length, 1e-30), -1, 1))
    around = np.arctan2(b[:, 1], b[:, 0])
    step = np.pi / (_TABLE_ROWS - 1)
    places = np.stack([(np.pi / 2 - up) / step, (around + np.pi) / step])
    values: Double = length * map_coordinates(table, places, order=1, mode="nearest")
    return values
