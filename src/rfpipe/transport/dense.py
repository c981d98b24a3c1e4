"""The whole transport matrix: what a brute-force scan measures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.transport.base import Float, LazyArrays, Transport
from rfpipe.transport.stored import Bundle
from rfpipe.units import NumberFormat


class DenseTransport(Transport):
    """Transport as one dense matrix a channel.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    arrays : mapping of str to ndarray
        ``matrix``, float32 ``(channels, camera rays, projector rays)``; may be read lazily.
    nbytes : int, optional
        Bytes on disk; by default the bytes of the matrix.
    """

    kind = "dense"

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
        self.channels = channels
        self._rows = level_rows
        self._arrays = arrays
        self._nbytes = nbytes

    @property
    def matrix(self) -> Float:
        """The matrices, float32 ``(channels, camera rays, projector rays)``."""
        return self._arrays["matrix"]

    @property
    def nbytes(self) -> int:
        """Bytes on disk if opened from a store, else of the matrix in memory."""
        return self.matrix.nbytes if self._nbytes is None else self._nbytes

    @property
    def level_rows(self) -> list[dict[str, Any]]:
        """Per level: patterns, nodes, empty, rank1, scalar, subdivided."""
        return self._rows

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        planes = [patterns[:, k] @ self.matrix[c].T for k, c in enumerate(channels)]
        return np.stack(planes, axis=1)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        planes = [images[:, k] @ self.matrix[c] for k, c in enumerate(channels)]
        return np.stack(planes, axis=1)

    def truncate(self, level: int) -> DenseTransport:
        """Return the transport itself: a scan has one level."""
        if level < 0:
            raise InputError(f"level {level} of a transport; levels count from 0")
        return self

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the arrays and attributes that a store keeps; a yardstick is never rounded."""
        attributes = {
            "kind": self.kind,
            "number_format": number_format,
            "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape),
            "channels": self.channels,
            "levels": self._rows,
        }
        return {"matrix": self.matrix}, attributes

    @classmethod
    def unpack(cls, bundle: Bundle, memory_budget: int) -> Self:  # noqa: ARG003
        """Build a transport from a store; the matrix is read when first used, and kept."""
        about = bundle.attributes
        return cls(
            tuple(about["camera_shape"]),
            tuple(about["projector_shape"]),
            about["channels"],
            about["levels"],
            LazyArrays(list(bundle.names), bundle.read),
            bundle.nbytes_stored,
        )
