"""A transport between other rays than those of its acquisition: coarser ones, or some of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.transport.base import Float, Light

_AT_ONCE_BYTES = 64 * 2**20


class _Regrouped(Light):
    """Light between other rays, computed from the whole at each use.

    Parameters
    ----------
    whole : Light
    camera_shape, projector_shape : tuple of int
    """

    def __init__(
        self, whole: Light, camera_shape: tuple[int, ...], projector_shape: tuple[int, ...]
    ) -> None:
        self.whole, self.channels = whole, whole.channels
        self.camera_shape, self.projector_shape = camera_shape, projector_shape

    def _applied(
        self,
        planar: Float,
        spread: Callable[[Float], Float],
        apply: Callable[[Float], Float],
        gather: Callable[[Float], Float],
    ) -> Float:
        """Spread planar light over the whole's rays, apply it, and gather, a few at a time."""
        rays = sum(self.whole.matrix_shape[1:])
        at_a_time = max(1, _AT_ONCE_BYTES // (4 * planar.shape[1] * rays))
        found = []
        for first in range(0, max(len(planar), 1), at_a_time):
            some = planar[first : first + at_a_time]
            # white light stays the memory of one plane
            light = spread(some[:, :1] if some.strides[1] == 0 else some)
            found.append(gather(apply(np.broadcast_to(light, (*some.shape[:2], light.shape[-1])))))
        return np.concatenate(found)


def coarser(transport: Light, factor: int) -> CoarserTransport:
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
    return CoarserTransport(transport, int(factor))


class CoarserTransport(_Regrouped):
    """What `coarser` returns."""

    def __init__(self, fine: Light, factor: int) -> None:
        self.factor = factor
        self._fine = fine.camera_shape, fine.projector_shape
        super().__init__(fine, *(self._coarse(shape) for shape in self._fine))
        self._sizes = _sums(np.ones(fine.camera_shape, np.float32), factor).reshape(-1)

    def __repr__(self) -> str:
        return f"coarser({self.whole!r}, {self.factor})"

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        camera, projector = self._fine
        return self._applied(
            patterns,
            lambda light: self._spread(light, projector),
            lambda light: self.whole.forward(light, channels),
            lambda images: self._gathered(images, camera) / self._sizes,
        )

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        camera, projector = self._fine
        return self._applied(
            images,
            lambda light: self._spread(light / self._sizes, camera),
            lambda light: self.whole.adjoint(light, channels),
            lambda images: self._gathered(images, projector),
        )

    def _coarse(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        return *shape[:-2], *(-(-side // self.factor) for side in shape[-2:])

    def _spread(self, planar: Float, fine: tuple[int, ...]) -> Float:
        """Give each fine ray the value of its coarse one."""
        images = planar.reshape(*planar.shape[:2], *self._coarse(fine))
        spread = images.repeat(self.factor, axis=-2).repeat(self.factor, axis=-1)
        within = np.ascontiguousarray(spread[..., : fine[-2], : fine[-1]])
        return within.reshape(*planar.shape[:2], -1)

    def _gathered(self, planar: Float, fine: tuple[int, ...]) -> Float:
        """Sum each coarse ray's fine ones."""
        images = planar.reshape(*planar.shape[:2], *fine)
        return _sums(images, self.factor).reshape(*planar.shape[:2], -1)


def crop(whole: Light, camera: Any = None, projector: Any = None) -> CroppedTransport:
    """Return a transport between some of its rays: of a view, of a part of a picture.

    What passes between the others isn't read where the method keeps it apart: by ``symmetric``,
    and, for the camera's rays, by ``footprints``. Others are read whole, for the same pictures.

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
    masks = [np.zeros(prod(shape), bool) for shape in (whole.camera_shape, whole.projector_shape)]
    for mask, rays in zip(masks, (seen, lit), strict=True):
        mask[rays.reshape(-1)] = True
    return CroppedTransport(whole.between_some(*masks), seen, lit)


class CroppedTransport(_Regrouped):
    """What `crop` returns.

    Parameters
    ----------
    whole : Light
        Of which what passes between the other rays may be missing.
    seen, lit : ndarray of int64
        The camera's and the projector's rays, in the shape that they have here.
    """

    def __init__(self, whole: Light, seen: NDArray[np.int64], lit: NDArray[np.int64]) -> None:
        super().__init__(whole, seen.shape, lit.shape)
        self._seen, self._lit = seen.reshape(-1), lit.reshape(-1)

    def __repr__(self) -> str:
        return f"{self.whole!r} between {self.camera_shape} and {self.projector_shape} of its rays"

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        return self._applied(
            patterns,
            lambda light: _scattered(light, self._lit, prod(self.whole.projector_shape)),
            lambda light: self.whole.forward(light, channels),
            lambda images: images[..., self._seen],
        )

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        return self._applied(
            images,
            lambda light: _scattered(light, self._seen, prod(self.whole.camera_shape)),
            lambda light: self.whole.adjoint(light, channels),
            lambda images: images[..., self._lit],
        )


def square_means(images: Float, factor: int) -> Float:
    """Return the means of squares of images ``(..., H, W)``; the last ones may be smaller."""
    return _sums(images, factor) / _sums(np.ones(images.shape[-2:], np.float32), factor)


def _sums(images: Float, factor: int) -> Float:
    """Sum squares of images ``(..., H, W)``."""
    for axis in (-2, -1):
        images = np.add.reduceat(images, np.arange(0, images.shape[axis], factor), axis=axis)
    return images


def _scattered(planar: Float, rays: NDArray[np.int64], count: int) -> Float:
    """Return planar light of some rays as that of all."""
    light = np.zeros((*planar.shape[:2], count), np.float32)
    light[..., rays] = planar
    return light


def _rays(chosen: Any, shape: tuple[int, ...], name: str) -> NDArray[np.int64]:
    every = np.arange(prod(shape), dtype=np.int64).reshape(shape)
    if chosen is None:
        return every
    parts = chosen if isinstance(chosen, tuple) else (chosen,)
    plain = all(part is Ellipsis or isinstance(part, int | np.integer | slice) for part in parts)
    try:
        found: Any = every[parts] if plain else None
    except IndexError:
        found = None
    if found is None or found.ndim < 2 or not found.size:
        raise InputError(
            f"{name} = {chosen!r} of rays {shape}: expected whole numbers and slices that leave "
            "height and width, such as 4 for the view 4 of several, or np.s_[4, 10:20, :] for "
            "some rows of it"
        )
    return np.asarray(found)
