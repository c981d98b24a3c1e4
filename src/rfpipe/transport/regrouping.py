"""Transport between coarser rays, or between a selection of the acquired rays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.array_types import Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.transport.relightable import Relightable

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_BATCH_BYTES = 64 * 2**20


class RegroupedTransport(Relightable):
    """Transport between other rays, ``C T P``, computed at each use; see `coarser` and `crop`.

    Parameters
    ----------
    transport : Relightable
        T, of M camera rays and N projector rays.
    camera_shape, projector_shape : tuple of int
        The ray domains, of m and n rays.
    camera : csr_array of float32, shape (m, M)
        C: weights of camera rays in each of the m.
    projector : csr_array of float32, shape (N, n)
        P: weights of each of the n in the projector rays.
    name : str
        Description for `repr`.
    """

    def __init__(
        self,
        transport: Relightable,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        camera: csr_array[np.float32],
        projector: csr_array[np.float32],
        name: str,
    ) -> None:
        self.channels = transport.channels
        self.camera_shape, self.projector_shape = camera_shape, projector_shape
        self._transport, self._name = transport, name
        self._camera, self._projector = camera, projector

    def __repr__(self) -> str:
        return f"{self._name} of {self._transport!r}"

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        return self._applied(
            patterns,
            self._projector,
            lambda light: self._transport.forward(light, channels),
            self._camera,
        )

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        return self._applied(
            images,
            self._camera.T,
            lambda light: self._transport.adjoint(light, channels),
            self._projector.T,
        )

    def _applied(
        self, planar: Float, spread: Any, apply: Callable[[Float], Float], gather: Any
    ) -> Float:
        """Return ``gather apply(spread p)`` in batches, white light in the memory of one plane."""
        rays = sum(self._transport.shape[1:])
        batch_size = max(1, _BATCH_BYTES // (4 * planar.shape[1] * rays))
        images = []
        for first in range(0, max(len(planar), 1), batch_size):
            batch = planar[first : first + batch_size]
            light = _multiply(spread, batch[:, :1] if batch.strides[1] == 0 else batch)
            light = np.broadcast_to(light, (*batch.shape[:2], light.shape[-1]))
            images.append(_multiply(gather, apply(light)))
        return np.concatenate(images)


def _multiply(matrix: Any, planar: Float) -> Float:
    """Return the products of a sparse matrix and planar images ``(P, K, rays)``."""
    product: Float = (matrix @ planar.reshape(-1, planar.shape[-1]).T).T
    return np.ascontiguousarray(product).reshape(*planar.shape[:2], -1)


def coarser(transport: Relightable, factor: int) -> RegroupedTransport:
    """Return a transport between squares of `factor` by `factor` rays.

    The rays of a projector square have the same weight, a camera square is the mean of its rays.
    Views are not mixed, and squares at the end of an image may be smaller. The matrix has
    ``factor**4`` times fewer entries.

    Parameters
    ----------
    transport : Relightable
    factor : int
        At least 1, or InputError.
    """
    if factor != int(factor) or factor < 1:
        raise InputError(f"factor is {factor}; expected an integer of at least 1")
    camera_shape, sums = cell_sums(transport.camera_shape, int(factor))
    projector_shape, repeated = cell_sums(transport.projector_shape, int(factor))
    sums.data /= np.repeat(np.diff(sums.indptr), np.diff(sums.indptr))
    return RegroupedTransport(
        transport, camera_shape, projector_shape, sums, repeated.T.tocsr(), f"coarser by {factor}"
    )


def cell_sums(shape: tuple[int, ...], side: int) -> tuple[tuple[int, ...], csr_array[np.float32]]:
    """Return the grid of `RayDomain.square_cells`, and the matrix (cells, rays) of their sums."""
    from scipy.sparse import csr_array

    (views, *image), cell = RayDomain(shape).square_cells(side)
    ones, size = np.ones(cell.size, np.float32), (views * prod(image), cell.size)
    matrix = csr_array((ones, (cell, np.arange(cell.size))), shape=size)
    return (*shape[:-2], *image), matrix


def crop(transport: Relightable, camera: Any = None, projector: Any = None) -> RegroupedTransport:
    """Return a transport between a selection of its rays: of a view, or of a part of a picture.

    Of a hierarchical tensor, only the leaves between the selected rays are read.

    Parameters
    ----------
    transport : Relightable
    camera, projector : int, slice or tuple of them, optional
        Index of an array of `camera_shape` or `projector_shape`, whose result has height and width:
        ``4`` for view 4 of several, ``np.s_[4, 10:20, :]`` for some rows of it. All rays by
        default; InputError if the selection has no rays.
    """
    rows = _select(camera, transport.camera_shape, "camera")
    columns = _select(projector, transport.projector_shape, "projector")
    gather = _selection_matrix(rows, prod(transport.camera_shape))
    spread = _selection_matrix(columns, prod(transport.projector_shape))
    part = transport.restricted(gather.sum(axis=0) > 0, spread.sum(axis=0) > 0)
    name = f"{rows.shape} by {columns.shape} rays"
    cropped = RegroupedTransport(part, rows.shape, columns.shape, gather, spread.T.tocsr(), name)
    cropped.lights = None if transport.lights is None else transport.lights[columns.ravel()]
    cropped.noise = None if transport.noise is None else transport.noise.ravel()[rows]
    return cropped


def _selection_matrix(rays: Index, count: int) -> csr_array[np.float32]:
    """Return the matrix (selected rays, rays) that selects rays of a domain of `count`."""
    from scipy.sparse import csr_array

    ones, starts = np.ones(rays.size, np.float32), np.arange(rays.size + 1)
    return csr_array((ones, rays.ravel(), starts), shape=(rays.size, count))


def _select(chosen: Any, shape: tuple[int, ...], name: str) -> Index:
    """Return the numbers of the rays that an index selects."""
    numbers = np.arange(prod(shape), dtype=np.int64).reshape(shape)
    parts = chosen if isinstance(chosen, tuple) else (... if chosen is None else chosen,)
    is_plain = all(part is Ellipsis or isinstance(part, int | np.integer | slice) for part in parts)
    try:
        rays: Any = numbers[parts] if is_plain else numbers[:0]
    except IndexError:
        rays = numbers[:0]
    if rays.ndim < 2 or not rays.size:
        raise InputError(
            f"{name} = {chosen!r} of rays {shape}: expected integers and slices whose result "
            "has height and width, such as 4 for view 4 of several, or np.s_[4, 10:20, :] for "
            "some rows of it"
        )
    return np.asarray(rays)
