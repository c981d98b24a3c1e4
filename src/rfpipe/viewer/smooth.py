"""Multiscale smooth functions as a chain of small sparse matrices."""

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

# Coefficients of a quadratic B-spline as a sum of B-splines of half its width.
_REFINEMENT = np.array([1, 3, 3, 1], np.float32) / 4


def pyramid(
    basis: MultiscaleBasis,
) -> tuple[list[csr_array[np.float32]], list[tuple[int, int, NDArray[np.int32]]]]:
    """Factor the functions of a basis into refinements between all functions of adjacent scales.

    A function is a sum of 4 x 4 functions of the next finer scale, so that a picture takes about
    ten multiplications per ray, instead of nine per ray and scale.

    Returns
    -------
    steps : list of csr_array
        Refinements: from scale 2 to rays, from scale 4 to scale 2, and so on.
    placements : list of (int, int, ndarray of int32)
        For each scale of the basis: its binary logarithm, the index of its first function in the
        basis, and the indices of its functions among all functions of the scale (or among rays).
    """
    octaves = int(np.log2(basis.scales.max()))
    steps: list[csr_array[np.float32]] = []
    for octave in range(1, octaves + 1):
        if octave == 1:
            functions = functions_over(2, np.ones(cells(basis.shape, 2), np.bool_))
            steps.append(MultiscaleBasis(basis.shape, functions).weights)
        else:
            steps.append(_refinement(basis.shape, 2**octave))
    placements = []
    for scale in np.unique(basis.scales):
        members = np.flatnonzero(basis.scales == scale)
        position = basis.functions[members][:, [VIEW, ROW, COLUMN]].astype(np.int64)
        index = np.ravel_multi_index(tuple(position.T), _grid(basis.shape, int(scale)))
        placements.append((int(np.log2(scale)), int(members[0]), index.astype(np.int32)))
    return steps, placements


def _grid(shape: tuple[int, ...], scale: int) -> tuple[int, int, int]:
    """Numbers of views, and of rows and columns of functions of a scale."""
    views, rows, columns = cells(shape, scale)
    outside = 2 if scale > 1 else 0
    return views, rows + outside, columns + outside


def _refinement(shape: tuple[int, ...], scale: int) -> csr_array[np.float32]:
    """Matrix (fine, coarse) of functions of a scale as sums of functions of half that scale."""
    from scipy.sparse import eye_array, kron

    views, *coarse = _grid(shape, scale)
    _, *fine = _grid(shape, scale // 2)
    rows, columns = (_refinement_1d(*sizes) for sizes in zip(fine, coarse, strict=True))
    matrix: Any = kron(eye_array(views), kron(rows, columns))
    return matrix.tocsr().astype(np.float32)  # type: ignore[no-any-return]


def _refinement_1d(fine: int, coarse: int) -> Any:
    """Refinement matrix (fine, coarse) along one axis; functions beyond the image are omitted."""
    from scipy.sparse import csr_array

    column, step = np.divmod(np.arange(4 * coarse), 4)
    row = 2 * column - 2 + step
    inside = (row >= 0) & (row < fine)
    indices = (row[inside], column[inside])
    return csr_array((_REFINEMENT[step[inside]], indices), shape=(fine, coarse))
