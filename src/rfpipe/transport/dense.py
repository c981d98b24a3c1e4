"""The whole transport matrix: what a brute-force scan measures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rfpipe.transport.arrays import ArrayTransport
from rfpipe.transport.base import Float


class DenseTransport(ArrayTransport):
    """Transport as one dense matrix a channel.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.arrays.HoldingTransport`.
    held : mapping of str to ndarray
        ``matrix``, float32 ``(channels, camera rays, projector rays)``; may be read lazily.
    """

    kind = "dense"

    @property
    def matrix(self) -> Float:
        """The matrices, float32 ``(channels, camera rays, projector rays)``."""
        return self._held["matrix"]

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        planes = [patterns[:, k] @ self.matrix[c].T for k, c in enumerate(channels)]
        return np.stack(planes, axis=1)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        planes = [images[:, k] @ self.matrix[c] for k, c in enumerate(channels)]
        return np.stack(planes, axis=1)
