"""G between the points of a scene as an operator: dense, or compressed (`rfpipe.scenes.facing`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.facing import FacingPair, facing_pairs
from rfpipe.scenes.geometry import Points
from rfpipe.scenes.occluders import Occluder

__all__ = [
    "DENSE_LIMIT",
    "DenseFormFactors",
    "FormFactors",
    "form_factors",
]

# Entries of G, each unordered pair of points counted once, above which it is compressed: a quarter
# of a gigabyte of float64.
DENSE_LIMIT = 2**25


class FormFactors(Protocol):
    """The symmetric operator G on columns of N surface points."""

    @property
    def nbytes(self) -> int:
        """Bytes that the stored operator takes."""
        ...

    def apply(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Multiply G with columns (N, K), float64 in and out."""
        ...


class DenseFormFactors:
    """G with every entry stored, float64: exact, for small scenes.

    Parameters
    ----------
    pairs
        The facing surfaces.
    """

    def __init__(self, pairs: Sequence[FacingPair]) -> None:
        self.blocks = tuple((*pair.indices, pair.block()) for pair in pairs)

    @property
    def nbytes(self) -> int:
        """Bytes of the stored entries."""
        return sum(block.nbytes for _, _, block in self.blocks)

    def apply(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Multiply G with columns (N, K), float64 in and out."""
        out = np.zeros_like(columns)
        for first, second, block in self.blocks:
            out[first] += block @ columns[second]
            out[second] += block.T @ columns[first]
        return out


def form_factors(
    points: Points, occluders: Sequence[Occluder] = (), *, compress: bool | None = None
) -> FormFactors:
    """Build G: dense for small scenes, compressed above `DENSE_LIMIT` entries.

    Parameters
    ----------
    points
        The scene's surface points.
    occluders
        What may stand between them.
    compress
        Compress (True) or store densely (False) whatever the size; None decides by the size.

    Returns
    -------
    FormFactors
    """
    pairs = facing_pairs(points, occluders)
    if compress or (compress is None and sum(pair.size for pair in pairs) > DENSE_LIMIT):
        from rfpipe.scenes.compression import CompressedFormFactors  # brings in numba

        return CompressedFormFactors(pairs)
    return DenseFormFactors(pairs)
