"""Transport by smooth functions of many scales: near-range and far-range indirect light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.transport.base import Float, LazyArrays, Transport
from rfpipe.transport.multiscale.basis import Functions, MultiscaleBasis
from rfpipe.transport.stored import Bundle
from rfpipe.units import NumberFormat


class MultiscaleTransport(Transport):
    """Symmetric transport ``T = F B S B^T F`` a channel, smooth up to the image F on both sides.

    Parameters
    ----------
    shape : tuple of int
        The ray domain that camera and projector share.
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    arrays : mapping of str to ndarray
        ``factor``, float32 (channels, N): F, radiance of the floodlit image. ``functions``, int32
        (n, 4): those of B, see `MultiscaleBasis`. ``cores``, float32 (channels, pairs): S, one
        value a pair of functions, in inverse radiance. ``pairs``, int32 (2, pairs): which
        functions; left out where they are all pairs of the basis. May be read lazily.
    nbytes : int, optional
        Bytes on disk; by default the bytes of the arrays.
    """

    kind = "multiscale"

    def __init__(
        self,
        shape: tuple[int, ...],
        channels: int,
        level_rows: list[dict[str, Any]],
        arrays: Mapping[str, NDArray[Any]],
        nbytes: int | None = None,
    ) -> None:
        self.camera_shape = self.projector_shape = tuple(shape)
        self.channels = channels
        self._rows = level_rows
        self._arrays = arrays
        self._nbytes = nbytes

    @cached_property
    def basis(self) -> MultiscaleBasis:
        """The functions."""
        return MultiscaleBasis(self.camera_shape, self._arrays["functions"])

    @property
    def nbytes(self) -> int:
        """Bytes on disk if opened from a store, else of the arrays in memory."""
        if self._nbytes is not None:
            return self._nbytes
        return sum(array.nbytes for array in self._arrays.values())

    @property
    def level_rows(self) -> list[dict[str, Any]]:
        """The rows of `levels` as plain data."""
        return self._rows

    @property
    def last_level(self) -> int:
        """0: it is measured as a whole."""
        return 0

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        images = np.empty(patterns.shape, np.float32)
        for k, c in enumerate(channels):
            cores, factor = self._arrays["cores"][c], self._arrays["factor"][c]
            images[:, k] = bounced(self.basis, self._pairs, cores, factor, patterns[:, k])
        return images

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c``; the transport is symmetric."""
        return self.forward(images, channels)

    def truncate(self, level: int) -> MultiscaleTransport:
        """Return the transport itself: it has no levels of its own."""
        if level < 0:
            raise InputError(f"level {level} of a transport; levels count from 0")
        return self

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the arrays and attributes that a store keeps; cores cancel, so none is rounded."""
        attributes = {
            "kind": self.kind,
            "number_format": number_format,
            "shape": list(self.camera_shape),
            "channels": self.channels,
            "levels": self._rows,
        }
        return dict(self._arrays), attributes

    @classmethod
    def unpack(cls, bundle: Bundle, memory_budget: int) -> Self:  # noqa: ARG003
        """Build a transport from a store; its arrays are read when first used, and kept."""
        about = bundle.attributes
        arrays = LazyArrays(list(bundle.names), bundle.read)
        return cls(
            tuple(about["shape"]), about["channels"], about["levels"], arrays, bundle.nbytes_stored
        )

    @property
    def _pairs(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        if "pairs" in self._arrays:
            first, second = self._arrays["pairs"]
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
    from rfpipe.transport.multiscale.kernels import couple

    light = np.ascontiguousarray(basis.sums @ (patterns * factor).T)
    received = np.zeros_like(light)
    couple(*pairs, cores, light, received)
    images: Float = (basis.weights @ received).T * factor
    return images
