"""Transport as a diagonal and a sum of tensor products of two images."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.array_types import Float
from rfpipe.transport.array_transport import ArrayTransport

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class LowRankTransport(ArrayTransport):
    """Transport ``T = diag(d) + sum_r s_r u_r v_r^T`` per channel.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        Equal if there is a diagonal, or no ``right``.
    channels, level_rows, nbytes
        See `rfpipe.transport.base.Transport`.
    content : mapping of str to ndarray
        ``left``, float32 ``(channels, rank, camera rays)``: the images u, radiance or unitless.
        ``strengths``, float32 ``(channels, rank)``: the factors s, of any sign.
        ``right``, as ``left`` over projector rays: the images v; absent if T is symmetric, v = u.
        ``diagonal``, float32 ``(channels, rays)``: d; absent if it is 0. Arrays may be read lazily.
        They are stored without rounding, since terms cancel.
    """

    kind = "low_rank"

    @property
    def rank(self) -> int:
        """Number of terms besides the diagonal."""
        return int(self._content["strengths"].shape[1])

    def _forward(self, light: Float, channel: int) -> Any:
        return self._apply(light, channel, self._right, self._content["left"])

    def _adjoint(self, light: Float, channel: int) -> Any:
        return self._apply(light, channel, self._content["left"], self._right)

    def between(
        self, received: csr_array[np.float32], sent: csr_array[np.float32], channel: int
    ) -> Float:
        """Compute ``received^T T sent``, see `Transport.between`."""
        from scipy.sparse import diags_array

        # terms cancel: sums over many rays are in float64
        camera = received.T @ self._content["left"][channel].T.astype(np.float64)
        projector = sent.T @ self._right[channel].T.astype(np.float64)
        matrix = (camera * self._content["strengths"][channel]) @ projector.T
        if "diagonal" in self._content:
            matrix += (
                received.T @ diags_array(self._content["diagonal"][channel]) @ sent
            ).toarray()
        return np.asarray(matrix, np.float32)

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return each ray under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        image = np.zeros(patterns.shape[0])
        terms = (
            it[channel] for it in (self._content["left"], self._content["strengths"], self._right)
        )
        for u, s, v in zip(*terms, strict=True):
            image += u * (s * (patterns @ v.astype(np.float64)))
        if "diagonal" in self._content:
            image += self._content["diagonal"][channel] * patterns.diagonal()
        return image.astype(np.float32)

    @property
    def _right(self) -> Float:
        return self._content["right" if "right" in self._content else "left"]

    def _apply(self, light: Float, channel: int, inner: Float, outer: Float) -> Any:
        """Return ``(d + sum_r s_r outer_r inner_r^T) light``."""
        if not self.rank and "diagonal" in self._content:
            return light * self._content["diagonal"][channel]
        # terms cancel: sums over many rays are in float64
        shares = light.astype(np.float64) @ inner[channel].T.astype(np.float64)
        plane = (shares * self._content["strengths"][channel]) @ outer[channel].astype(np.float64)
        if "diagonal" in self._content:
            plane += light * self._content["diagonal"][channel]
        return plane
