"""A transport between other rays than those of its acquisition: coarser ones, or some of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.transport.algebra import Float
from rfpipe.transport.relightable import Relightable

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_AT_ONCE_BYTES = 64 * 2**20


class RegroupedTransport(Relightable):
    """Light between other rays, ``C T P`` computed at each use; see `coarser` and `crop`.

    C, `camera`, and P, `projector`, are sparse float32 (m, M) and (N, n), where T has M camera rays
    and N projector rays.
    """

    def __init__(
        self,
        whole: Relightable,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        camera: csr_array[np.float32],
        projector: csr_array[np.float32],
        name: str,
    ) -> None:
        self.channels = whole.channels
        self.camera_shape, self.projector_shape = camera_shape, projector_shape
        self._whole, self._camera, self._projector, self._name = whole, camera, projector, name

    def __repr__(self) -> str:
        return f"{self._name} of {self._whole!r}"

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        return self._applied(
            patterns,
            self._projector,
            lambda light: self._whole.forward(light, channels),
            self._camera,
        )

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        return self._applied(
            images,
            self._camera.T,
            lambda light: self._whole.adjoint(light, channels),
            self._projector.T,
        )

    def _applied(
        self, planar: Float, spread: Any, apply: Callable[[Float], Float], gather: Any
    ) -> Float:
        """Apply the whole to some light at a time, white light in the memory of one plane."""
        rays = sum(self._whole.shape[1:])
        at_a_time = max(1, _AT_ONCE_BYTES // (4 * planar.shape[1] * rays))
        images = []
        for first in range(0, max(len(planar), 1), at_a_time):
            some = planar[first : first + at_a_time]
            light = _each(spread, some[:, :1] if some.strides[1] == 0 else some)
            light = np.broadcast_to(light, (*some.shape[:2], light.shape[-1]))
            images.append(_each(gather, apply(light)))
        return np.concatenate(images)


def _each(matrix: Any, planar: Float) -> Float:
    """Return the product of a sparse matrix and each of planar images ``(P, K, rays)``."""
    product: Float = (matrix @ planar.reshape(-1, planar.shape[-1]).T).T
    return np.ascontiguousarray(product).reshape(*planar.shape[:2], -1)


def coarser(transport: Relightable, factor: int) -> RegroupedTransport:
    """Return a transport between coarser rays, squares of `factor` by `factor` of its own.

    A coarse projector ray lights all of its rays alike, a coarse camera ray sees the mean of its
    own; views stay. Where the factor doesn't divide a side, the last ones are smaller. Its matrix
    has ``factor**4`` times fewer entries.

    Parameters
    ----------
    transport : Transport
        Or a dual one.
    factor : int
        At least 1, or InputError.
    """
    if factor != int(factor) or factor < 1:
        raise InputError(f"factor is {factor}; expected a whole number of at least 1")
    camera_shape, sums = squares(transport.camera_shape, int(factor))
    projector_shape, repeated = squares(transport.projector_shape, int(factor))
    sums.data /= np.repeat(np.diff(sums.indptr), np.diff(sums.indptr))
    return RegroupedTransport(
        transport, camera_shape, projector_shape, sums, repeated.T.tocsr(), f"coarser by {factor}"
    )


def squares(shape: tuple[int, ...], side: int) -> tuple[tuple[int, ...], csr_array[np.float32]]:
    """Return the grid of `RayDomain.squares`, and the matrix (squares, rays) that adds them up."""
    from scipy.sparse import csr_array

    (views, *image), square = RayDomain(shape).squares(side)
    ones, size = np.ones(square.size, np.float32), (views * prod(image), square.size)
    matrix = csr_array((ones, (square, np.arange(square.size))), shape=size)
    return (*shape[:-2], *image), matrix


def crop(whole: Relightable, camera: Any = None, projector: Any = None) -> RegroupedTransport:
    """Return a transport between some of its rays: of a view, of a part of a picture.

    What passes between the others isn't read of leaves, as ``symmetric`` finds them. All else is
    read whole, for the same pictures.

    Parameters
    ----------
    whole : Transport
        Or a dual one.
    camera, projector : int, slice or tuple of them, optional
        Which rays, as an index of an array of its `camera_shape` or `projector_shape` that leaves
        height and width: ``4`` for the view 4 of several, ``np.s_[4, 10:20, :]`` for some rows of
        it. All by default; InputError if there are no such rays.
    """
    seen = _rays(camera, whole.camera_shape, "camera")
    lit = _rays(projector, whole.projector_shape, "projector")
    some = [
        _one_each(rays, prod(shape))
        for rays, shape in ((seen, whole.camera_shape), (lit, whole.projector_shape))
    ]
    part = whole.restricted(*(matrix.sum(axis=0) > 0 for matrix in some))
    name = f"{seen.shape} by {lit.shape} rays"
    taken = RegroupedTransport(part, seen.shape, lit.shape, some[0], some[1].T.tocsr(), name)
    taken.lights = None if whole.lights is None else whole.lights[lit.ravel()]
    taken.noise = None if whole.noise is None else whole.noise.ravel()[seen]
    return taken


def _one_each(rays: NDArray[np.int64], count: int) -> csr_array[np.float32]:
    """Return the matrix that takes some of so many rays."""
    from scipy.sparse import csr_array

    ones, starts = np.ones(rays.size, np.float32), np.arange(rays.size + 1)
    return csr_array((ones, rays.ravel(), starts), shape=(rays.size, count))


def _rays(chosen: Any, shape: tuple[int, ...], name: str) -> NDArray[np.int64]:
    every = np.arange(prod(shape), dtype=np.int64).reshape(shape)
    parts = chosen if isinstance(chosen, tuple) else (... if chosen is None else chosen,)
    plain = all(part is Ellipsis or isinstance(part, int | np.integer | slice) for part in parts)
    try:
        rays: Any = every[parts] if plain else every[:0]
    except IndexError:
        rays = every[:0]
    if rays.ndim < 2 or not rays.size:
        raise InputError(
            f"{name} = {chosen!r} of rays {shape}: expected whole numbers and slices that leave "
            "height and width, such as 4 for the view 4 of several, or np.s_[4, 10:20, :] for "
            "some rows of it"
        )
    return np.asarray(rays)
