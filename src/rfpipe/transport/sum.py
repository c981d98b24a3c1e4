"""Sum of transports of different forms."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float
from rfpipe.store.arrays import ArrayBundle
from rfpipe.transport.base import Transport
from rfpipe.transport.storage import unpack_transport
from rfpipe.units import NumberFormat

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class SumTransport(Transport):
    """Transport as the sum of parts over the same rays, ``T = sum_i T_i``.

    There is at least one part, of any kind, sums included.
    """

    kind = "sum"
    _content: tuple[Transport, ...]

    def __init__(
        self,
        parts: Sequence[Transport],
        level_rows: list[dict[str, Any]],
        nbytes: int | None = None,
    ) -> None:
        part = parts[0]
        shapes = part.camera_shape, part.projector_shape
        super().__init__(*shapes, part.channels, level_rows, tuple(parts), nbytes)

    @property
    def parts(self) -> tuple[Transport, ...]:
        """The terms T_i."""
        return self._content

    def _bytes_in_memory(self) -> int:
        return sum(part.nbytes for part in self.parts)

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        return reduce(np.add, (part.forward(patterns, channels) for part in self.parts))

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        return reduce(np.add, (part.adjoint(images, channels) for part in self.parts))

    def between(
        self, received: csr_array[np.float32], sent: csr_array[np.float32], channel: int
    ) -> Float:
        """Return ``R^T T S``, see `Transport.between`."""
        return reduce(np.add, (part.between(received, sent, channel) for part in self.parts))

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return each ray under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        return reduce(np.add, (part.relight_per_ray(patterns, channel) for part in self.parts))

    def restricted(self, camera_rays: Bools, projector_rays: Bools) -> Transport:
        """Return a sum that is equal between some rays, see `Relightable.restricted`."""
        parts: Any = [part.restricted(camera_rays, projector_rays) for part in self.parts]
        return SumTransport(parts, self.level_rows)

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the arrays and attributes of a store, by the number of the part."""
        arrays: dict[str, NDArray[Any]] = {}
        part_attributes = []
        for index, part in enumerate(self.parts):
            packed, packed_attributes = part.pack(number_format)
            arrays |= {f"{_prefix(index)}{name}": array for name, array in packed.items()}
            part_attributes.append(packed_attributes)
        attributes = {"kind": self.kind, "number_format": number_format, "levels": self.level_rows}
        return arrays, {**attributes, "parts": part_attributes}

    @classmethod
    def unpack(cls, bundle: ArrayBundle, memory_budget: int) -> SumTransport:
        """Build a transport from a store; parts stay in memory, the first first, while they fit."""
        attributes = bundle.attributes
        parts = []
        for index, part_attributes in enumerate(attributes["parts"]):
            part = bundle.part(_prefix(index), part_attributes)
            parts.append(unpack_transport(part, memory_budget))
            if part.nbytes <= memory_budget:
                memory_budget -= part.nbytes
        return cls(parts, attributes["levels"], bundle.nbytes_stored)


def _prefix(index: int) -> str:
    """Prefix of the names of a part's arrays."""
    return f"part_{index:02d}_"


def terms_of(transport: Transport) -> tuple[Transport, ...]:
    """Return the terms of a sum; any other transport is its own single term."""
    return transport.parts if isinstance(transport, SumTransport) else (transport,)
