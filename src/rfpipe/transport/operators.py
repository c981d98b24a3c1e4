"""Matrices and linear operators as light transport.

The image of a pattern is independent, to the last bit, of other patterns of the same call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float
from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import LinearOperator

__all__ = ["PatternOperator", "Transportish", "as_pattern_operator"]

Transportish: TypeAlias = Any
"""ndarray (M, N) or (C, M, N), or an array of dask, zarr or xarray; scipy sparse; LinearOperator; a
list of those, one per channel; or a `PatternOperator`."""

PATTERNS_PER_BATCH = 16
"""Columns of each matrix product; a shorter batch is padded with zeros."""

ALIGNMENT = 64
"""Rows and columns of a dense matrix are padded to multiples of this."""


class PatternOperator(Protocol):
    """Light transport as a function of patterns.

    The image of a pattern must not depend, to the last bit, on the other patterns of a call:
    otherwise a resumed capture differs from an uninterrupted one.
    """

    @property
    def channels(self) -> int:
        """Colour channels, 1 or 3."""

    def apply(self, patterns: Float) -> NDArray[Any]:
        """Return the images (B, camera rays, C) of patterns (B, projector rays)."""


def as_pattern_operator(matrix: Transportish, rows: int, columns: int) -> PatternOperator:
    """Return light transport of `rows` camera rays and `columns` projector rays as an operator.

    A sequence has one matrix per channel. Entries are finite and not negative.

    Raises
    ------
    InputError
        If the type is another one, the shape differs, or an entry is negative or not finite.
    """
    if callable(getattr(matrix, "apply", None)) and hasattr(matrix, "channels"):
        operator: PatternOperator = matrix
        return operator
    matrix = _loaded(matrix)
    if isinstance(matrix, np.ndarray) and matrix.ndim == 3:
        matrix = list(matrix)
    matrices = list(matrix) if isinstance(matrix, list | tuple) else [matrix]
    if not matrices:
        raise InputError("the transport has no channels: an empty list")
    return _Channels(
        [_channel(_loaded(item), rows, columns, i) for i, item in enumerate(matrices)], rows
    )


def _loaded(matrix: Any) -> Any:
    """Convert an array of another library to numpy; return other objects unchanged."""
    return np.asarray(matrix) if hasattr(matrix, "__array__") else matrix


class _Channels:
    """Operator of one matrix per channel."""

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
        """Return the digest of each channel's matrix, as plain data."""
        digests = [{"kind": matrix.kind, "digest": matrix.digest()} for matrix in self._matrices]
        return {"kind": "matrices", "channels": digests}


class _Matrix(NamedTuple):
    """A matrix by its products: `images` maps patterns (B, columns) to float64 (B, rows)."""

    kind: str
    images: Callable[[Float], Double]
    digest: Callable[[], str]


def _dense(matrix: Double) -> _Matrix:
    rows, columns = matrix.shape
    padded = np.pad(matrix, [(0, -rows % ALIGNMENT), (0, -columns % ALIGNMENT)])

    def images(patterns: Float) -> Double:
        count = len(patterns)
        padding = [(0, -count % PATTERNS_PER_BATCH), (0, -columns % ALIGNMENT)]
        batches = np.pad(patterns, padding).astype(np.float64)
        result = np.empty((len(batches), rows))
        for first in range(0, count, PATTERNS_PER_BATCH):
            batch = slice(first, first + PATTERNS_PER_BATCH)
            result[batch] = (batches[batch] @ padded.T)[:, :rows]
        return result[:count]

    return _Matrix("dense", images, lambda: fingerprint(padded[:rows, :columns]))


def _sparse(matrix: csr_array[Any]) -> _Matrix:
    """Wrap a sparse matrix, whose product sums each row in stored order."""
    parts = [np.asarray(part) for part in (matrix.data, matrix.indices, matrix.indptr)]
    return _Matrix(
        "sparse",
        lambda patterns: np.asarray((matrix @ patterns.T.astype(np.float64)).T),
        lambda: fingerprint(parts),
    )


def _linear(operator: LinearOperator) -> _Matrix:
    """Wrap an operator, applied to one pattern at a time; its digest is from a probe image."""
    rows, columns = operator.shape

    def images(patterns: Float) -> Double:
        vectors = [np.reshape(operator.matvec(pattern), rows) for pattern in patterns]
        return np.array(vectors, np.float64).reshape(len(patterns), rows)

    probe = np.linspace(0, 1, columns, dtype=np.float32)[None]
    return _Matrix("operator", images, lambda: fingerprint(images(probe)))


def _channel(matrix: Any, rows: int, columns: int, index: int) -> _Matrix:
    """Validate the matrix of one channel."""
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
            f"{name} has the shape {matrix.shape}; camera_shape and projector_shape "
            f"need ({rows} camera rays, {columns} projector rays), channels first"
        )
    if matrix.dtype is not None and matrix.dtype.kind not in "fiub":  # None of some operators
        raise InputError(f"{name} has dtype {matrix.dtype}; expected real numbers")
    if isinstance(matrix, LinearOperator):
        return _linear(matrix)
    array: Any
    if is_sparse:
        array = sparse.csr_array(matrix, dtype=np.float64)
        array.sum_duplicates()
    else:
        array = np.asarray(matrix, np.float64)
    entries = array.data if is_sparse else array
    if not np.all((entries >= 0) & (entries < np.inf)):  # NaN is neither
        coo = sparse.coo_array(array)
        first = np.argmin((coo.data >= 0) & (coo.data < np.inf))
        raise InputError(
            f"{name} is {coo.data[first]} at row {coo.row[first]}, column {coo.col[first]}; light "
            "transport is finite and not negative"
        )
    return _sparse(array) if is_sparse else _dense(array)
