"""Transport as a diagonal and a sum of products of images."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.transport.array_transport import ArrayTransport
from rfpipe.transport.base import Float

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class LowRankTransport(ArrayTransport):
    """Transport ``T = diag(d) + sum_r s_r u_r v_r^T`` a channel, the diagonal if there is one.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        The same where there is a diagonal, or no `right`.
    channels, level_rows, nbytes
        See `rfpipe.transport.base.Transport`.
    content : mapping of str to ndarray
        ``left``, float32 ``(channels, rank, camera rays)``: the images u, radiance or unitless.
        ``strengths``, float32 ``(channels, rank)``: the factors s, of any sign.
        ``right``, as ``left`` over projector rays: the images v; left out where T is symmetric,
        v = u. ``diagonal``, float32 ``(channels, rays)``: d, left out where there is none. They
        may be read lazily. Terms cancel, so that no store rounds them.
    """

    kind = "low_rank"

    @property
    def rank(self) -> int:
        """Number of terms, the diagonal not counted."""
        return int(self._content["strengths"].shape[1])

    def _forward(self, light: Float, channel: int) -> Any:
        return self._apply(light, channel, self._right, self._content["left"])

    def _adjoint(self, light: Float, channel: int) -> Any:
        return self._apply(light, channel, self._content["left"], self._right)

    def between(
        self, received: csr_array[np.float32], sent: csr_array[np.float32], channel: int
    ) -> Float:
        """Return the light between few patterns, see `Transport.between`."""
        from scipy.sparse import diags_array

        # terms cancel over many rays: float64 until the sum is there
        arriving = received.T @ self._content["left"][channel].T.astype(np.float64)
        shares = sent.T @ self._right[channel].T.astype(np.float64)
        matrix = (arriving * self._content["strengths"][channel]) @ shares.T
        if "diagonal" in self._content:
            matrix += (
                received.T @ diags_array(self._content["diagonal"][channel]) @ sent
            ).toarray()
        return np.asarray(matrix, np.float32)

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return what each ray sees under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        seen = np.zeros(patterns.shape[0])
        terms = (
            it[channel] for it in (self._content["left"], self._content["strengths"], self._right)
        )
        for left, strength, right in zip(*terms, strict=True):
            seen += left * (strength * (patterns @ right.astype(np.float64)))
        if "diagonal" in self._content:
            seen += self._content["diagonal"][channel] * patterns.diagonal()
        return seen.astype(np.float32)

    @property
    def _right(self) -> Float:
        return self._content["right" if "right" in self._content else "left"]

    def _apply(self, light: Float, channel: int, inner: Float, outer: Float) -> Any:
        """Weigh the images of `outer` by how much of those of `inner` is in the light."""
        # terms cancel over many rays: float64 until the sum is there
        shares = light.astype(np.float64) @ inner[channel].T.astype(np.float64)
        plane = (shares * self._content["strengths"][channel]) @ outer[channel].astype(np.float64)
        if "diagonal" in self._content:
            plane += light * self._content["diagonal"][channel]
        return plane
