"""Symmetric transport between smooth functions of several scales: ``T = F B S B^T F``.

The functions B are quadratic B-splines on grids whose spacing halves from scale to scale; of fine
scales there are only the functions that a scene needs. S has one entry, a *core*, for each pair of
functions. Two functions are a pair if the rows of their centres, and the columns, differ by at most
`REACH` spacings of the coarser one, since light between distant places varies slowly. A function of
the coarsest scale is paired with all functions of its view, and with functions of the coarsest
scale in other views. `rfpipe.transport.function_pairs` has the table of symbols.

Of large images the functions are constant over square cells of several rays: they are functions
over the grid of the cells, whose unit of length is a cell.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float, FunctionTable, Numbers
from rfpipe.blocks import RayDomain
from rfpipe.ranges import ranges
from rfpipe.transport.function_pairs import FunctionPairTransport
from rfpipe.transport.wavelet import Cells

if TYPE_CHECKING:
    from scipy.sparse import csr_array

REACH = 2
"""Largest difference in rows, or in columns, of a pair's centres, in spacings of the coarser."""

_COARSEST_CELLS = 20
# Pairs are near range if the coarser function's scale, times this, is below the coarsest scale.
_NEAR_RATIO = 4

# Columns of light that are multiplied by S at a time, so that they stay in the cache.
_COLUMNS_PER_BATCH = 64

# Values of functions that are computed at a time.
_VALUES_PER_BATCH = 2**22

SCALE, VIEW, ROW, COLUMN = range(4)
"""Columns of a `FunctionTable`."""


class MultiscaleBasis:
    """B-spline functions over a ray domain of N rays, and their pairs.

    Parameters
    ----------
    shape : tuple of int
        See `RayDomain`.
    functions : ndarray of int32, shape (n, 4)
        Scale (the spacing of the grid in pixels, a power of two), view, row and column of each
        function's grid position. At scale 1 a function is a single ray. At other scales position
        ``i`` is centred at ``(i - 1/2) scale``, so that the first position is outside the image.
    """

    def __init__(self, shape: tuple[int, ...], functions: FunctionTable) -> None:
        self.shape = tuple(shape)
        order = np.lexsort(functions.T[::-1])
        self.functions: FunctionTable = np.ascontiguousarray(functions[order], np.int32)

    def __len__(self) -> int:
        return len(self.functions)

    @cached_property
    def pairs(self) -> tuple[Numbers, Numbers]:
        """Numbers of each pair's two functions, (pairs,) each, ``first <= second``."""
        return _pairs(self.functions, self.centres, self.shape)

    @property
    def first(self) -> Numbers:
        """Number of each pair's first function."""
        return self.pairs[0]

    @property
    def second(self) -> Numbers:
        """Number of each pair's second function."""
        return self.pairs[1]

    @property
    def scales(self) -> Numbers:
        """Scale of each function, in pixels."""
        return self.functions[:, SCALE]

    def is_near(self, first: Numbers, second: Numbers) -> NDArray[np.bool_]:
        """Test which pairs of functions, given by their numbers, are near range; others are far."""
        coarser = np.maximum(self.scales[first], self.scales[second])
        near: NDArray[np.bool_] = coarser * _NEAR_RATIO < coarsest_scale(self.shape)
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
        from scipy.sparse import csr_array, vstack

        views, height, width = RayDomain(self.shape).stack_shape
        grids = {
            int(scale): function_grid(self.functions, self.shape, int(scale))
            for scale in np.unique(self.scales)
        }
        rows = max(1, _VALUES_PER_BATCH // (9 * width * max(1, len(grids))))
        parts = [
            self._weights_of_rows({scale: grid[view] for scale, grid in grids.items()}, first, last)
            for view in range(views)
            for first, last in ranges(height, rows)
        ]
        return parts[0] if len(parts) == 1 else csr_array(vstack(parts, format="csr"))

    def _weights_of_rows(
        self, grids: Mapping[int, Numbers], first: int, last: int
    ) -> csr_array[np.float32]:
        """Compute the values at rows ``first:last`` of a view, of the functions on its grids."""
        from scipy.sparse import csr_array

        width = self.shape[-1]
        rays, owners, values = [], [], []
        for scale, grid in grids.items():
            row, y = spline_values(np.arange(first, last) + 0.5, scale)
            column, x = spline_values(np.arange(width) + 0.5, scale)
            number = grid[row[:, None, :, None], column[None, :, None, :]]
            existing = np.flatnonzero(number >= 0)
            value = (y[:, None, :, None] * x[None, :, None, :]).ravel()
            rays.append((existing // (y.shape[1] * x.shape[1])).astype(np.int32))
            owners.append(number.ravel()[existing])
            values.append(value[existing])
        shape = ((last - first) * width, len(self))
        index = (np.concatenate(rays), np.concatenate(owners))
        return csr_array((np.concatenate(values), index), shape=shape).astype(
            np.float32, copy=False
        )

    @cached_property
    def sums(self) -> csr_array[np.float32]:
        """The transpose of `weights`, sparse float32 (n, N)."""
        return self.weights.T.tocsr()

    def distances(self) -> NDArray[np.float64]:
        """Compute the Euclidean distance of each pair's centres, in pixels, (pairs,).

        Between views it is the coarsest scale.
        """
        if not len(self):
            return np.zeros(0)
        offset = self.centres[self.first] - self.centres[self.second]
        distance: NDArray[np.float64] = np.hypot(offset[:, 0], offset[:, 1])
        view = self.functions[:, VIEW]
        distance[view[self.first] != view[self.second]] = self.scales.max()
        return distance


def coarsest_scale(shape: tuple[int, ...]) -> int:
    """Return the largest scale at which an image has at least `_COARSEST_CELLS` cells."""
    scale = 1
    while np.prod(cells(shape, 2 * scale)[1:]) >= _COARSEST_CELLS:
        scale *= 2
    return scale


def functions_over(scale: int, covered: NDArray[np.bool_]) -> FunctionTable:
    """Return the functions of a scale that are not zero in covered cells.

    `covered` are cells of ``scale x scale`` pixels, bool (V, ceil(H / scale), ceil(W / scale)).
    """
    chosen = covered
    if scale > 1:
        rows, columns = covered.shape[1:]
        chosen = np.zeros((len(covered), rows + 2, columns + 2), np.bool_)
        for down in range(3):
            for right in range(3):
                chosen[:, down : down + rows, right : right + columns] |= covered
    view, row, column = np.nonzero(chosen)
    return np.stack([np.full(len(view), scale), view, row, column], axis=1).astype(np.int32)


def cells(shape: tuple[int, ...], scale: int) -> tuple[int, int, int]:
    """Return the numbers of views, and of rows and columns of cells of a scale."""
    views, height, width = RayDomain(shape).stack_shape
    return views, -(-height // scale), -(-width // scale)


def spline_values(
    places: NDArray[np.floating[Any]], scale: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Compute the functions of a scale that aren't zero at places along one axis.

    Parameters
    ----------
    places : ndarray, shape (places,)
        Positions in pixels; the first pixel's centre is at 1/2.
    scale : int
        Spacing of the functions, in pixels.

    Returns
    -------
    position : ndarray of int64, shape (places, 3)
        Grid positions of the functions; (places, 1) at scale 1.
    values : ndarray of float32, of the same shape
        Their values.
    """
    if scale == 1:
        return places.astype(np.int64)[:, None], np.ones((len(places), 1), np.float32)
    position = places / scale
    cell = position.astype(np.int64)
    part = position - cell
    values = np.stack([(1 - part) ** 2 / 2, 0.5 + part - part**2, part**2 / 2], axis=1)
    return cell[:, None] + np.arange(3), values.astype(np.float32)


def function_grid(functions: FunctionTable, shape: tuple[int, ...], scale: int) -> Numbers:
    """Number of the function at each grid position of a scale, (V, rows, columns), -1 for none."""
    views, rows, columns = cells(shape, scale)
    margin = 2 if scale > 1 else 0
    grid = np.full((views, rows + margin, columns + margin), -1, np.int32)
    members = np.flatnonzero(functions[:, SCALE] == scale)
    grid[tuple(functions[members, 1:].T)] = members
    return grid


def _pairs(
    functions: FunctionTable, centres: NDArray[np.float64], shape: tuple[int, ...]
) -> tuple[Numbers, Numbers]:
    """Return the pairs of functions within reach, ordered by their scales and numbers."""
    from scipy.spatial import cKDTree

    scale, view = functions[:, SCALE], functions[:, VIEW]
    top = scale.max(initial=0)
    # views far from each other, so that no pair is between views
    place = np.column_stack([centres, view * 4.0 * (max(shape) + top)])
    near_pairs = []
    for coarse in np.unique(scale):
        finer, coarser = np.flatnonzero(scale <= coarse), np.flatnonzero(scale == coarse)
        if coarse == top:
            a, b = (grid.ravel() for grid in np.meshgrid(finer, coarser, indexing="ij"))
            near = (scale[a] == top) | (view[a] == view[b])
        else:
            trees = cKDTree(place[finer]), cKDTree(place[coarser])
            pairs = trees[0].sparse_distance_matrix(
                trees[1], REACH * float(coarse), p=np.inf, output_type="ndarray"
            )
            a, b = finer[pairs["i"]], coarser[pairs["j"]]
            near = np.ones(len(a), np.bool_)
        near_pairs.append(np.stack([a, b])[:, near & (a <= b)])
    a, b = np.concatenate([np.zeros((2, 0), np.int64), *near_pairs], axis=1)
    order = np.lexsort((b, a, scale[b], scale[a]))
    return a[order].astype(np.int32), b[order].astype(np.int32)


class MultiscaleTransport(FunctionPairTransport):
    """Symmetric transport ``T = F B S B^T F`` per channel, with smooth functions B.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.Transport`; both shapes are equal.
    content : mapping of str to ndarray
        ``side``, int32 (1,): side of the cells in rays. ``factor``, float32 (channels, N): F,
        radiance of the floodlit image. ``functions``, int32 (n, 4): table of B over the grid of
        cells, see `MultiscaleBasis`. ``pairs``, int32 (2, pairs): numbers of the functions of each
        pair. ``cores``, float32 (channels, pairs): S, one value for each pair, in inverse radiance.
        Arrays may be read lazily. They are stored without rounding, since cores cancel.
    """

    kind = "multiscale"

    @cached_property
    def cells(self) -> Cells:
        """Cells over which the functions are constant."""
        return Cells(self.camera_shape, int(self._content["side"][0]))

    @cached_property
    def basis(self) -> MultiscaleBasis:
        """The functions over the grid of cells."""
        return MultiscaleBasis(self.cells.grid_shape, self._content["functions"])

    def _forward(self, light: Float, channel: int) -> Any:
        cores, factor = self._content["cores"][channel], self._content["factor"][channel]
        pairs = self._content["pairs"]
        return relight_smooth(self.cells, self.basis, (pairs[0], pairs[1]), cores, factor, light)

    def functions(self) -> csr_array[np.float32]:
        """Return B."""
        return self.basis.weights[self.cells.of_ray]

    def between(
        self, received: csr_array[np.float32], sent: csr_array[np.float32], channel: int
    ) -> Float:
        """Compute ``received^T T sent``, see `Transport.between`."""
        from scipy.sparse import diags_array

        from rfpipe.transport.pair_kernels import couple

        # without images, since there are far fewer functions than rays
        scaled = self.cells.sums @ diags_array(self._content["factor"][channel])
        light = (self.basis.sums @ (scaled @ sent)).tocsc()
        weights = ((received.T @ scaled.T) @ self.basis.weights).tocsr()
        matrix = np.empty((received.shape[1], sent.shape[1]), np.float32)
        first, second = self._content["pairs"]
        for start in range(0, sent.shape[1], _COLUMNS_PER_BATCH):
            columns = slice(start, start + _COLUMNS_PER_BATCH)
            batch = np.ascontiguousarray(light[:, columns].toarray())
            coupled = np.zeros_like(batch)
            couple(first, second, self._content["cores"][channel], batch, coupled)
            matrix[:, columns] = weights @ coupled
        return matrix


def relight_smooth(
    cells: Cells,
    basis: MultiscaleBasis,
    pairs: tuple[Numbers, Numbers],
    cores: Float,
    factor: Float,
    patterns: NDArray[Any],
) -> Float:
    """Compute the images ``F B S B^T F p`` of one channel for patterns p.

    Parameters
    ----------
    cells : Cells
    basis : MultiscaleBasis
        B, over the grid of the cells.
    pairs : tuple of ndarray of int32, shape (pairs,)
        Numbers of each pair's two functions.
    cores : ndarray of float32, shape (pairs,)
        S.
    factor : ndarray of float32, shape (N,)
        F.
    patterns : ndarray, shape (P, N)

    Returns
    -------
    ndarray of float32, shape (P, N)
    """
    light = basis.sums @ cells.total_of_products(patterns, factor)
    return cells.spread(basis.weights @ exchanged(basis, pairs, cores, light), factor)


def exchanged(
    basis: MultiscaleBasis, pairs: tuple[Numbers, Numbers], cores: Float, light: Any
) -> Float:
    """Compute ``S light`` for the light (n, P) on each function."""
    from rfpipe.transport.pair_kernels import couple

    light = np.ascontiguousarray(light)
    received = np.zeros((len(basis), light.shape[1]), np.float32)
    couple(*pairs, cores, light, received)
    return received
