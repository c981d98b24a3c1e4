"""A transport as the matrix that it is: products, entries, and how large they are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError
from rfpipe.weights import as_weights

Float = NDArray[np.float32]
Index = NDArray[np.int64]
RaySelection = ArrayLike | slice | None
"""Rays of a domain: numbers, row by row from 0; a mask of the domain; a slice; or None for all."""

MEMORY_BUDGET = 4 * 2**30
"""Bytes of a transport, or of a matrix made of it, that are taken into memory by default."""

AT_A_TIME = 8
"""Rows, or columns, of which `MatrixAlgebra.blocks` gives a multiple in all parts but the last."""

_BLOCK_BYTES = 32 * 2**20
_FLOAT = 4


class MatrixAlgebra(ABC):
    """What a transport and its dual do as matrices ``(channels, camera rays, projector rays)``.

    ``T @ x`` and ``x @ T`` are what numpy makes of ``T.toarray() @ x`` and ``x @ T.toarray()``,
    without the matrix being made. The rays of a domain count in C order, as ``pattern.ravel()``
    has them.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    channels: int

    __array_ufunc__ = None  # or numpy would loop over the transport of `x @ T` as over an object

    @abstractmethod
    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, projector rays)``, K = ``len(channels)``."""

    @abstractmethod
    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, camera rays)``, K = ``len(channels)``."""

    dtype = np.dtype(np.float32)
    """That of `toarray`."""
    ndim = 3
    """Of `toarray`: channels, camera rays, projector rays."""

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
            For another shape, as a pattern's, which is for `relight`; for NaN, infinities, and
            the whole numbers of a picture.
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
        """Return `toarray`, for numpy's functions."""
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
            Bytes that the matrix may take; InputError if it would take more.

        Returns
        -------
        ndarray of float32, shape (channels, rows, columns)
            Radiance of a camera ray per weight of a projector ray.
        """
        chosen_rows = selected_rays(rows, self.camera_shape, "rows")
        chosen_columns = selected_rays(columns, self.projector_shape, "columns")
        shape = self.channels, len(chosen_rows), len(chosen_columns)
        advice = "choose rows or columns, take rfpipe.coarser(T, 4), or multiply without it: T @ x"
        refuse_larger("a matrix", shape, memory_budget, advice)
        matrix = np.empty(shape, np.float32)
        for rows_, columns_, block in self.blocks(chosen_rows, chosen_columns):
            matrix[:, rows_, columns_] = block
        return matrix

    def blocks(
        self,
        rows: Index,
        columns: Index,
        *,
        by_rows: bool | None = None,
        channels: Sequence[int] | None = None,
    ) -> Iterator[tuple[slice, slice, Float]]:
        """Yield the matrix of some rays in parts of some MB, as relighting gives them.

        Yields which of the `rows` and of the `columns`, and their entries, float32 (channels, rows,
        columns). The parts are whole rows if `by_rows`, else whole columns; by default what is
        fewer.
        """
        if by_rows is None:
            by_rows = len(rows) <= len(columns)
        lit, seen = (rows, columns) if by_rows else (columns, rows)
        chosen = range(self.channels) if channels is None else channels
        _, cameras, projectors = self.shape
        size_lit, size_seen = (cameras, projectors) if by_rows else (projectors, cameras)
        apply = self.adjoint if by_rows else self.forward
        bytes_of_one = _FLOAT * (size_lit + 2 * len(chosen) * size_seen)
        at_a_time = AT_A_TIME * max(1, _BLOCK_BYTES // (AT_A_TIME * bytes_of_one))
        for first in range(0, len(lit), at_a_time):
            part = lit[first : first + at_a_time]
            one_each = np.zeros((len(part), 1, size_lit), np.float32)
            one_each[np.arange(len(part)), 0, part] = 1
            light = np.broadcast_to(one_each, (len(part), len(chosen), size_lit))
            entries = apply(light, chosen)[..., seen]
            of_lit, of_seen = slice(first, first + len(part)), slice(0, len(seen))
            if by_rows:
                yield of_lit, of_seen, entries.swapaxes(0, 1)
            else:
                yield of_seen, of_lit, np.moveaxis(entries, 0, -1)

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return what each camera ray sees under a pattern of its own, float32 (camera rays,).

        `patterns` are sparse (camera rays, projector rays). What isn't made for it is read as rows
        of the matrix, as `blocks` does.
        """
        rays = np.flatnonzero(np.diff(patterns.indptr))
        seen = np.zeros(patterns.shape[0], np.float32)
        parts = self.blocks(rays, np.arange(self.shape[2]), by_rows=True, channels=[channel])
        for rows, _, entries in parts:
            seen[rays[rows]] = (patterns[rays[rows]] * entries[0]).sum(axis=1)
        return seen

    def _product(self, x: ArrayLike, axis: int, product: str, expected: str) -> Float:
        """Return ``T @ x``, whose rays are x's axis -2, or ``x @ T``, where they are its last."""
        vectors = as_weights(x, f"x of {product}").astype(np.float32, copy=False)
        left = axis == -2
        shape = self.projector_shape if left else self.camera_shape
        axis = -1 if vectors.ndim == 1 else axis
        in_channels = vectors.ndim < 3 or vectors.shape[0] in (1, self.channels)
        if not (1 <= vectors.ndim <= 3 and vectors.shape[axis] == prod(shape) and in_channels):
            raise InputError(
                f"x of {product} has the shape {vectors.shape}; expected {expected} = "
                f"{prod(shape):,}. For light as an image, {shape}, it is "
                f"{'T' if left else 'T.T'}.relight(x)"
            )
        if not np.isfinite(vectors).all():
            raise InputError(f"x of {product} holds NaN or infinite values; all must be finite")
        planar = np.moveaxis(np.atleast_2d(vectors), axis, -1)
        planar = planar.swapaxes(0, 1) if vectors.ndim == 3 else planar[:, None]
        # white light is the same memory for each channel
        light = np.broadcast_to(
            np.ascontiguousarray(planar), (len(planar), self.channels, planar.shape[-1])
        )
        images = (self.forward if left else self.adjoint)(light, range(self.channels))
        return images[0] if vectors.ndim == 1 else np.moveaxis(images, 0, -1 if left else -2)


def selected_rays(rays: RaySelection, shape: tuple[int, ...], name: str) -> Index:
    """Return the numbers of some rays of a domain; InputError, by `name`, if there are none."""
    every = np.arange(prod(shape))
    index = rays if rays is None or isinstance(rays, slice) else np.asarray(rays)
    if isinstance(index, np.ndarray) and index.size:
        index = index.ravel()
    try:
        numbers: Index = every if index is None else every[index]
    except IndexError as error:
        raise InputError(f"{name}: {error}; expected numbers or a mask of rays {shape}") from error
    if not len(numbers):
        raise InputError(f"{name}: no rays are chosen of {len(every):,}")
    return numbers


def refuse_larger(name: str, shape: tuple[int, ...], limit_bytes: int, advice: str) -> None:
    """Raise InputError, by a name and with advice, where a float32 array is beyond a limit."""
    nbytes = _FLOAT * prod(shape)
    if nbytes > limit_bytes:
        raise InputError(
            f"{name} of {' x '.join(f'{length:,}' for length in shape)} entries takes "
            f"{gibibytes(nbytes)}, the limit is {gibibytes(limit_bytes)}; {advice}"
        )


def gibibytes(size: int) -> str:
    """Return a size in memory, for people."""
    return f"{size / 2**30:,.1f} GiB" if size >= 2**30 else f"{size / 2**20:,.1f} MiB"
