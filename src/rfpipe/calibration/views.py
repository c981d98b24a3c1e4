"""The views of an array: where they lie on the projector, as the camera's picture shows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.correspondence import LEAST_POINTS, SmoothMap, map_of_pixels, points_of
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.rigs.layout import ProjectorLayout, Quadrilateral, apply_homography, homography

Double = NDArray[np.float64]
Mask = NDArray[np.bool_]


def find_views(correspondence: Findings, views: tuple[int, int]) -> list[Quadrilateral]:
    """Find the quadrilaterals that views light, as mirrors cut the camera's picture.

    Parameters
    ----------
    correspondence : Findings
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

    points, count = points_of(correspondence), views[0] * views[1]
    parts, found = label(_connected(points, correspondence["valid"]))
    sizes = np.bincount(parts.ravel(), minlength=found + 1)[1:]
    large = np.count_nonzero(sizes >= LEAST_POINTS)
    if large < count:
        raise CaptureError(
            f"{large} views are told apart in the camera's picture; expected {views[0]} x "
            f"{views[1]}. Leave dark gaps between the mirrors' pictures, or give the views' "
            "corners in the settings"
        )
    quads = [_corners(points[parts == part]) for part in np.argsort(sizes)[::-1][:count] + 1]
    middle = np.mean(quads, axis=1)
    rows = np.argsort(middle[:, 1], kind="stable").reshape(views)
    ordered = np.concatenate([row[np.argsort(middle[row, 0], kind="stable")] for row in rows])
    return [[(float(x), float(y)) for x, y in quads[index]] for index in ordered]


def layout_of_views(
    corners: Sequence[Quadrilateral], shape: tuple[int, int], display_shape: tuple[int, int]
) -> ProjectorLayout:
    """Return the layout (V, H, W) of rectified views of `shape` rays.

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


def maps_of_views(correspondence: Findings, corners: Sequence[Quadrilateral]) -> list[SmoothMap]:
    """Fit the map from camera to projector of each view, to the pixels that look into it."""
    maps = []
    for quad in corners:
        to_unit = np.linalg.inv(homography((1, 1), quad))
        place = apply_homography(to_unit, points_of(correspondence))
        inside = correspondence["valid"] & ((place >= 0) & (place <= 1)).all(axis=-1)
        maps.append(map_of_pixels(correspondence, inside))
    return maps


def _connected(points: Double, valid: Mask) -> Mask:
    """Return the valid pixels but those next to a jump of the projector's coordinates."""
    inside = valid.copy()
    for axis in (0, 1):
        there = np.moveaxis(points, axis, 0)
        known, kept = np.moveaxis(valid, axis, 0), np.moveaxis(inside, axis, 0)
        step = np.linalg.norm(np.diff(there, axis=0), axis=-1)
        both = known[1:] & known[:-1]
        if both.any():
            jump = both & (step > 6 * max(float(np.median(step[both])), 1e-6))
            kept[1:] &= ~jump
            kept[:-1] &= ~jump
    return inside


def _corners(points: Double) -> Double:
    """Return the corners (4, 2) of the quadrilateral that points (n, 2) fill, moved inwards.

    The corners are the points farthest out along the diagonals of the bounding box, stray ones
    left out.
    """
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    margin = 0.02 * (high - low)
    points = points[((points >= low - margin) & (points <= high + margin)).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    towards = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners = points[np.argmax((points - low) / (high - low) @ towards.T, axis=0)]
    return np.asarray(corners + 0.02 * (corners.mean(axis=0) - corners))  # off the mirror's edge
