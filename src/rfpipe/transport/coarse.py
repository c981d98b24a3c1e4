"""A transport between coarser rays than those of its acquisition."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from rfpipe.errors import InputError
from rfpipe.transport.base import Float, Light

__all__ = ["CoarserTransport", "coarser", "square_means"]


_FINE_BYTES = 64 * 2**20


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
        At least 1.

    Raises
    ------
    InputError
        If the factor is no whole number of at least 1.
    """
    if factor != int(factor) or factor < 1:
        raise InputError(f"factor is {factor}; expected a whole number of at least 1")
    return CoarserTransport(transport, int(factor))


class CoarserTransport(Light):
    """What `coarser` returns: computed from the fine transport at each use."""

    def __init__(self, fine: Light, factor: int) -> None:
        self.fine = fine
        self.factor = factor
        self.camera_shape = _coarse(fine.camera_shape, self.factor)
        self.projector_shape = _coarse(fine.projector_shape, self.factor)
        self.channels = fine.channels

    def __repr__(self) -> str:
        return f"coarser({self.fine!r}, {self.factor})"

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""

        def few(patterns: Float) -> Float:
            light = self._spread(patterns, self.projector_shape, self.fine.projector_shape)
            sums = self._gathered(self.fine.forward(light, channels), self.fine.camera_shape)
            return sums / self._sizes

        return self._a_few_at_a_time(few, patterns)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""

        def few(images: Float) -> Float:
            light = self._spread(images / self._sizes, self.camera_shape, self.fine.camera_shape)
            return self._gathered(self.fine.adjoint(light, channels), self.fine.projector_shape)

        return self._a_few_at_a_time(few, images)

    def _a_few_at_a_time(self, apply: Callable[[Float], Float], planar: Float) -> Float:
        """Apply to parts of what is given, which are `factor` squared times larger when spread."""
        fine = self.fine.matrix_shape
        at_a_time = max(1, _FINE_BYTES // (4 * planar.shape[1] * (fine[1] + fine[2])))
        parts = range(0, max(len(planar), 1), at_a_time)
        return np.concatenate([apply(planar[first : first + at_a_time]) for first in parts])

    def _spread(self, planar: Float, coarse: tuple[int, ...], fine: tuple[int, ...]) -> Float:
        """Give each fine ray the value of its coarse one; white light stays one plane's memory."""
        count, channels, _ = planar.shape
        if planar.strides[1] == 0:
            planar = planar[:, :1]
        images = planar.reshape(*planar.shape[:2], *coarse)
        spread = images.repeat(self.factor, axis=-2).repeat(self.factor, axis=-1)
        within = np.ascontiguousarray(spread[..., : fine[-2], : fine[-1]])
        rays = within.reshape(*planar.shape[:2], -1)
        return np.broadcast_to(rays, (count, channels, rays.shape[-1]))

    def _gathered(self, planar: Float, fine: tuple[int, ...]) -> Float:
        """Sum each coarse ray's fine ones."""
        images = planar.reshape(*planar.shape[:2], *fine)
        return _sums(images, self.factor).reshape(*planar.shape[:2], -1)

    @cached_property
    def _sizes(self) -> Float:
        """Number of camera rays of each coarse one."""
        return _sums(np.ones(self.fine.camera_shape, np.float32), self.factor).reshape(-1)


def square_means(images: Float, factor: int) -> Float:
    """Return the means of squares of images ``(..., H, W)``; the last ones may be smaller."""
    sizes = _sums(np.ones(images.shape[-2:], np.float32), factor)
    return _sums(images, factor) / sizes


def _sums(images: Float, factor: int) -> Float:
    """Sum squares of images ``(..., H, W)``."""
    for axis in (-2, -1):
        images = np.add.reduceat(images, np.arange(0, images.shape[axis], factor), axis=axis)
    return images


def _coarse(shape: tuple[int, ...], factor: int) -> tuple[int, ...]:
    height, width = shape[-2:]
    return *shape[:-2], -(-height // factor), -(-width // factor)
