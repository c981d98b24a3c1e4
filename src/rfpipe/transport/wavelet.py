"""Symmetric transport between Haar wavelets on cells of pixels: ``T = f W^T X W f``.

The wavelets W are a complete basis of images of cells, so that light of any shape can be
represented. X has one coefficient, a *core*, for each pair of wavelets that exchange light. It is
the transport of `rfpipe.transport.function_pairs` with ``F = f``, ``B = W^T`` and ``S = X``. The
factor f is a diagonal matrix; the residual of a model has a root of the floodlit image there
(`rfpipe.methods.residual.model`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.transport.function_pairs import FunctionPairTransport
from rfpipe.transport.regrouping import cell_sums

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_HALF = np.float32(0.5)
_COARSEST = 3  # least number of cells along the shorter side of the coarsest grid


@dataclass(frozen=True)
class Group:
    """Wavelets of one scale: consecutive coefficients, orientation by orientation.

    Attributes
    ----------
    start : int
        Number of the first coefficient.
    orientations : int
        3 orientations of details, or 1 of the coarsest means.
    grid : tuple of int
        Views, rows and columns of the places of each orientation.
    side : int
        Side of a wavelet's support, in cells.
    """

    start: int
    orientations: int
    grid: tuple[int, int, int]
    side: int

    @property
    def places(self) -> int:
        """Number of places."""
        return math.prod(self.grid)

    @property
    def rows(self) -> slice:
        """Range of the coefficients."""
        return slice(self.start, self.start + self.orientations * self.places)

    def by_place(self) -> list[NDArray[np.int64]]:
        """Return the wavelets of each place, at the finest scale of two by two places."""
        _, height, width = self.grid
        step = 2 if self.side == 2 and height % 2 == 0 and width % 2 == 0 else 1
        number = np.arange(self.rows.start, self.rows.stop)
        shape = (self.orientations, self.grid[0], height // step, step, width // step, step)
        places = number.reshape(shape).transpose(1, 2, 4, 0, 3, 5)
        return list(places.reshape(-1, self.orientations * step * step))

    def centres(self) -> NDArray[np.float32]:
        """Return row and column of the centre of each place in its view, in cells, (places, 2)."""
        _, row, column = np.indices(self.grid).reshape(3, -1)
        places: Float = (np.stack([row, column], axis=1).astype(np.float32) + _HALF) * self.side
        return places


def _padded(side: int, octaves: int) -> int:
    """Round a side up to a number of cells that can be halved `octaves` times."""
    cell = 1 << octaves
    return -(-side // cell) * cell


class Haar:
    """Haar transform of images of cells, (views, rows, columns); views are not mixed.

    It is orthonormal. Images are padded with zeros to sides that can be halved at each octave.
    """

    def __init__(self, stack: tuple[int, int, int]) -> None:
        views, height, width = self.stack = stack
        self.octaves = max(0, int(np.log2(max(1.0, min(height, width) / _COARSEST))))
        self.grid = (views, _padded(height, self.octaves), _padded(width, self.octaves))
        self.size = math.prod(self.grid)

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The scales from fine to coarse; the coarsest means are the last."""
        views, height, width = self.grid
        groups, start = [], 0
        for octave in range(1, self.octaves + 1):
            side = 2**octave
            groups.append(Group(start, 3, (views, height // side, width // side), side))
            start = groups[-1].rows.stop
        side = 2**self.octaves
        groups.append(Group(start, 1, (views, height // side, width // side), side))
        return tuple(groups)

    def forward(self, images: Float) -> Float:
        """Compute the coefficients (size, P) of P images (cells, P)."""
        from rfpipe.transport.haar_kernels import divide_into_details

        _, height, width = self.stack
        count = images.shape[1]
        finer: Float = np.ascontiguousarray(images, np.float32).reshape(*self.stack, count)
        if self.grid != self.stack:
            padded = np.zeros((*self.grid, count), np.float32)
            padded[:, :height, :width] = finer
            finer = padded
        coefficients = np.empty((self.size, count), np.float32)
        for group in self.groups[:-1]:
            details = coefficients[group.rows].reshape(3, *group.grid, count)
            means = np.empty((*group.grid, count), np.float32)
            divide_into_details(finer, means, details)
            finer = means
        coefficients[self.groups[-1].rows] = finer.reshape(-1, count)
        return coefficients

    def inverse(self, coefficients: Float) -> Float:
        """Compute the P images (cells, P) of coefficients (size, P)."""
        from rfpipe.transport.haar_kernels import combine_details

        count, (views, height, width) = coefficients.shape[1], self.stack
        coefficients = np.ascontiguousarray(coefficients, np.float32)
        last = self.groups[-1]
        means = coefficients[last.rows].reshape(*last.grid, count)
        for group in reversed(self.groups[:-1]):
            details = coefficients[group.rows].reshape(3, *group.grid, count)
            finer = np.empty((views, 2 * group.grid[1], 2 * group.grid[2], count), np.float32)
            combine_details(means, details, finer)
            means = finer
        return np.ascontiguousarray(means[:, :height, :width]).reshape(-1, count)

    def forward_both(self, matrix: Float, columns: Haar) -> Float:
        """Compute ``W K W'^T`` of a matrix K; W' transforms its columns' images."""
        return transposed(columns.forward(transposed(self.forward(matrix))))

    def inverse_both(self, coefficients: Float, columns: Haar) -> Float:
        """Compute ``K = W^T X W'`` of coefficients X; W' transforms its columns' images."""
        return transposed(columns.inverse(transposed(self.inverse(coefficients))))


def transposed(matrix: Float) -> Float:
    """Return a contiguous copy of the transpose of a matrix."""
    from rfpipe.transport.haar_kernels import transpose

    out = np.empty(matrix.shape[::-1], np.float32)
    transpose(matrix, out)
    return out


def cell_side(shape: tuple[int, ...], limit: int) -> int:
    """Return the smallest side of cells, in pixels, with at most `limit` cells in all views.

    Each view has at least one cell.
    """
    views, height, width = RayDomain(shape).stack_shape
    side = 1
    while views * -(-height // side) * -(-width // side) > limit and side < max(height, width):
        side += 1
    return side


class Cells:
    """Cells of `side` by `side` pixels of a ray domain of N rays, smaller at an image's end.

    Attributes
    ----------
    stack : tuple of int
        Views, rows and columns of cells.
    grid_shape : tuple of int
        The cells as a ray domain; without views if the rays have none.
    count : int
        Number of cells.
    of_ray : ndarray of int64, shape (N,)
        Number of each ray's cell.
    sums : csr_array of float32, shape (cells, N)
        1 where a ray is in a cell.
    """

    def __init__(self, shape: tuple[int, ...], side: int) -> None:
        self.shape, self.side = tuple(shape), side
        self.stack, self.of_ray = RayDomain(self.shape).square_cells(side)
        self.count = math.prod(self.stack)
        self.grid_shape, self.sums = cell_sums(self.shape, side)

    @cached_property
    def haar(self) -> Haar:
        """Transform of images of the cells."""
        return Haar(self.stack)

    def functions(self) -> csr_array[np.float32]:
        """Return ``W^T`` over the rays, sparse (N, wavelets)."""
        from scipy.sparse import csr_array

        return csr_array(self.haar.inverse(np.eye(self.haar.size, dtype=np.float32)))[self.of_ray]

    def total(self, images: NDArray[Any]) -> Float:
        """Sum P images (P, N) over cells, (cells, P)."""
        if self.side == 1:
            return np.ascontiguousarray(images.T, np.float32)
        sums: Float = self.sums @ np.asarray(images.T, np.float32)
        return sums

    def total_of_products(self, images: NDArray[Any], factor: Float) -> Float:
        """Sum P images (P, N) times a factor (N,) over cells, (cells, P)."""
        from rfpipe.transport.cell_kernels import add_to_cells

        sums = np.zeros((self.count, len(images)), np.float32)
        add_to_cells(images, factor, self.of_ray, sums)
        return sums

    def spread(self, values: Float, factor: Float) -> Float:
        """Give the rays of P images, (P, N), the values (cells, P) of their cells times a factor.

        The factor has a value for each ray, (N,).
        """
        from rfpipe.transport.cell_kernels import spread_over_cells

        images = np.empty((values.shape[1], len(factor)), np.float32)
        spread_over_cells(values, factor, self.of_ray, images)
        return images

    def shared_out(self, values: Float, over: Float) -> csr_array[np.float32]:
        """Divide an image (N,) by the value `over` of each cell; sparse (N, cells)."""
        from scipy.sparse import csr_array

        sums = over[self.of_ray]
        shares = np.divide(values, sums, out=np.zeros_like(values), where=sums > 0)
        index = (np.arange(len(shares)), self.of_ray)
        return csr_array((shares, index), shape=(len(shares), self.count))


class WaveletTransport(FunctionPairTransport):
    """Symmetric transport ``T = f W^T X W f`` per channel, between Haar wavelets W.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.Transport`; both shapes are equal.
    content : mapping of str to ndarray
        ``side``, int32 (1,): pixels along the side of a cell. ``factor``, float32 (channels, N): f.
        ``pairs``, int32 (2, pairs): numbers of the wavelets of each pair, ascending. ``cores``,
        float32 (channels, pairs): X, of any sign. Arrays may be read lazily. They are stored
        without rounding, since cores cancel.
    """

    kind = "wavelet"

    @cached_property
    def cells(self) -> Cells:
        """The grid of the wavelets."""
        return Cells(self.camera_shape, int(self._content["side"][0]))

    def functions(self) -> csr_array[np.float32]:
        """Return ``W^T`` over the rays."""
        return self.cells.functions()

    def _forward(self, light: Float, channel: int) -> Any:
        from rfpipe.transport.pair_kernels import couple

        factor, cells = self._content["factor"][channel], self.cells
        sent = cells.haar.forward(cells.total_of_products(light, factor))
        received = np.zeros_like(sent)
        first, second = self._content["pairs"]
        couple(first, second, self._content["cores"][channel], sent, received)
        return cells.spread(cells.haar.inverse(received), factor)
