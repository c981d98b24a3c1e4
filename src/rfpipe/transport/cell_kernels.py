"""Compiled sums over the cells of an image, and images of the cells' values."""

from __future__ import annotations

from typing import Any

import numba
from numpy.typing import NDArray

from rfpipe.array_types import Float, Index


@numba.njit(cache=True, nogil=True)
def add_to_cells(images: NDArray[Any], factor: Float, cell: Index, sums: Float) -> None:
    """Add P images (P, N) times the factor (N,) to the sums (cells, P) of each ray's cell (N,)."""
    for p in range(len(images)):
        for ray in range(len(cell)):
            sums[cell[ray], p] += images[p, ray] * factor[ray]


@numba.njit(cache=True, nogil=True)
def spread_over_cells(values: Float, factor: Float, cell: Index, images: Float) -> None:
    """Write P images (P, N): the values (cells, P) of each ray's cell (N,) times the factor."""
    for p in range(len(images)):
        for ray in range(len(cell)):
            images[p, ray] = values[cell[ray], p] * factor[ray]
