"""Transport as one dense matrix per colour channel."""

from __future__ import annotations

from typing import Any

from rfpipe.array_types import Float
from rfpipe.transport.array_transport import ArrayTransport


class DenseTransport(ArrayTransport):
    """Transport as one dense matrix per channel, as a brute-force scan measures it.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `Transport`.
    content : mapping of str to ndarray
        ``matrix``, float32 ``(channels, camera rays, projector rays)``; may be read lazily.
    """

    kind = "dense"

    @property
    def matrix(self) -> Float:
        """The matrices, float32 ``(channels, camera rays, projector rays)``."""
        return self._content["matrix"]

    def _forward(self, light: Float, channel: int) -> Any:
        return light @ self.matrix[channel].T

    def _adjoint(self, light: Float, channel: int) -> Any:
        return light @ self.matrix[channel]
