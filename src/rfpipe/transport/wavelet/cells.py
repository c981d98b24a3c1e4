"""Square cells of pixels: the grid on which wavelets stand."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.transport.base import Float
from rfpipe.transport.wavelet.haar import Haar

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["Cells", "cell_side"]


def cell_side(shape: tuple[int, ...], most: int) -> int:
    """Return the least side of cells, in pixels, of which there are at most so many.

    Cells don't reach over views: of as many views as that there is one cell each.
    """
    views, height, width = RayDomain(shape).stack_shape
    side = 1
    while views * -(-height // side) * -(-width // side) > most and side < max(height, width):
        side += 1
    return side


class Cells:
    """The cells of a ray domain of N rays.

    Parameters
    ----------
    shape : tuple of int
        The ray domain.
    side : int
        Pixels along either side of a cell, at least 1; those at the image's end may be smaller.
    """

    def __init__(self, shape: tuple[int, ...], side: int) -> None:
        views, height, width = RayDomain(shape).stack_shape
        self.shape, self.side = tuple(shape), side
        self.stack = (views, -(-height // side), -(-width // side))
        self.count = math.prod(self.stack)

    @cached_property
    def of_ray(self) -> NDArray[np.int64]:
        """Each ray's cell, (N,)."""
        view, row, column = np.indices(RayDomain(self.shape).stack_shape, np.int64)
        where = (view, row // self.side, column // self.side)
        number: NDArray[np.int64] = np.ravel_multi_index(where, self.stack).ravel()
        return number

    @cached_property
    def haar(self) -> Haar:
        """The wavelets."""
        return Haar(self.stack)

    def total(self, images: NDArray[Any]) -> Float:
        """Return sums over cells (cells, M) of images (M, N)."""
        if self.side == 1:
            return np.ascontiguousarray(images.T, np.float32)
        sums: Float = self._sums @ np.asarray(images.T, np.float32)
        return sums

    def spread(self, values: Float) -> Float:
        """Return images (M, N) that have the values (cells, M) of their cells."""
        return np.ascontiguousarray(values[self.of_ray].T)

    def shared_out(self, values: Float, over: Float) -> csr_array[np.float32]:
        """Return each cell's part of an image (N,) over a value a cell, sparse (N, cells)."""
        from scipy.sparse import csr_array

        whole = over[self.of_ray]
        shares = np.divide(values, whole, out=np.zeros_like(values), where=whole > 0)
        where = (np.arange(len(shares)), self.of_ray)
        return csr_array((shares, where), shape=(len(shares), self.count))

    @cached_property
    def _sums(self) -> csr_array[np.float32]:
        from scipy.sparse import csr_array

        rays = np.arange(len(self.of_ray))
        ones = np.ones(len(rays), np.float32)
        return csr_array((ones, (self.of_ray, rays)), shape=(self.count, len(rays)))
