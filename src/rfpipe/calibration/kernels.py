"""Compiled kernel: how much of each camera pixel each projector pixel covers."""

from __future__ import annotations

import numba
import numpy as np

_CORNERS = 12  # a convex quadrilateral cut by a square has at most 8


@numba.njit(cache=True, nogil=True)
def _cut(x, y, count, along_x, bound, keep_above, to_x, to_y):  # type: ignore[no-untyped-def]
    """Keep the part of a convex polygon on one side of a line x = bound or y = bound."""
    kept = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        a = (x[i] if along_x else y[i]) - bound
        b = (x[j] if along_x else y[j]) - bound
        if not keep_above:
            a, b = -a, -b
        if a >= 0:
            to_x[kept], to_y[kept] = x[i], y[i]
            kept += 1
        if (a > 0 and b < 0) or (a < 0 and b > 0):
            part = a / (a - b)
            to_x[kept] = x[i] + part * (x[j] - x[i])
            to_y[kept] = y[i] + part * (y[j] - y[i])
            kept += 1
    return kept


@numba.njit(cache=True, nogil=True)
def _area(x, y, count):  # type: ignore[no-untyped-def]
    """Area of a polygon."""
    twice = 0.0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        twice += x[i] * y[j] - x[j] * y[i]
    return abs(twice) / 2


@numba.njit(cache=True, nogil=True)
def overlaps(corners, chosen, height, width):  # type: ignore[no-untyped-def]
    """Cut the camera pixels' outlines on the projector by the projector's pixels.

    Parameters
    ----------
    corners : float64 (Hc + 1, Wc + 1, 2)
        (x, y) on the projector of the camera pixels' corners.
    chosen : bool (Hc, Wc)
        Camera pixels to look at.
    height, width : int
        Of the projector.

    Returns
    -------
    camera, projector : int64 (n,)
        Indices of pixels that overlap.
    share : float64 (n,)
        Area of the overlap over that of the camera pixel's outline.
    areas : float64 (n,)
        Area of the overlap in projector pixels.
    """
    rows, columns = chosen.shape
    camera = [0 for _ in range(0)]
    projector = [0 for _ in range(0)]
    share = [0.0 for _ in range(0)]
    areas = [0.0 for _ in range(0)]
    x, y = np.empty(_CORNERS), np.empty(_CORNERS)
    u, v = np.empty(_CORNERS), np.empty(_CORNERS)
    outline_x, outline_y = np.empty(4), np.empty(4)
    for i in range(rows):
        for j in range(columns):
            if not chosen[i, j]:
                continue
            for k in range(4):
                # around the pixel: upper left, upper right, lower right, lower left
                row, column = i + k // 2, j + (k + 1) // 2 % 2
                outline_x[k] = corners[row, column, 0]
                outline_y[k] = corners[row, column, 1]
            whole = _area(outline_x, outline_y, 4)
            if not whole > 0:  # NaN is not, either
                continue
            left = max(0, int(np.floor(outline_x.min())))
            right = min(width, int(np.ceil(outline_x.max())))
            top = max(0, int(np.floor(outline_y.min())))
            bottom = min(height, int(np.ceil(outline_y.max())))
            for row in range(top, bottom):
                for column in range(left, right):
                    count = _cut(outline_x, outline_y, 4, True, column, True, u, v)
                    count = _cut(u, v, count, True, column + 1, False, x, y)
                    count = _cut(x, y, count, False, row, True, u, v)
                    count = _cut(u, v, count, False, row + 1, False, x, y)
                    if count < 3:
                        continue
                    area = _area(x, y, count)
                    if area > 0:
                        camera.append(i * columns + j)
                        projector.append(row * width + column)
                        share.append(area / whole)
                        areas.append(area)
    return np.array(camera), np.array(projector), np.array(share), np.array(areas)
