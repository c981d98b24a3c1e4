"""Matrices and linear operators as light transport, each pattern's image independent of others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import LinearOperator

__all__ = ["PatternOperator", "Transportish", "as_pattern_operator"]

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Transportish: TypeAlias = Any
"""ndarray (M, N) or (C, M, N), scipy sparse, LinearOperator, a list of those, one a channel, or a
`PatternOperator`."""

PATTERNS_AT_ONCE = 16
"""Columns of every matrix product; a shorter batch is filled up with zeros."""

ALIGNMENT = 64
"""Rows and columns of a dense matrix are filled up to multiples of this."""


class PatternOperator(Protocol):
    """Light transport as a function of patterns.

    The image of a pattern must not depend, to the last bit, on the patterns that it comes with:
    else a capture that was resumed in the middle of a batch differs from an undisturbed one.
    """

    @property
    def channels(self) -> int:
        """Colour channels, 1 or 3."""

    def apply(self, patterns: Float) -> NDArray[Any]:
        """Return the images (B, camera rays, C) of patterns (B, projector rays)."""


def as_pattern_operator(matrix: Transportish, rows: int, columns: int) -> PatternOperator:
    """Return light transport of `rows` camera rays and `columns` projector rays as an operator.

    Parameters
    ----------
    matrix : ndarray, sparse matrix, LinearOperator, sequence of those, or PatternOperator
        A sequence holds one matrix a channel. Entries are finite and not negative.
    rows, columns : int

    Returns
    -------
    PatternOperator

    Raises
    ------
    InputError
        When it is none of these, has another shape, or holds a negative or non-finite entry.
    """
    if callable(getattr(matrix, "apply", None)) and hasattr(matrix, "channels"):
        operator: PatternOperator = matrix
        return operator
    if isinstance(matrix, np.ndarray) and matrix.ndim == 3:
        if matrix.shape[:2] == (rows, columns) and matrix.shape[1:] != (rows, columns):
            raise InputError(
                f"the transport has the shape {matrix.shape}, its channels last; expected "
                f"{(matrix.shape[2], rows, columns)}: give numpy.moveaxis(matrix, -1, 0)"
            )
        matrix = list(matrix)
    given = list(matrix) if isinstance(matrix, list | tuple) else [matrix]
    if not given:
        raise InputError("the transport has no channels: an empty list")
    return _Channels([_channel(item, rows, columns, i) for i, item in enumerate(given)], rows)


class _Channels:
    """One matrix a channel."""

    def __init__(self, matrices: Sequence[_Matrix], rows: int) -> None:
        self._matrices = matrices
        self._rows = rows

    @property
    def channels(self) -> int:
        """Number of matrices."""
        return len(self._matrices)

    def apply(self, patterns: Float) -> Float:
        """Return the images (B, rows, C) of patterns (B, columns)."""
        images = np.empty((len(patterns), self._rows, self.channels), np.float32)
        for index, matrix in enumerate(self._matrices):
            images[..., index] = matrix.images(patterns)
        return images

    def describe(self) -> dict[str, Any]:
        """Plain data: the digest of each channel's matrix."""
        return {"kind": "matrices", "channels": [matrix.describe() for matrix in self._matrices]}


class _Dense:
    """A dense matrix in float64."""

    def __init__(self, matrix: Double) -> None:
        rows, columns = matrix.shape
        self._shape = (rows, columns)
        self._matrix = np.zeros((_filled(rows), _filled(columns)))
        self._matrix[:rows, :columns] = matrix

    def images(self, patterns: Float) -> Double:
        """Return (B, rows)."""
        rows, columns = self._shape
        result = np.empty((len(patterns), rows))
        for first in range(0, len(patterns), PATTERNS_AT_ONCE):
            batch = patterns[first : first + PATTERNS_AT_ONCE]
            filled = np.zeros((PATTERNS_AT_ONCE, self._matrix.shape[1]))
            filled[: len(batch), :columns] = batch
            result[first : first + len(batch)] = (filled @ self._matrix.T)[: len(batch), :rows]
        return result

    def describe(self) -> dict[str, Any]:
        rows, columns = self._shape
        return {"kind": "dense", "digest": fingerprint(self._matrix[:rows, :columns])}


class _Sparse:
    """A sparse matrix in float64, whose product sums each row in stored order."""

    def __init__(self, matrix: csr_array[Any]) -> None:
        self._matrix = matrix

    def images(self, patterns: Float) -> Double:
        """Return (B, rows)."""
        columns = patterns.T.astype(np.float64)
        return np.asarray((self._matrix @ columns).T)

    def describe(self) -> dict[str, Any]:
        parts = [self._matrix.data, self._matrix.indices, self._matrix.indptr]
        return {"kind": "sparse", "digest": fingerprint([np.asarray(part) for part in parts])}


class _Linear:
    """A scipy LinearOperator, applied to one pattern at a time."""

    def __init__(self, operator: LinearOperator) -> None:
        self._operator = operator

    def images(self, patterns: Float) -> Double:
        """Return (B, rows)."""
        rows = self._operator.shape[0]
        images = [np.reshape(self._operator.matvec(pattern), rows) for pattern in patterns]
        return np.array(images, np.float64).reshape(len(patterns), rows)

    def describe(self) -> dict[str, Any]:
        """Plain data; an operator has no digest, so its probe image stands for it."""
        probe = np.linspace(0, 1, self._operator.shape[1], dtype=np.float32)
        return {"kind": "operator", "digest": fingerprint(self.images(probe[None]))}


_Matrix: TypeAlias = _Dense | _Sparse | _Linear


def _channel(matrix: Any, rows: int, columns: int, index: int) -> _Matrix:
    """Return one channel's matrix, checked."""
    from scipy import sparse
    from scipy.sparse.linalg import LinearOperator

    name = f"transport of channel {index}"
    is_sparse = bool(sparse.issparse(matrix))
    if not (is_sparse or isinstance(matrix, np.ndarray | LinearOperator)):
        raise InputError(
            f"{name} is a {type(matrix).__name__}; expected an ndarray, a scipy sparse matrix, a "
            "scipy LinearOperator, or an object with apply() and channels"
        )
    if matrix.shape != (rows, columns):
        raise InputError(
            f"{name} has the shape {matrix.shape}; camera_shape and projector_shape want "
            f"({rows} camera rays, {columns} projector rays)"
        )
    if isinstance(matrix, LinearOperator):
        return _Linear(matrix)
    if is_sparse:
        stored = sparse.csr_array(matrix, dtype=np.float64)
        stored.sum_duplicates()
        rows_of_entries = np.repeat(np.arange(rows), np.diff(stored.indptr))
        _check_entries(stored.data, name, lambda i: (rows_of_entries[i], stored.indices[i]))
        return _Sparse(stored)
    if matrix.dtype.kind not in "fiub":
        raise InputError(f"{name} has dtype {matrix.dtype}; expected real numbers")
    dense = np.asarray(matrix, np.float64)
    _check_entries(dense.ravel(), name, lambda i: divmod(i, columns))
    return _Dense(dense)


def _check_entries(entries: Double, name: str, locate: Any) -> None:
    """Raise InputError at the first entry that is negative or not finite."""
    is_right = (entries >= 0) & (entries < np.inf)  # NaN is neither
    if not is_right.all():
        index = int(np.argmin(is_right))
        row, column = locate(index)
        raise InputError(
            f"{name} is {entries[index]} at row {int(row)}, column {int(column)}; light transport "
            "is finite and not negative"
        )


def _filled(count: int) -> int:
    return -(-count // ALIGNMENT) * ALIGNMENT
