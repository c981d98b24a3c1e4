"""Smooth functions of many scales as a chain of small sparse matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.transport.multiscale import (
    COLUMN,
    ROW,
    VIEW,
    MultiscaleBasis,
    cells,
    functions_over,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# A quadratic B-spline as the sum of those of half its width.
_REFINEMENT = np.array([1, 3, 3, 1], np.float32) / 4


def pyramid(
    basis: MultiscaleBasis,
) -> tuple[list[csr_array[np.float32]], list[tuple[int, int, NDArray[np.int32]]]]:
    """Return the functions of a basis by way of all functions of each scale.

    Those of a scale are sums of 4 x 4 of the next finer one, so that a picture takes some ten
    products a ray instead of nine a ray and scale.

    Returns
    -------
    steps : list of csr_array
        From the functions of scale 2 to rays, from those of scale 4 to those of scale 2, and on.
    places : list of (int, int, ndarray of int32)
        For each scale of the basis its binary logarithm; the number of its first function in the
        basis; and which of all functions of the scale, or of the rays, its functions are.
    """
    octaves = int(np.log2(basis.scales.max()))
    steps: list[csr_array[np.float32]] = []
    for octave in range(1, octaves + 1):
        if octave == 1:
            everything = functions_over(2, np.ones(cells(basis.shape, 2), np.bool_))
            steps.append(MultiscaleBasis(basis.shape, everything).weights)
        else:
            steps.append(_refinement(basis.shape, 2**octave))
    places = []
    for scale in np.unique(basis.scales):
        members = np.flatnonzero(basis.scales == scale)
        at = basis.functions[members][:, [VIEW, ROW, COLUMN]].astype(np.int64)
        index = np.ravel_multi_index(tuple(at.T), _grid(basis.shape, int(scale)))
        places.append((int(np.log2(scale)), int(members[0]), index.astype(np.int32)))
    return steps, places


def _grid(shape: tuple[int, ...], scale: int) -> tuple[int, int, int]:
    """Return the number of views, and of functions of a scale down and across."""
    views, rows, columns = cells(shape, scale)
    outside = 2 if scale > 1 else 0
    return views, rows + outside, columns + outside


def _refinement(shape: tuple[int, ...], scale: int) -> csr_array[np.float32]:
    """Return the functions of a scale as sums of those of half of it, (fine, coarse)."""
    from scipy.sparse import eye_array, kron

    views, *coarse = _grid(shape, scale)
    _, *fine = _grid(shape, scale // 2)
    rows, columns = (_refined(*sizes) for sizes in zip(fine, coarse, strict=True))
    matrix: Any = kron(eye_array(views), kron(rows, columns))
    return matrix.tocsr().astype(np.float32)  # type: ignore[no-any-return]


def _refined(fine: int, coarse: int) -> Any:
    """Return an axis' functions as sums of finer ones, which end where the image does."""
    from scipy.sparse import csr_array

    column, step = np.divmod(np.arange(4 * coarse), 4)
    row = 2 * column - 2 + step
    inside = (row >= 0) & (row < fine)
    where = (row[inside], column[inside])
    return csr_array((_REFINEMENT[step[inside]], where), shape=(fine, coarse))
