"""Smooth functions of many scales over a ray domain, and which of them exchange light.

Quadratic B-splines on grids whose spacing halves from scale to scale; of the fine scales only the
functions that a scene needs. Two functions are a pair where they are within reach of each other,
measured by the coarser of them: light between distant places varies slowly, the more so the
farther. Functions of the coarsest scale reach all others in their view, and each other between
views.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Functions = NDArray[np.int32]

REACH = 2
"""Spacings of the coarser function within which two functions are a pair."""

_COARSEST_CELLS = 20

SCALE, VIEW, ROW, COLUMN = range(4)
"""The columns of a table of functions."""


class MultiscaleBasis:
    """Functions over a ray domain of N rays, and their pairs.

    Parameters
    ----------
    shape : tuple of int
        See `RayDomain`.
    functions : ndarray of int32, shape (n, 4)
        Scale (the spacing of its grid in pixels, a power of two), view, row and column of each
        function's grid position. At scale 1 a function is a single ray, at others position
        ``i`` is centred at ``(i - 1/2) scale``, so that it begins outside the image.
    """

    def __init__(self, shape: tuple[int, ...], functions: Functions) -> None:
        self.shape = tuple(shape)
        order = np.lexsort(functions.T[::-1])
        self.functions: Functions = np.ascontiguousarray(functions[order], np.int32)

    def __len__(self) -> int:
        return len(self.functions)

    @cached_property
    def pairs(self) -> tuple[Functions, Functions]:
        """The pairs' first and second functions, int32 (pairs,) each, ``first <= second``."""
        return _pairs(self.functions, self.centres)

    @property
    def first(self) -> Functions:
        """The first function of each pair."""
        return self.pairs[0]

    @property
    def second(self) -> Functions:
        """The second function of each pair."""
        return self.pairs[1]

    @property
    def scales(self) -> Functions:
        """Scale of each function, in pixels."""
        return self.functions[:, SCALE]

    @property
    def centres(self) -> NDArray[np.float64]:
        """Row and column of each function's centre in its view, in pixels, (n, 2)."""
        scale = self.functions[:, [SCALE]].astype(np.float64)
        shift = np.where(scale == 1, 0.5, -0.5)
        return (self.functions[:, [ROW, COLUMN]] + shift) * scale

    @cached_property
    def weights(self) -> csr_array[np.float32]:
        """The functions' values, sparse float32 (N, n)."""
        from scipy.sparse import csr_array

        height, width = RayDomain(self.shape).image_shape
        rays, owners, values = [], [], []
        for scale in np.unique(self.scales):
            own = np.flatnonzero(self.scales == scale)
            rows, columns = _along(height, int(scale)), _along(width, int(scale))
            at = {
                tuple(key): index
                for key, index in zip(self.functions[own, 1:].tolist(), own, strict=True)
            }
            for (view, row, column), index in at.items():
                y, value_y = rows[row]
                x, value_x = columns[column]
                rays.append(((view * height + y)[:, None] * width + x).ravel())
                values.append(np.outer(value_y, value_x).ravel())
                owners.append(np.full(len(rays[-1]), index))
        shape = (int(np.prod(self.shape)), len(self))
        where = (np.concatenate(rays), np.concatenate(owners))
        return csr_array((np.concatenate(values), where), shape=shape).astype(np.float32)

    @cached_property
    def sums(self) -> csr_array[np.float32]:
        """The transpose of `weights`, sparse float32 (n, N)."""
        return self.weights.T.tocsr()

    def distances(self) -> NDArray[np.float64]:
        """Distance of each pair's centres in pixels; between views, the coarsest scale."""
        if not len(self):
            return np.zeros(0)
        apart = self.centres[self.first] - self.centres[self.second]
        distance: NDArray[np.float64] = np.hypot(apart[:, 0], apart[:, 1])
        view = self.functions[:, VIEW]
        distance[view[self.first] != view[self.second]] = self.scales.max()
        return distance


def coarsest_scale(shape: tuple[int, ...]) -> int:
    """Return the largest scale of which an image has at least `_COARSEST_CELLS` cells."""
    scale = 1
    while np.prod(cells(shape, 2 * scale)[1:]) >= _COARSEST_CELLS:
        scale *= 2
    return scale


def functions_over(scale: int, wanted: NDArray[np.bool_]) -> Functions:
    """Return the functions of a scale that are not zero where they are wanted.

    Parameters
    ----------
    scale : int
    wanted : ndarray of bool, shape (V, ceil(H / scale), ceil(W / scale))
        Cells of ``scale x scale`` pixels.
    """
    chosen = wanted
    if scale > 1:
        rows, columns = wanted.shape[1:]
        chosen = np.zeros((len(wanted), rows + 2, columns + 2), np.bool_)
        for down in range(3):
            for right in range(3):
                chosen[:, down : down + rows, right : right + columns] |= wanted
    view, row, column = np.nonzero(chosen)
    return np.stack([np.full(len(view), scale), view, row, column], axis=1).astype(np.int32)


def cells(shape: tuple[int, ...], scale: int) -> tuple[int, int, int]:
    """Return the number of views, and of cells of a scale down and across."""
    views, height, width = RayDomain(shape).stack_shape
    return views, -(-height // scale), -(-width // scale)


def _along(length: int, scale: int) -> list[tuple[NDArray[np.int64], NDArray[np.float32]]]:
    """Return, for each grid position along an axis, the pixels where it isn't zero and values."""
    pixel = np.arange(length)
    if scale == 1:
        return [(pixel[i : i + 1], np.ones(1, np.float32)) for i in range(length)]
    position = (pixel + 0.5) / scale
    cell = position.astype(np.int64)
    part = position - cell
    values = np.stack([(1 - part) ** 2 / 2, 0.5 + part - part**2, part**2 / 2], axis=1)
    found = []
    for index in range(-(-length // scale) + 2):
        inside = (cell <= index) & (cell >= index - 2)
        found.append((pixel[inside], values[inside, index - cell[inside]].astype(np.float32)))
    return found


def _pairs(functions: Functions, centres: NDArray[np.float64]) -> tuple[Functions, Functions]:
    """Find the pairs of functions within reach, each once."""
    from scipy.spatial import cKDTree

    if not len(functions):
        none = np.zeros(0, np.int32)
        return none, none
    top = int(functions[:, SCALE].max())
    # a distance between views beyond any reach
    place = np.column_stack([centres, functions[:, VIEW] * 1e9])
    firsts, seconds = [], []
    scales = np.unique(functions[:, SCALE])
    for fine in scales:
        near = np.flatnonzero(functions[:, SCALE] == fine)
        for coarse in scales[scales >= fine]:
            far = np.flatnonzero(functions[:, SCALE] == coarse)
            if coarse == top:
                a, b = (grid.ravel() for grid in np.meshgrid(near, far, indexing="ij"))
                joined = (fine == top) | (functions[a, VIEW] == functions[b, VIEW])
                a, b = a[joined], b[joined]
            else:
                found = cKDTree(place[far]).query_ball_point(
                    place[near], REACH * int(coarse), p=np.inf, return_sorted=True
                )
                others = [np.asarray(found_by_one, np.int64) for found_by_one in found]
                a = np.repeat(near, [len(indices) for indices in others])
                b = far[np.concatenate(others)]
            once = (a <= b) | (coarse != fine)
            firsts.append(np.minimum(a, b)[once])
            seconds.append(np.maximum(a, b)[once])
    return (
        np.concatenate(firsts).astype(np.int32),
        np.concatenate(seconds).astype(np.int32),
    )
