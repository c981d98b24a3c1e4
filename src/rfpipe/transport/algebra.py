"""Transport as a matrix: products, entries and their size in memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.array_types import Float, Index
from rfpipe.errors import InputError
from rfpipe.weights import as_weights

RaySelection = ArrayLike | slice | None
"""Rays of a domain: numbers, row by row from 0; a mask of the domain; a slice; or None for all."""

MEMORY_BUDGET = 4 * 2**30
"""Bytes that a transport, or a matrix made from it, may take in memory by default."""

BATCH_MULTIPLE = 8
"""Rows, or columns, in each part of `MatrixAlgebra.blocks` except the last are a multiple of it."""

_BLOCK_BYTES = 32 * 2**20
_FLOAT_BYTES = 4


class MatrixAlgebra(ABC):
    """Matrices ``(channels, camera rays, projector rays)`` that are given by their products.

    ``T @ x`` and ``x @ T`` are equal to ``T.toarray() @ x`` and ``x @ T.toarray()``, without the
    matrix in memory. Rays are numbered in C order, as in ``pattern.ravel()``.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    channels: int

    __array_ufunc__ = (
        None  # numpy would otherwise treat the transport of `x @ T` as an object array
    )

    @abstractmethod
    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, projector rays)``, K = ``len(channels)``."""

    @abstractmethod
    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, camera rays)``, K = ``len(channels)``."""

    dtype = np.dtype(np.float32)
    """Data type of `toarray`."""
    ndim = 3
    """Axes of `toarray`: channels, camera rays, projector rays."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of `toarray`: channels, camera rays, projector rays."""
        return self.channels, prod(self.camera_shape), prod(self.projector_shape)

    def __matmul__(self, x: ArrayLike) -> Float:
        """Multiply from the left: ``(N,)``, ``(N, K)`` or ``(C, N, K)``, N projector rays.

        Returns
        -------
        ndarray of float32, shape (C, M) or (C, M, K)

        Raises
        ------
        InputError
            For another shape, such as an image, which is for `relight`; for NaN,
            infinities, and integers other than 0, 1 and -1.
        """
        return self._product(x, -2, "T @ x", "(N,), (N, K) or (C, N, K), N projector rays")

    def __rmatmul__(self, x: ArrayLike) -> Float:
        """Multiply from the right: ``(M,)``, ``(K, M)`` or ``(C, K, M)``, M camera rays.

        Returns
        -------
        ndarray of float32, shape (C, N) or (C, K, N); errors as ``T @ x``
        """
        return self._product(x, -1, "x @ T", "(M,), (K, M) or (C, K, M), M camera rays")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return `toarray`, for functions of numpy."""
        return np.asarray(self.toarray(), dtype)

    def toarray(
        self,
        rows: RaySelection = None,
        columns: RaySelection = None,
        *,
        memory_budget: int = MEMORY_BUDGET,
    ) -> Float:
        """Return the matrix, or some rows and columns of it.

        Parameters
        ----------
        rows, columns : array_like of int or bool, slice, or None
            Camera rays and projector rays, see `RaySelection`; all by default.
        memory_budget : int
            Bytes that the matrix may take; InputError if it takes more.

        Returns
        -------
        ndarray of float32, shape (channels, rows, columns)
            Radiance of a camera ray per weight of a projector ray.
        """
        chosen_rows = selected_rays(rows, self.camera_shape, "rows")
        chosen_columns = selected_rays(columns, self.projector_shape, "columns")
        shape = self.channels, len(chosen_rows), len(chosen_columns)
        advice = "choose rows or columns, take rfpipe.coarser(T, 4), or multiply without it: T @ x"
        check_size("a matrix", shape, memory_budget, advice)
        matrix = np.empty(shape, np.float32)
        for row_range, column_range, block in self.blocks(chosen_rows, chosen_columns):
            matrix[:, row_range, column_range] = block
        return matrix

    def blocks(
        self,
        rows: Index,
        columns: Index,
        *,
        by_rows: bool | None = None,
        channels: Sequence[int] | None = None,
    ) -> Iterator[tuple[slice, slice, Float]]:
        """Yield the matrix of some rays in parts of about 32 MiB, computed by relighting.

        The parts are whole rows if `by_rows`, else whole columns; by default the kind of which
        there are fewer.

        Yields
        ------
        row_range, column_range : slice
            Position of the part in `rows` and in `columns`.
        block : ndarray of float32, shape (channels, rows, columns)
        """
        if by_rows is None:
            by_rows = len(rows) <= len(columns)
        lit, received = (rows, columns) if by_rows else (columns, rows)
        chosen = range(self.channels) if channels is None else channels
        _, cameras, projectors = self.shape
        n_lit, n_received = (cameras, projectors) if by_rows else (projectors, cameras)
        apply = self.adjoint if by_rows else self.forward
        bytes_per_pattern = _FLOAT_BYTES * (n_lit + 2 * len(chosen) * n_received)
        batch = BATCH_MULTIPLE * max(1, _BLOCK_BYTES // (BATCH_MULTIPLE * bytes_per_pattern))
        for first in range(0, len(lit), batch):
            rays = lit[first : first + batch]
            single_rays = np.zeros((len(rays), 1, n_lit), np.float32)
            single_rays[np.arange(len(rays)), 0, rays] = 1
            light = np.broadcast_to(single_rays, (len(rays), len(chosen), n_lit))
            entries = apply(light, chosen)[..., received]
            lit_range, received_range = slice(first, first + len(rays)), slice(0, len(received))
            if by_rows:
                yield lit_range, received_range, entries.swapaxes(0, 1)
            else:
                yield received_range, lit_range, np.moveaxis(entries, 0, -1)

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Relight each camera ray under its own pattern, float32 (camera rays,).

        `patterns` P are sparse, (camera rays, projector rays), a pattern in each row. The result is
        the diagonal of ``T P^T``. This implementation reads the rows of the matrix.
        """
        rays = np.flatnonzero(np.diff(patterns.indptr))
        image = np.zeros(patterns.shape[0], np.float32)
        parts = self.blocks(rays, np.arange(self.shape[2]), by_rows=True, channels=[channel])
        for rows, _, entries in parts:
            image[rays[rows]] = (patterns[rays[rows]] * entries[0]).sum(axis=1)
        return image

    def _product(self, x: ArrayLike, axis: int, product: str, expected: str) -> Float:
        """Return ``T @ x`` (the rays are axis -2 of x) or ``x @ T`` (they are axis -1)."""
        vectors = as_weights(x, f"x of {product}").astype(np.float32, copy=False)
        forward = axis == -2
        shape = self.projector_shape if forward else self.camera_shape
        axis = -1 if vectors.ndim == 1 else axis
        in_channels = vectors.ndim < 3 or vectors.shape[0] in (1, self.channels)
        if not (1 <= vectors.ndim <= 3 and vectors.shape[axis] == prod(shape) and in_channels):
            raise InputError(
                f"x of {product} has the shape {vectors.shape}; expected {expected} = "
                f"{prod(shape):,}. For light as an image, {shape}, it is "
                f"{'T' if forward else 'T.T'}.relight(x)"
            )
        if not np.isfinite(vectors).all():
            raise InputError(f"x of {product} holds NaN or infinite values; all must be finite")
        planar = np.moveaxis(np.atleast_2d(vectors), axis, -1)
        planar = planar.swapaxes(0, 1) if vectors.ndim == 3 else planar[:, None]
        # white light is the same memory for each channel
        light = np.broadcast_to(
            np.ascontiguousarray(planar), (len(planar), self.channels, planar.shape[-1])
        )
        images = (self.forward if forward else self.adjoint)(light, range(self.channels))
        return images[0] if vectors.ndim == 1 else np.moveaxis(images, 0, -1 if forward else -2)


def selected_rays(rays: RaySelection, shape: tuple[int, ...], name: str) -> Index:
    """Return the numbers of the selected rays of a domain; InputError, with `name`, if none are."""
    numbers = np.arange(prod(shape))
    index = rays if rays is None or isinstance(rays, slice) else np.asarray(rays)
    if isinstance(index, np.ndarray) and index.size:
        index = index.ravel()
    try:
        selected: Index = numbers if index is None else numbers[index]
    except IndexError as error:
        raise InputError(f"{name}: {error}; expected numbers or a mask of rays {shape}") from error
    if not len(selected):
        raise InputError(f"{name}: the selection has none of the {len(numbers):,} rays; select one")
    return selected


def check_size(name: str, shape: tuple[int, ...], limit_bytes: int, advice: str) -> None:
    """Raise InputError, with a name and advice, if a float32 array is larger than a limit."""
    nbytes = _FLOAT_BYTES * prod(shape)
    if nbytes > limit_bytes:
        raise InputError(
            f"{name} of {' x '.join(f'{length:,}' for length in shape)} entries takes "
            f"{gibibytes(nbytes)}, the limit is {gibibytes(limit_bytes)}; {advice}"
        )


def gibibytes(size: int) -> str:
    """Format a number of bytes in MiB or GiB."""
    return f"{size / 2**30:,.1f} GiB" if size >= 2**30 else f"{size / 2**20:,.1f} MiB"
