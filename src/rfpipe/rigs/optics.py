"""The light's way on a bench in software: from projector pixels through a scene to the camera."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.rigs.base import PatternOperator
from rfpipe.rigs.geometry import (
    Quadrilateral,
    apply_homography,
    homography,
    lie_within,
)
from rfpipe.rigs.layout import DARK, ProjectorLayout

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["OpticalPath"]

Float = NDArray[np.float32]
Double = NDArray[np.floating[Any]]

SAMPLES = 8
"""Points a side at which each camera pixel looks into the scene."""


class OpticalPath:
    """A scene between a projector and a camera that each see its rays under a homography.

    A ray is the light between a projector's patch of pixels and the camera's patch, both at the
    same point of the scene. Inter-reflection comes from the mean light of each ray's projector
    pixels. Where `direct` is known, direct light keeps the projector's own resolution: a point of
    the scene that the camera sees is lit by the one projector pixel that aims at it.

    Parameters
    ----------
    scene : PatternOperator
        Light transport over the rays, from a ray domain to itself.
    shape : tuple of int
        The ray domain, see `RayDomain`, of N rays.
    projector_shape, camera_shape : (int, int)
        Height and width in pixels.
    projector_corners, camera_corners : sequence of Quadrilateral
        Of each view's rays on the projector and on the camera.
    direct : ndarray, shape (N, C), optional
        Radiance of each ray that the light of its own projector pixels alone gives: the part of
        the scene's diagonal to show at the projector's resolution.
    ambient : float
        Radiance of other light in every camera pixel.

    Raises
    ------
    InputError
        When corners don't span a quadrilateral, or a ray has no projector pixel.
    """

    def __init__(
        self,
        scene: PatternOperator,
        shape: tuple[int, ...],
        projector_shape: tuple[int, int],
        camera_shape: tuple[int, int],
        projector_corners: Sequence[Quadrilateral],
        camera_corners: Sequence[Quadrilateral],
        direct: NDArray[Any] | None = None,
        ambient: float = 0.0,
    ) -> None:
        self.shape = shape
        self.projector_shape = projector_shape
        self.camera_shape = camera_shape
        self.channels = scene.channels
        self._scene = scene
        self._ambient = np.float32(ambient)
        self._to_projector = [homography(shape, corners) for corners in projector_corners]
        self._to_camera = [homography(shape, corners) for corners in camera_corners]
        self.layout = ProjectorLayout.within(projector_corners, shape, projector_shape)
        self._rays = self.layout.ray_of_pixel.ravel()
        self._lit = self._rays != DARK
        self._pixels = self.layout.pixels_of_ray
        if not self._pixels.all():
            raise InputError(
                f"bench: {np.count_nonzero(self._pixels == 0)} of {prod(shape)} rays have no "
                f"projector pixel; {projector_shape} pixels are too few, or the corners lie outside"
            )
        self._direct = None if direct is None else np.asarray(direct, np.float32)
        self._seen = self._sampling()

    def radiance(self, light: NDArray[Any]) -> Float:
        """Return what the camera sees.

        Parameters
        ----------
        light : ndarray, shape projector_shape
            Light of each projector pixel, 1 at most.

        Returns
        -------
        ndarray of float32, shape (*camera_shape, C)
        """
        of_pixels = np.asarray(light, np.float32).ravel()[self._lit]
        rays = self._rays[self._lit]
        of_rays = np.bincount(rays, of_pixels, prod(self.shape)) / self._pixels
        image = self._scene.apply(of_rays[None].astype(np.float32))[0]
        points = np.zeros((self._rays.size, self.channels), np.float32)
        points[self._lit] = image[rays]
        if self._direct is not None:
            beyond_mean = of_pixels - of_rays[rays].astype(np.float32)
            points[self._lit] += self._direct[rays] * beyond_mean[:, None]
        seen: Float = self._seen @ points
        return seen.reshape(*self.camera_shape, self.channels) + self._ambient

    def projector_points(self, camera_points: ArrayLike) -> Double:
        """Return where projector and camera look at one point of the scene.

        Parameters
        ----------
        camera_points : array_like, shape (..., 2)
            (x, y) from the corner of the camera's picture, as in `Quadrilateral`.

        Returns
        -------
        ndarray of float64, shape (..., 2)
            (x, y) from the corner of the projector's picture; NaN where the camera sees no ray.
        """
        points = np.asarray(camera_points, np.float64)
        found = np.full(points.shape, np.nan)
        for to_camera, to_projector in zip(self._to_camera, self._to_projector, strict=True):
            place = apply_homography(np.linalg.inv(to_camera), points)
            inside = lie_within(place, RayDomain(self.shape).image_shape)
            found[inside] = apply_homography(to_projector, place[inside])
        return found

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the picture."""
        describe = getattr(self._scene, "describe", None)
        return {
            "scene": describe() if describe else type(self._scene).__name__,
            "layout": self.layout.describe(),
            "to_camera": fingerprint(np.array(self._to_camera)),
            "camera_shape": list(self.camera_shape),
            "direct": None if self._direct is None else fingerprint(self._direct),
            "ambient": float(self._ambient),
        }

    def _sampling(self) -> csr_array[Any]:
        """Return the mean of the projector pixels' points that each camera pixel looks at."""
        from scipy.sparse import csr_array, vstack

        height, width = self.camera_shape
        columns = self.projector_shape[1]
        steps = (np.arange(SAMPLES) + 0.5) / SAMPLES
        x = (np.arange(width)[:, None] + steps).ravel()
        rows = []
        for row in range(height):
            points = np.stack(np.meshgrid(x, row + steps), axis=-1)
            target = self.projector_points(points).reshape(SAMPLES, width, SAMPLES, 2)
            pixel = np.broadcast_to(np.arange(width)[None, :, None], target.shape[:-1])
            inside = lie_within(target, self.projector_shape)
            u, v = np.floor(target[inside]).astype(np.int64).T
            weights = np.full(u.size, 1 / SAMPLES**2, np.float32)
            extent = (width, prod(self.projector_shape))
            rows.append(csr_array((weights, (pixel[inside], v * columns + u)), shape=extent))
        return csr_array(vstack(rows, "csr"))
