"""G between the points of a scene as an operator: dense, or compressed (`rfpipe.scenes.facing`)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.facing import FacingPair, facing_pairs
from rfpipe.scenes.geometry import Points
from rfpipe.scenes.occluders import Occluder

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["DENSE_LIMIT", "DenseBlock", "FormFactors", "form_factors"]

# Entries of G, each unordered pair of points counted once, above which it is compressed: a quarter
# of a gigabyte of float64.
DENSE_LIMIT = 2**25


class Block(Protocol):
    """G between two surfaces, stored in some way."""

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""

    def add_to(self, out: NDArray[np.float64], columns: NDArray[np.float64]) -> None:
        """Add this block of G, and its transpose, times columns (N, K) to out (N, K)."""


class DenseBlock:
    """A block with every entry stored, float64: exact, for small scenes."""

    def __init__(self, pair: FacingPair) -> None:
        self._indices = pair.indices
        self._entries = pair.block()

    @property
    def nbytes(self) -> int:
        """Bytes of the stored entries."""
        return self._entries.nbytes

    def add_to(self, out: NDArray[np.float64], columns: NDArray[np.float64]) -> None:
        """Add this block of G, and its transpose, times columns (N, K) to out (N, K)."""
        first, second = self._indices
        out[first] += self._entries @ columns[second]
        out[second] += self._entries.T @ columns[first]


class FormFactors:
    """The symmetric operator G on columns of N surface points.

    Parameters
    ----------
    blocks
        Of each pair of surfaces, in the order in which they are added up.
    of_point
        int64 (N,): the point of the blocks that stands for each of the N; None where they are the
        same.
    """

    def __init__(self, blocks: Sequence[Block], of_point: NDArray[np.int64] | None = None) -> None:
        self.blocks = tuple(blocks)
        self._of_point = of_point

    @property
    def nbytes(self) -> int:
        """Bytes that the stored operator takes."""
        return sum(block.nbytes for block in self.blocks)

    @cached_property
    def _sums(self) -> csr_array[np.float64]:
        """The matrix that adds up what each point of the blocks stands for."""
        from scipy.sparse import csr_array

        assert self._of_point is not None
        count = np.arange(len(self._of_point))
        return csr_array((np.ones(len(count)), (self._of_point, count)))

    def apply(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Multiply G with columns (N, K), float64 in and out."""
        if self._of_point is not None:
            columns = np.asarray(self._sums @ columns)
        out = np.zeros_like(columns)
        for block in self.blocks:
            block.add_to(out, columns)
        return out if self._of_point is None else out[self._of_point]


def form_factors(
    points: Points,
    occluders: Sequence[Occluder] = (),
    *,
    compress: bool | None = None,
    of_point: NDArray[np.int64] | None = None,
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
    of_point
        int64 (N,): which of the points stands for each of N finer ones, where G is to be theirs.

    Returns
    -------
    FormFactors
    """
    pairs = facing_pairs(points, occluders)
    if compress or (compress is None and sum(pair.size for pair in pairs) > DENSE_LIMIT):
        from rfpipe.scenes.compression import CompressedBlock  # brings in numba

        return FormFactors([CompressedBlock(pair) for pair in pairs], of_point)
    return FormFactors([DenseBlock(pair) for pair in pairs], of_point)
