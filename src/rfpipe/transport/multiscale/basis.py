"""Smooth functions of many scales over a ray domain, and which of them exchange light.

Quadratic B-splines on grids whose spacing halves from scale to scale; of the fine scales only the
functions that a scene needs. Two functions are a pair where they are within reach of each other,
measured by the coarser of them: light between distant places varies slowly, the more so the
farther. Functions of the coarsest scale reach all others in their view, and each other between
views.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Functions = NDArray[np.int32]

REACH = 2
"""Spacings of the coarser function within which two functions are a pair."""

_COARSEST_CELLS = 20
# Pairs of functions whose coarser one is finer than this part of the coarsest scale are near range.
_NEAR = 4

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
        return _pairs(self.functions, self.centres, self.shape)

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

    def is_near(self, first: Functions, second: Functions) -> NDArray[np.bool_]:
        """Tell which pairs of functions are near range, by their numbers; else they are far."""
        coarser = np.maximum(self.scales[first], self.scales[second])
        near: NDArray[np.bool_] = coarser * _NEAR < coarsest_scale(self.shape)
        return near

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
            down, y = along(np.arange(height) + 0.5, int(scale))
            across, x = along(np.arange(width) + 0.5, int(scale))
            grid = numbers(self.functions, self.shape, int(scale))
            number = grid[:, down[:, None, :, None], across[None, :, None, :]]
            there = np.flatnonzero(number >= 0)
            value = (y[:, None, :, None] * x[None, :, None, :]).ravel()
            rays.append(there // (y.shape[1] * x.shape[1]))
            owners.append(number.ravel()[there])
            values.append(value[there % len(value)])
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


def along(
    places: NDArray[np.floating[Any]], scale: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the grid positions that aren't zero at places along an axis, and their values."""
    if scale == 1:
        return places.astype(np.int64)[:, None], np.ones((len(places), 1), np.float32)
    position = places / scale
    cell = position.astype(np.int64)
    part = position - cell
    values = np.stack([(1 - part) ** 2 / 2, 0.5 + part - part**2, part**2 / 2], axis=1)
    return cell[:, None] + np.arange(3), values.astype(np.float32)


def numbers(functions: Functions, shape: tuple[int, ...], scale: int) -> Functions:
    """Return each grid position's function of a scale, (V, rows, columns), -1 for none."""
    views, down, across = cells(shape, scale)
    outside = 2 if scale > 1 else 0
    grid = np.full((views, down + outside, across + outside), -1, np.int32)
    own = np.flatnonzero(functions[:, SCALE] == scale)
    grid[tuple(functions[own, 1:].T)] = own
    return grid


def _pairs(
    functions: Functions, centres: NDArray[np.float64], shape: tuple[int, ...]
) -> tuple[Functions, Functions]:
    """Find the pairs of functions within reach, each once."""
    if not len(functions):
        none = np.zeros(0, np.int32)
        return none, none
    top = int(functions[:, SCALE].max())
    firsts, seconds = [], []
    scales = np.unique(functions[:, SCALE])
    for fine in scales:
        near = np.flatnonzero(functions[:, SCALE] == fine)
        for coarse in scales[scales >= fine]:
            if coarse == top:
                far = np.flatnonzero(functions[:, SCALE] == coarse)
                a, b = (grid.ravel() for grid in np.meshgrid(near, far, indexing="ij"))
                joined = (fine == top) | (functions[a, VIEW] == functions[b, VIEW])
                a, b = a[joined], b[joined]
            else:
                found = _within_reach(functions, centres, near, shape, int(coarse))
                a = near.repeat((found >= 0).sum(axis=1))
                b = found[found >= 0].astype(np.intp)
            once = (a <= b) | (coarse != fine)
            firsts.append(np.minimum(a, b)[once])
            seconds.append(np.maximum(a, b)[once])
    return (
        np.concatenate(firsts).astype(np.int32),
        np.concatenate(seconds).astype(np.int32),
    )


def _within_reach(
    functions: Functions,
    centres: NDArray[np.float64],
    near: NDArray[np.int64],
    shape: tuple[int, ...],
    scale: int,
) -> Functions:
    """Return the functions of a scale within reach of some, (functions, places), -1 for none."""
    # outside of the grid there is no function
    room = 2 * REACH + 1
    around = ((0, 0), (room, room), (room, room))
    padded = np.pad(numbers(functions, shape, scale), around, constant_values=-1)
    position = centres[near].T / scale + (0.5 if scale > 1 else -0.5)
    first = np.ceil(position - REACH).astype(np.int64)
    row, column = place = first[:, :, None] + np.arange(2 * REACH + 1)
    down, across = place <= (position + REACH)[:, :, None]
    view = functions[near, VIEW][:, None, None]
    found = padded[view, row[:, :, None] + room, column[:, None, :] + room]
    return np.where(down[:, :, None] & across[:, None, :], found, -1).reshape(len(near), -1)
