"""Transport as a diagonal and a sum of products of images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.transport.base import Float, LazyArrays, Transport
from rfpipe.transport.stored import Bundle
from rfpipe.units import NumberFormat


class LowRankTransport(Transport):
    """Transport ``T = diag(d) + sum_r s_r u_r v_r^T`` a channel, the diagonal if there is one.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        The same where there is a diagonal, or no `right`.
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    arrays : mapping of str to ndarray
        ``left``, float32 ``(channels, rank, camera rays)``: the images u, radiance or unitless.
        ``strengths``, float32 ``(channels, rank)``: the factors s, of any sign.
        ``term_level``, int ``(rank,)``: the level of the acquisition from which on a term is
        there. ``right``, as ``left`` over projector rays: the images v; left out where T is
        symmetric, v = u. ``diagonal``, float32 ``(channels, rays)``: d, left out where there is
        none. They may be read lazily.
    nbytes : int, optional
        Bytes on disk; by default the bytes of the arrays.

    Raises
    ------
    InputError
        If a symmetric or diagonal part joins rays of different domains.
    """

    kind = "low_rank"

    def __init__(
        self,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        channels: int,
        level_rows: list[dict[str, Any]],
        arrays: Mapping[str, NDArray[Any]],
        nbytes: int | None = None,
    ) -> None:
        self.camera_shape = tuple(camera_shape)
        self.projector_shape = tuple(projector_shape)
        if self.camera_shape != self.projector_shape and (
            "right" not in arrays or "diagonal" in arrays
        ):
            raise InputError(
                f"a symmetric or diagonal part of a transport from {self.projector_shape} to "
                f"{self.camera_shape} rays; it needs one domain, or an array 'right' and no "
                "'diagonal'"
            )
        self.channels = channels
        self._rows = level_rows
        self._arrays = arrays
        self._nbytes = nbytes

    @property
    def rank(self) -> int:
        """Number of terms, the diagonal not counted."""
        return int(self._arrays["strengths"].shape[1])

    @property
    def nbytes(self) -> int:
        """Bytes on disk if opened from a store, else of the arrays in memory."""
        if self._nbytes is not None:
            return self._nbytes
        return sum(array.nbytes for array in self._arrays.values())

    @property
    def level_rows(self) -> list[dict[str, Any]]:
        """Per level: patterns, nodes, empty, rank1, scalar, subdivided."""
        return self._rows

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        return self._apply(patterns, channels, self._right, self._arrays["left"])

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        return self._apply(images, channels, self._arrays["left"], self._right)

    def truncate(self, level: int) -> LowRankTransport:
        """Return the transport with the terms only that were there after `level`.

        Their images are those of the whole acquisition, less noisy than they were then.
        """
        if level < 0:
            raise InputError(f"level {level} of a transport; levels count from 0")
        kept = self._arrays["term_level"] <= level
        arrays = dict(self._arrays)
        arrays |= {name: arrays[name][:, kept] for name in _BY_TERM if name in arrays}
        arrays["term_level"] = arrays["term_level"][kept]
        rows = [row for row in self._rows if row["level"] <= level]
        return type(self)(self.camera_shape, self.projector_shape, self.channels, rows, arrays)

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the arrays and attributes that a store keeps; terms cancel, so none is rounded."""
        attributes = {
            "kind": self.kind,
            "number_format": number_format,
            "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape),
            "channels": self.channels,
            "levels": self._rows,
        }
        return dict(self._arrays), attributes

    @classmethod
    def unpack(cls, bundle: Bundle, memory_budget: int) -> Self:  # noqa: ARG003
        """Build a transport from a store; its arrays are read when first used, and kept."""
        about = bundle.attributes
        return cls(
            tuple(about["camera_shape"]),
            tuple(about["projector_shape"]),
            about["channels"],
            about["levels"],
            LazyArrays(list(bundle.names), bundle.read),
            bundle.nbytes_stored,
        )

    @property
    def _right(self) -> Float:
        return self._arrays["right" if "right" in self._arrays else "left"]

    def _apply(self, given: Float, channels: Sequence[int], inner: Float, outer: Float) -> Float:
        """Weigh the images of `outer` by how much of those of `inner` is in what is given."""
        planes = []
        for k, c in enumerate(channels):
            # terms cancel over many rays: float64 until the sum is there
            shares = given[:, k].astype(np.float64) @ inner[c].T.astype(np.float64)
            plane = (shares * self._arrays["strengths"][c]) @ outer[c].astype(np.float64)
            if "diagonal" in self._arrays:
                plane += given[:, k] * self._arrays["diagonal"][c]
            planes.append(plane.astype(np.float32))
        return np.stack(planes, axis=1)


_BY_TERM = ("left", "right", "strengths")
