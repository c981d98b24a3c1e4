"""A sphere between points: which of them it hides from each other, and which see it.

A segment is hidden when it passes through the sphere. A point of the sphere sees what lies above
its tangent plane, ``n_i . (x_j - c) > R`` with n its normal, c the centre and R the radius: as a
sphere is convex, that is all of its own shadow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.geometry import Sphere
from rfpipe.scenes.occluders import HIDDEN, MIXED, VISIBLE

__all__ = ["GRAZING", "classify_between", "classify_facing", "hidden"]

# Relative depth below the sphere's surface above which a segment isn't hidden: surfaces that touch
# the sphere aren't hidden where they touch.
GRAZING = 1e-9


def hidden(
    sphere: Sphere, first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the sphere stands between points outside it.

    Parameters
    ----------
    sphere
        The sphere.
    first, second
        float64 (n_1, 3) and (n_2, 3): ends of the segments, scene units.

    Returns
    -------
    ndarray of bool, (n_1, n_2)
    """
    centre = np.asarray(sphere.centre)
    start = first - centre
    length, along, squared = (np.zeros((len(first), len(second))) for _ in range(3))
    for axis in range(3):
        way = second[:, axis] - first[:, axis, None]
        length += way**2
        along -= start[:, axis, None] * way
    place = np.clip(along / np.maximum(length, np.finfo(np.float64).tiny), 0, 1)
    for axis in range(3):
        squared += (start[:, axis, None] + place * (second[:, axis] - first[:, axis, None])) ** 2
    through: NDArray[np.bool_] = squared < ((1 - GRAZING) * sphere.radius) ** 2
    return through


def classify_between(
    sphere: Sphere,
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    radius: NDArray[np.float64],
) -> NDArray[np.int8]:
    """Prove pairs of clusters wholly visible or wholly hidden behind the sphere, where possible.

    Parameters
    ----------
    sphere
        The sphere, outside which all points lie.
    first, second
        float64 (n, 3): centres of the clusters.
    radius
        float64 (n,): of the larger cluster; no segment between the clusters strays farther than
        that from the one between their centres.

    Returns
    -------
    int8 (n,)
        `VISIBLE`, `HIDDEN`, or `MIXED` where neither is proved.
    """
    start, way = first - np.asarray(sphere.centre), second - first
    length = np.maximum((way**2).sum(1), np.finfo(np.float64).tiny)
    place = np.clip(-(start * way).sum(1) / length, 0, 1)
    distance = np.linalg.norm(start + place[:, None] * way, axis=1)
    clear = distance >= sphere.radius + radius
    behind = distance + radius < (1 - 2 * GRAZING) * sphere.radius
    return np.where(clear, VISIBLE, np.where(behind, HIDDEN, MIXED))


def classify_facing(
    sphere: Sphere,
    centres: NDArray[np.float64],
    radius: NDArray[np.float64],
    corners: NDArray[np.float64],
) -> NDArray[np.int8]:
    """Prove clusters of the sphere to face clusters elsewhere, or to be turned away from them.

    Parameters
    ----------
    sphere
        The sphere.
    centres, radius
        float64 (n, 3) and (n,): balls that hold the clusters of the sphere.
    corners
        float64 (n, k, 3): corners of the other clusters.

    Returns
    -------
    int8 (n,)
        `VISIBLE`, `HIDDEN`, or `MIXED` where neither is proved.
    """
    ways = corners - np.asarray(sphere.centre)
    above = np.einsum("nx,nkx->nk", sphere.normals(centres), ways)
    # the normals of a cluster stray from its centre's by radius / R at most
    spread = radius / sphere.radius * np.linalg.norm(ways, axis=2).max(1)
    facing = above.min(1) - spread > (1 + GRAZING) * sphere.radius
    away = above.max(1) + spread < (1 - GRAZING) * sphere.radius
    return np.where(facing, VISIBLE, np.where(away, HIDDEN, MIXED))
