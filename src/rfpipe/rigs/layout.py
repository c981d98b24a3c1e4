"""Which ray of its domain each pixel of a projector belongs to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain, ray_shape
from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.rigs.geometry import (
    Quadrilateral,
    apply_homography,
    centred_corners,
    homography,
    lie_within,
    pixel_middles,
)

Float = NDArray[np.float32]

DARK = -1
"""What stands in a layout for a pixel that belongs to no ray."""


@dataclass(frozen=True, eq=False)
class ProjectorLayout:
    """Which ray each projector pixel belongs to: a pattern over the rays becomes a picture.

    Parameters
    ----------
    shape : tuple of int
        The ray domain, see `RayDomain`, of N rays.
    ray_of_pixel : ndarray of int32, shape (Hp, Wp)
        Index of the ray, in row-major order, that each pixel shows; `DARK` where it shows none.

    Raises
    ------
    InputError
        When the domain isn't one, or an index is out of range.
    """

    shape: tuple[int, ...]
    ray_of_pixel: NDArray[np.int32]

    def __post_init__(self) -> None:
        shape = ray_shape(self.shape, "a layout's ray domain")
        rays = np.ascontiguousarray(self.ray_of_pixel)
        if rays.ndim != 2 or rays.dtype.kind not in "iu" or not rays.size:
            raise InputError(
                f"layout: ray_of_pixel is {rays.dtype} {rays.shape}; expected int32 (Hp, Wp)"
            )
        if rays.min() < DARK or rays.max() >= prod(shape):
            raise InputError(
                f"layout: ray_of_pixel holds {rays.min()} to {rays.max()}; expected {DARK} (dark) "
                f"to {prod(shape) - 1}, the last ray of {shape}"
            )
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "ray_of_pixel", rays.astype(np.int32, copy=False))

    @classmethod
    def grid(cls, display_shape: tuple[int, int], domain_shape: tuple[int, ...]) -> Self:
        """Return the layout of a centred grid: each ray a square of as many whole pixels as fit.

        Parameters
        ----------
        display_shape : (int, int)
            Height and width of the projector's picture in pixels.
        domain_shape : (int, int)
            Height and width of the ray domain, at most those of the picture.

        Raises
        ------
        InputError
            When the domain is larger than the picture, or has views, whose places only a
            calibration knows.
        """
        if RayDomain(domain_shape).is_stack:
            raise InputError(
                f"layout: the ray domain {domain_shape} has views; a grid lays out one image "
                "(H, W). Where the views lie on the projector is found by calibration"
            )
        side = min(extent // rays for extent, rays in zip(display_shape, domain_shape, strict=True))
        if side < 1:
            raise InputError(
                f"layout: {domain_shape} rays don't fit into a picture of {display_shape} pixels; "
                "a ray needs at least one pixel"
            )
        return cls.within(centred_corners(domain_shape, display_shape), domain_shape, display_shape)

    @classmethod
    def within(
        cls,
        corners: Sequence[Quadrilateral],
        shape: tuple[int, ...],
        display_shape: tuple[int, int],
    ) -> Self:
        """Return the layout of rectified views: a pixel shows the ray that its middle lies on.

        Parameters
        ----------
        corners : sequence of Quadrilateral
            Of each view on the projector.
        shape : tuple of int
            The ray domain.
        display_shape : (int, int)
            Of the projector in pixels.
        """
        rays = np.full(display_shape, DARK, np.int32)
        middles = pixel_middles(display_shape)
        height, width = RayDomain(shape).image_shape
        for view, quad in enumerate(corners):
            # a grid's edges fall on whole numbers, which must not depend on rounding
            place = apply_homography(np.linalg.inv(homography(shape, quad)), middles).round(9)
            inside = lie_within(place, (height, width))
            x, y = np.floor(place[inside]).astype(np.int32).T
            rays[inside] = (view * height + y) * width + x
        return cls(shape, rays)

    @property
    def display_shape(self) -> tuple[int, int]:
        """Height and width of the projector's picture in pixels."""
        height, width = self.ray_of_pixel.shape
        return height, width

    @property
    def pixels_of_ray(self) -> NDArray[np.int64]:
        """Number of projector pixels of each ray, (N,)."""
        lit = self.ray_of_pixel[self.ray_of_pixel != DARK]
        return np.bincount(lit, minlength=prod(self.shape))

    def picture(self, pattern: NDArray[Any]) -> Float:
        """Return the picture of a pattern.

        Parameters
        ----------
        pattern : ndarray of float32, shape `shape`
            Weights in [0, 1].

        Returns
        -------
        ndarray of float32, shape (Hp, Wp)
            The weight of each pixel's ray, 0 where it has none.
        """
        weights = np.zeros(prod(self.shape) + 1, np.float32)
        weights[:-1] = np.asarray(pattern, np.float32).reshape(-1)
        # DARK, the last index, takes the zero behind the rays
        picture: Float = weights[self.ray_of_pixel]
        return picture

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return {"shape": list(self.shape), "ray_of_pixel": fingerprint(self.ray_of_pixel)}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that `from_arrays` takes."""
        return {"shape": np.array(self.shape, np.int64), "ray_of_pixel": self.ray_of_pixel}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Return the layout that `arrays` came from."""
        return cls(tuple(int(extent) for extent in arrays["shape"]), arrays["ray_of_pixel"])
