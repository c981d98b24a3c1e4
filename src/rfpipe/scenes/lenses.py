"""Thin lenses: the surface points that a point of a picture sees or lights through a lens.

A lens of aperture A in focus at depth d takes the place of a pinhole. Through the point l of the
lens, the point p of the picture sees, or lights, the surface point of depth z that a pinhole shows
at

    x = p + l (1/z - 1/d).

p and x are on the image plane at distance 1. Over all points of the lens, x fills a disc, the
circle of confusion, of diameter ``A |1/z - 1/d|``; a point x is spread over a disc of that size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rfpipe.array_types import Double
from rfpipe.scenes.pinholes import Pinhole
from rfpipe.scenes.surfaces import Surface

_RADII = 16  # distinct radii of the points on a lens
_TURN = (5**0.5 - 1) / 2  # golden section of a quarter turn, between successive radii
_SAME = 1e-6  # relative difference of depths of the same surface point, due to rounding


class Lens(NamedTuple):
    """A thin lens: diameter of its aperture, and depth in focus, in scene units."""

    aperture: float
    focus: float


def lens_points() -> Double:
    """Points (x, y) evenly on the unit disc: float64 (P, 2).

    A spiral in four orientations: the mean is exactly 0 and the variance along each axis exactly
    that of the disc, 1/4, so that blur shifts nothing and has the right width.
    """
    k = np.arange(_RADII)
    spiral = np.sqrt((k + 0.5) / _RADII) * np.exp(0.5j * np.pi * (k * _TURN % 1))
    points = (spiral * 1j ** np.arange(4)[:, None]).ravel()
    return np.stack([points.real, points.imag], axis=-1)


@dataclass(frozen=True)
class LensView:
    """A lens in the place of a pinhole, in front of surfaces.

    Light of a surface point that the pinhole doesn't see is unknown; it is that of the surface in
    front of it.

    Points (x, y) of the picture are in pixels from its upper left corner. The P points of the lens
    are the first axis of arrays.
    """

    lens: Lens
    pinhole: Pinhole
    surfaces: Sequence[Surface]

    def seen(self, places: Double) -> Double:
        """Points x that the picture's points p see or light, each through its point of the lens.

        Both have the shape (P, ..., 2).
        """
        offsets, flat = self._offsets(), places.reshape(len(places), -1, 2)
        focused = offsets / self.lens.focus
        depths = [self._depths(*lines) for lines in zip(flat, offsets, focused, strict=True)]
        moved = flat + offsets[:, None] * self._defocus(np.stack(depths))
        return moved.reshape(places.shape)

    def lighting(self, places: Double) -> Double:
        """Points p, shape (P, n, 2), that see or light points x, (n, 2).

        NaN where a surface obstructs the line from x to the point of the lens.
        """
        offsets = self._offsets()
        depth = self._depths(places, np.zeros(2), np.zeros(2))
        moved = places - offsets[:, None] * self._defocus(depth)
        for offset, picture in zip(offsets, moved, strict=True):
            first = self._depths(places, offset, offset / depth[:, None])
            picture[~np.isclose(first, depth, rtol=_SAME)] = np.nan
        return moved

    def _offsets(self) -> Double:
        """Points of the lens, in scene units to the right and down."""
        return lens_points() * (self.lens.aperture / 2)

    def _defocus(self, depths: Double) -> Double:
        """Shift of the picture for depths (...), in pixels per scene unit on the lens, (..., 1)."""
        return ((1 / depths - 1 / self.lens.focus) / self.pinhole.pitch)[..., None]

    def _depths(self, places: Double, offset: Double, shift: Double) -> Double:
        """Depths at which lines from a point of the lens hit a surface first.

        A line is that of the pinhole's picture at `places` (n, 2), displaced by `offset`, with its
        direction changed by `-shift` on the image plane at distance 1.
        """
        pinhole = self.pinhole
        right, down, ahead = pinhole.axes
        x, y = ((places - np.array(pinhole.shape[::-1]) / 2) * pinhole.pitch - shift).T[..., None]
        rays = x * right + y * down + ahead
        origin = pinhole.origin + offset @ pinhole.axes[:2]
        depths = [surface.depths(origin, rays) for surface in self.surfaces]
        return np.asarray(np.min(depths, axis=0))
