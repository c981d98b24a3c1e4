"""Transport by smooth functions of many scales: near-range and far-range indirect light."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.transport.arrays import Arrays, ArrayTransport, CoaxialTransport
from rfpipe.transport.base import Float
from rfpipe.transport.multiscale.basis import Functions, MultiscaleBasis

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Columns of light that are taken through the pairs at once: they should stay in the cache.
_COLUMNS = 64


class MultiscaleTransport(CoaxialTransport[Arrays], ArrayTransport):
    """Symmetric transport ``T = F B S B^T F`` a channel, smooth up to the image F on both sides.

    Parameters
    ----------
    shape, channels, level_rows, nbytes
        See `rfpipe.transport.arrays.CoaxialTransport`.
    held : mapping of str to ndarray
        ``factor``, float32 (channels, N): F, radiance of the floodlit image. ``functions``, int32
        (n, 4): those of B, see `MultiscaleBasis`. ``cores``, float32 (channels, pairs): S, one
        value a pair of functions, in inverse radiance. ``pairs``, int32 (2, pairs): which
        functions; left out where they are all pairs of the basis. May be read lazily. Cores
        cancel, so that no store rounds them.
    """

    kind = "multiscale"

    @cached_property
    def basis(self) -> MultiscaleBasis:
        """The functions."""
        return MultiscaleBasis(self.camera_shape, self._held["functions"])

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        images = np.empty(patterns.shape, np.float32)
        for k, c in enumerate(channels):
            cores, factor = self._held["cores"][c], self._held["factor"][c]
            images[:, k] = bounced(self.basis, self._pairs, cores, factor, patterns[:, k])
        return images

    def between(
        self, received: csr_array[np.float32], sent: csr_array[np.float32], channel: int
    ) -> Float:
        """Return the light between few patterns, see `Transport.between`."""
        from scipy.sparse import diags_array

        from rfpipe.transport.pair_kernels import couple

        # no image is made: functions are many fewer than rays
        scaled = self.basis.sums @ diags_array(self._held["factor"][channel])
        light, back = (scaled @ sent).tocsc(), (received.T @ scaled.T).tocsr()
        found = np.empty((received.shape[1], sent.shape[1]), np.float32)
        for first in range(0, sent.shape[1], _COLUMNS):
            columns = slice(first, first + _COLUMNS)
            some = np.ascontiguousarray(light[:, columns].toarray())
            arriving = np.zeros_like(some)
            couple(*self._pairs, self._held["cores"][channel], some, arriving)
            found[:, columns] = back @ arriving
        return found

    @property
    def _pairs(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        if "pairs" in self._held:
            first, second = self._held["pairs"]
            return first, second
        return self.basis.pairs


def bounced(
    basis: MultiscaleBasis,
    pairs: tuple[Functions, Functions],
    cores: Float,
    factor: Float,
    patterns: NDArray[Any],
) -> Float:
    """Return ``F B S B^T F p`` of one channel for patterns (P, N), float32 (P, N).

    Parameters
    ----------
    basis : MultiscaleBasis
    pairs : tuple of two ndarrays of int32, shape (pairs,)
        The functions that the cores are about.
    cores : ndarray of float32, shape (pairs,)
    factor : ndarray of float32, shape (N,)
        F.
    patterns : ndarray of float32 or bool, shape (P, N)
    """
    from rfpipe.transport.pair_kernels import couple

    light = np.ascontiguousarray(basis.sums @ (patterns * factor).T)
    received = np.zeros_like(light)
    couple(*pairs, cores, light, received)
    images: Float = (basis.weights @ received).T * factor
    return images
