"""Base classes of transports that are made of a few named arrays, and of coaxial rigs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.store.arrays import ArrayBundle
from rfpipe.transport.base import Transport
from rfpipe.transport.lazy import LazyArrays
from rfpipe.units import NumberFormat

Arrays = Mapping[str, NDArray[Any]]


class CoaxialTransport(Transport):
    """Symmetric transport over the ray domain that camera and projector share."""

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c = T c`` for planar images ``(P, K, N)``."""
        return self.forward(images, channels)


class ArrayTransport(Transport):
    """Transport made of a few named arrays, which are read when first used and never rounded."""

    _content: Arrays

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        return _by_channel(self._forward, patterns, channels)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        return _by_channel(self._adjoint, images, channels)

    @abstractmethod
    def _forward(self, light: Float, channel: int) -> Any:
        """Return ``T p`` of one channel, (P, M), for patterns (P, N)."""

    def _adjoint(self, light: Float, channel: int) -> Any:
        """Return ``T^T c`` of one channel, (P, N), for images (P, M)."""
        raise NotImplementedError

    def _bytes_in_memory(self) -> int:
        return sum(array.nbytes for array in self._content.values())

    def _to_arrays(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:  # noqa: ARG002
        return dict(self._content)

    @classmethod
    def _open(cls, bundle: ArrayBundle, keep: bool) -> Arrays:  # noqa: ARG003
        return LazyArrays(bundle.names, cache(bundle.read))


def _by_channel(
    apply: Callable[[Float, int], NDArray[Any]], planar: Float, channels: Sequence[int]
) -> Float:
    planes = [apply(planar[:, k], channel) for k, channel in enumerate(channels)]
    return np.ascontiguousarray(np.stack(planes, axis=1), np.float32)
