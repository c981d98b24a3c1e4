"""A transport between other rays than those of its acquisition: coarser ones, or some of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.transport.base import Float, Light

_AT_ONCE_BYTES = 64 * 2**20

Map = Callable[[Float], Float]


class Side(NamedTuple):
    """Other rays of a domain.

    Attributes
    ----------
    shape : tuple of int
    spread, gather : callable
        From planar light of these rays to all rays of the domain, and back.
    """

    shape: tuple[int, ...]
    spread: Map
    gather: Map


class RegroupedTransport(Light):
    """Light between other rays, computed from the whole at each use; see `coarser` and `crop`."""

    def __init__(self, whole: Light, camera: Side, projector: Side, name: str) -> None:
        self.channels = whole.channels
        self.camera_shape, self.projector_shape = camera.shape, projector.shape
        self._whole, self._camera, self._projector, self._name = whole, camera, projector, name

    def __repr__(self) -> str:
        return f"{self._name} of {self._whole!r}"

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        return self._applied(
            patterns,
            self._projector.spread,
            lambda light: self._camera.gather(self._whole.forward(light, channels)),
        )

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        return self._applied(
            images,
            self._camera.spread,
            lambda light: self._projector.gather(self._whole.adjoint(light, channels)),
        )

    def _applied(self, planar: Float, spread: Map, apply: Map) -> Float:
        """Apply the whole to some light at a time, white light in the memory of one plane."""
        rays = sum(self._whole.matrix_shape[1:])
        at_a_time = max(1, _AT_ONCE_BYTES // (4 * planar.shape[1] * rays))
        found = []
        for first in range(0, max(len(planar), 1), at_a_time):
            some = planar[first : first + at_a_time]
            light = spread(some[:, :1] if some.strides[1] == 0 else some)
            found.append(apply(np.broadcast_to(light, (*some.shape[:2], light.shape[-1]))))
        return np.concatenate(found)


def coarser(transport: Light, factor: int) -> RegroupedTransport:
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
    camera, projector = (
        _coarse_side(shape, int(factor))
        for shape in (transport.camera_shape, transport.projector_shape)
    )
    sizes = _sums(np.ones(transport.camera_shape, np.float32), int(factor)).reshape(-1)
    means = Side(
        camera.shape,
        lambda light: camera.spread(light / sizes),
        lambda light: camera.gather(light) / sizes,
    )
    return RegroupedTransport(transport, means, projector, f"coarser by {factor}")


def crop(whole: Light, camera: Any = None, projector: Any = None) -> RegroupedTransport:
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
    seen_side, seen_mask = _some_of(seen, prod(whole.camera_shape))
    lit_side, lit_mask = _some_of(lit, prod(whole.projector_shape))
    needed = whole.between_some(seen_mask, lit_mask)
    return RegroupedTransport(needed, seen_side, lit_side, f"{seen.shape} by {lit.shape} rays")


def square_means(images: Float, factor: int) -> Float:
    """Return the means of squares of images ``(..., H, W)``; the last ones may be smaller."""
    return _sums(images, factor) / _sums(np.ones(images.shape[-2:], np.float32), factor)


def _sums(images: Float, factor: int) -> Float:
    """Sum squares of images ``(..., H, W)``."""
    for axis in (-2, -1):
        images = np.add.reduceat(images, np.arange(0, images.shape[axis], factor), axis=axis)
    return images


def _coarse_side(fine: tuple[int, ...], factor: int) -> Side:
    """Return coarse rays that give each fine ray their value, and sum their fine ones."""
    height, width = fine[-2:]
    shape = (*fine[:-2], -(-height // factor), -(-width // factor))

    def spread(planar: Float) -> Float:
        images = planar.reshape(*planar.shape[:2], *shape)
        repeated = images.repeat(factor, axis=-2).repeat(factor, axis=-1)
        return np.ascontiguousarray(repeated[..., :height, :width]).reshape(*planar.shape[:2], -1)

    def gather(planar: Float) -> Float:
        images = planar.reshape(*planar.shape[:2], *fine)
        return _sums(images, factor).reshape(*planar.shape[:2], -1)

    return Side(shape, spread, gather)


def _some_of(rays: NDArray[np.int64], count: int) -> tuple[Side, NDArray[np.bool_]]:
    """Return some of so many rays, and their mask."""
    mask = np.zeros(count, bool)
    mask[rays] = True

    def spread(planar: Float) -> Float:
        light = np.zeros((*planar.shape[:2], count), np.float32)
        light[..., rays.reshape(-1)] = planar
        return light

    return Side(rays.shape, spread, lambda planar: planar[..., rays.reshape(-1)]), mask


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
