"""Transport between Haar wavelets: light of any shape, dim enough to be told from few pictures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from rfpipe.transport.arrays import Arrays, ArrayTransport, CoaxialTransport
from rfpipe.transport.base import Float
from rfpipe.transport.wavelet.cells import Cells


class WaveletTransport(CoaxialTransport[Arrays], ArrayTransport):
    """Symmetric transport ``T = F W^T C W F`` a channel, between wavelets of two images.

    Parameters
    ----------
    shape, channels, level_rows, nbytes
        See `rfpipe.transport.arrays.CoaxialTransport`.
    held : mapping of str to ndarray
        ``side``, int32 (1,): pixels along the side of a cell. ``factor``, float32 (channels, N): F.
        ``pairs``, int32 (2, pairs): which wavelets exchange light, of those of the cells' `Haar`,
        the first one's number at most the second's. ``cores``, float32 (channels, pairs): C, of
        any sign. They cancel, so that no store rounds them. May be read lazily.
    """

    kind = "wavelet"

    @cached_property
    def cells(self) -> Cells:
        """The grid of the wavelets."""
        return Cells(self.shape, int(self._held["side"][0]))

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        from rfpipe.transport.pair_kernels import couple

        images = np.empty(patterns.shape, np.float32)
        cells, (first, second) = self.cells, self._held["pairs"]
        for k, c in enumerate(channels):
            factor = self._held["factor"][c]
            light = cells.haar.forward(cells.total(patterns[:, k] * factor))
            received = np.zeros_like(light)
            couple(first, second, self._held["cores"][c], light, received)
            images[:, k] = cells.spread(cells.haar.inverse(received)) * factor
        return images
