"""Where the views of an array of mirrors lie on the projector."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.correspondence import Correspondence
from rfpipe.calibration.mapping import LEAST_POINTS, SmoothMap, fit_map, inner
from rfpipe.errors import CaptureError
from rfpipe.rigs.geometry import (
    Quadrilateral,
    apply_homography,
    homography,
    pixel_middles,
)
from rfpipe.rigs.layout import ProjectorLayout

__all__ = ["find_views", "layout_of_views", "map_of_pixels", "maps_of_views"]

Double = NDArray[np.float64]

JUMP = 6.0
"""Steps between neighbouring camera pixels, as a multiple of the usual one, that end a view."""

TRIM = 0.5
"""Per cent of a view's points beyond each side that are taken for stray."""

INSET = 0.01
"""Fraction of a view by which its corners move inwards, off the mirror's edge."""


def find_views(correspondence: Correspondence, views: tuple[int, int]) -> list[Quadrilateral]:
    """Find the quadrilaterals that views light, as the mirrors cut the camera's picture.

    Parameters
    ----------
    correspondence : Correspondence
    views : (int, int)
        Rows and columns of the array, as they lie on the projector.

    Returns
    -------
    list of Quadrilateral
        Row by row: (x, y) of the upper left, upper right, lower right and lower left corner, in
        projector pixels. Each is what the camera sees of a view, a little less.

    Raises
    ------
    CaptureError
        When fewer views are found.
    """
    from scipy.ndimage import label

    count = views[0] * views[1]
    parts, found = label(_connected(correspondence))
    sizes = np.bincount(parts.ravel(), minlength=found + 1)[1:]
    largest = np.argsort(sizes)[::-1][:count] + 1
    if found < count or sizes[largest[-1] - 1] < LEAST_POINTS:
        raise CaptureError(
            f"{np.count_nonzero(sizes >= LEAST_POINTS)} views are told apart in the camera's "
            f"picture; expected {views[0]} x {views[1]}. Leave dark gaps between the mirrors' "
            "pictures, or give the views' corners in the settings"
        )
    quads = [_corners(correspondence.points[parts == part]) for part in largest]
    middle = np.array([np.mean(quad, axis=0) for quad in quads])
    rows = np.argsort(middle[:, 1], kind="stable").reshape(views)
    ordered = [row[np.argsort(middle[row, 0], kind="stable")] for row in rows]
    return [[(float(x), float(y)) for x, y in quads[i]] for i in np.concatenate(ordered)]


def layout_of_views(
    corners: Sequence[Quadrilateral], shape: tuple[int, int], display_shape: tuple[int, int]
) -> ProjectorLayout:
    """Return the layout of rectified views.

    Parameters
    ----------
    corners : sequence of Quadrilateral
        Of each view on the projector.
    shape : (int, int)
        Rays of each view.
    display_shape : (int, int)
        Of the projector in pixels.

    Returns
    -------
    ProjectorLayout
        Shape (V, H, W): each projector pixel belongs to the ray that its middle lies on.

    Raises
    ------
    CaptureError
        When a ray has no projector pixel.
    """
    layout = ProjectorLayout.within(corners, (len(corners), *shape), display_shape)
    unlit = np.count_nonzero(layout.pixels_of_ray == 0)
    if unlit:
        raise CaptureError(
            f"{unlit} of {layout.pixels_of_ray.size} rays have no projector pixel; {shape} rays a "
            "view are too many for its place on the projector"
        )
    return layout


def maps_of_views(
    correspondence: Correspondence, corners: Sequence[Quadrilateral]
) -> list[SmoothMap]:
    """Fit the map from camera to projector of each view, to the pixels that look into it."""
    maps = []
    for quad in corners:
        place = apply_homography(np.linalg.inv(homography((1, 1), quad)), correspondence.points)
        inside = correspondence.valid & ((place >= 0) & (place <= 1)).all(axis=-1)
        maps.append(map_of_pixels(correspondence, inside))
    return maps


def map_of_pixels(correspondence: Correspondence, inside: NDArray[np.bool_]) -> SmoothMap:
    """Fit the map from camera to projector to some of the camera's pixels."""
    here, there = pixel_middles(inside.shape), correspondence.points
    return fit_map(here[inside], there[inside], inner(inside)[inside])


def _connected(correspondence: Correspondence) -> NDArray[np.bool_]:
    """Return the valid pixels without those next to a jump of the projector's coordinates."""
    inside = correspondence.valid.copy()
    maps: list[NDArray[Any]] = [correspondence.points, correspondence.valid, inside]
    for axis in (0, 1):
        points, valid, cut = (np.moveaxis(array, axis, 0) for array in maps)
        step = np.linalg.norm(np.diff(points, axis=0), axis=-1)
        both = valid[1:] & valid[:-1]
        if both.any():
            jump = both & (step > JUMP * max(float(np.median(step[both])), 1e-6))
            cut[1:] &= ~jump
            cut[:-1] &= ~jump
    return inside


def _corners(points: Double) -> Double:
    """Return the corners (4, 2) of the quadrilateral that points (n, 2) fill, moved inwards.

    The corners are the points farthest out along the diagonals of their bounding box.
    """
    import cv2

    hull = cv2.convexHull(_trimmed(points).astype(np.float32))[:, 0].astype(np.float64)
    low, high = hull.min(axis=0), hull.max(axis=0)
    unit = (hull - low) / (high - low)
    towards = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners = hull[np.argmax(unit @ towards.T, axis=0)]
    middle = corners.mean(axis=0)
    return np.asarray(corners + 2 * INSET * (middle - corners))


def _trimmed(points: Double) -> Double:
    """Leave out the points that lie apart from the others."""
    low, high = np.percentile(points, [TRIM, 100 - TRIM], axis=0)
    margin = 0.02 * (high - low)
    inside = ((points >= low - margin) & (points <= high + margin)).all(axis=1)
    return np.asarray(points[inside])
