"""What transports of arrays share: how they are held, stored, opened and rounded."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, cached_property
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.store.arrays import ArrayBundle
from rfpipe.transport.base import Float, Transport
from rfpipe.units import NumberFormat

Arrays = Mapping[str, NDArray[Any]]
K = TypeVar("K")
S = TypeVar("S")

# Bits that are kept of single values, the leading one included.
_SIGNIFICANT = {"uint8": 12, "uint16": 16}
_FLOAT32_BITS = 24
_RAYS = 64  # of which `each_bounced` takes the functions together


class CoaxialTransport(Transport):
    """A symmetric transport over the ray domain that camera and projector share."""

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c = T c`` for planar images ``(P, K, N)``."""
        return self.forward(images, channels)


class ArrayTransport(Transport):
    """A transport made of a few named arrays, read when first used, none of them rounded."""

    _held: Arrays

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        return _by_channel(self._lit, patterns, channels)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        return _by_channel(self._lit_back, images, channels)

    @abstractmethod
    def _lit(self, light: Float, channel: int) -> Any:
        """Return ``T p`` of one channel for patterns (P, N), (P, M)."""

    def _lit_back(self, light: Float, channel: int) -> Any:
        """Return ``T^T c`` of one channel for images (P, M), (P, N)."""
        raise NotImplementedError

    def _bytes_in_memory(self) -> int:
        return sum(array.nbytes for array in self._held.values())

    def _packed(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:  # noqa: ARG002
        return dict(self._held)

    @classmethod
    def _opened(cls, bundle: ArrayBundle, keep: bool) -> Arrays:  # noqa: ARG003
        return LazyArrays(bundle.names, cache(bundle.read))


class DenseTransport(ArrayTransport):
    """Transport as one dense matrix a channel, what a brute-force scan measures.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `Transport`.
    held : mapping of str to ndarray
        ``matrix``, float32 ``(channels, camera rays, projector rays)``; may be read lazily.
    """

    kind = "dense"

    @property
    def matrix(self) -> Float:
        """The matrices, float32 ``(channels, camera rays, projector rays)``."""
        return self._held["matrix"]

    def _lit(self, light: Float, channel: int) -> Any:
        return light @ self.matrix[channel].T

    def _lit_back(self, light: Float, channel: int) -> Any:
        return light @ self.matrix[channel]


def _by_channel(
    apply: Callable[[Float, int], NDArray[Any]], planar: Float, channels: Sequence[int]
) -> Float:
    planes = [apply(planar[:, k], channel) for k, channel in enumerate(channels)]
    return np.ascontiguousarray(np.stack(planes, axis=1), np.float32)


def each_bounced(taken: Any, cores: Any, given: Any) -> Float:
    """Return the diagonal of ``taken cores given^T`` of scipy's sparse, float32 (rays,)."""
    seen = np.empty(taken.shape[0], np.float32)
    # rays beside each other have few functions between them
    for first in range(0, len(seen), _RAYS):
        some = slice(first, first + _RAYS)
        left, right = (np.unique(it[some].indices) for it in (taken, given))
        between = cores[left][:, right].toarray()
        parts = taken[some][:, left] @ between, given[some][:, right].toarray()
        seen[some] = (parts[0] * parts[1]).sum(axis=1)
    return seen


class PairTransport(CoaxialTransport, ArrayTransport):
    """Symmetric transport ``T = F B S B^T F`` a channel: functions, and what pairs exchange.

    It holds F, ``factor``, the non-zero places of S, ``pairs``, and their values, ``cores``.
    """

    @abstractmethod
    def functions(self) -> Any:
        """Return B, scipy's sparse (N, functions)."""

    def relight_each(self, patterns: Any, channel: int) -> Float:
        """Return what each ray sees under its own pattern, see `MatrixAlgebra.relight_each`."""
        from scipy.sparse import csr_array

        factor, cores = (self._held[name][channel] for name in ("factor", "cores"))
        functions, (first, second) = self.functions(), self._held["pairs"]
        half = csr_array((cores / (1 + (first == second)), (first, second)),
                         shape=2 * functions.shape[1:])  # fmt: skip
        light = patterns.multiply(factor) @ functions
        seen: Float = factor * each_bounced(functions, half + half.T, light)
        return seen


class LevelTransport(Transport):
    """A transport made of sets of arrays, each about the blocks of one level.

    The sets stay in memory where all of them fit; else they are read each time. The acquisition's
    levels are those of the blocks.
    """

    _held: Sequence[Any]

    @cached_property
    def tree(self) -> BlockTree:
        """The block tree of the projector's rays."""
        return BlockTree(RayDomain(self.projector_shape))

    @property
    def last_level(self) -> int:
        """The last of `known_levels`: that of single rays."""
        return self.tree.n_levels - 1

    @property
    def known_levels(self) -> range:
        """All levels: what is found below a level adds up to what the level had measured."""
        return range(self.last_level + 1)

    def truncate(self, level: int) -> Transport:
        """Return the transport as if the acquisition had stopped after `level` (Fig. 5.7)."""
        super().truncate(level)  # refuses a level that there isn't
        if level == self.last_level:
            return self
        content = self._truncated(level)
        return self.holding([row for row in self.level_rows if row["level"] <= level], content)

    @abstractmethod
    def _truncated(self, level: int) -> Sequence[Any]:
        """Return the sets of the transport as known at a level of the blocks."""

    def _bytes_in_memory(self) -> int:
        return sum(arrays.nbytes for arrays in self._held)


class LazyArrays(Mapping[str, NDArray[Any]]):
    """Named arrays that are read when used."""

    def __init__(self, names: Sequence[str], read: Callable[[str], NDArray[Any]]) -> None:
        self._names, self._read = names, read

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(name)
        return self._read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._names  # known without reading the array

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class SetsOnDemand(Sequence[S], Generic[K, S]):
    """Sets that are made of their keys when used, and kept in memory, in `kept`, if `keep`."""

    def __init__(self, keys: Sequence[K], make: Callable[[K], S], *, keep: bool) -> None:
        self.keys, self.keep = keys, keep
        self._make = make
        self.kept: dict[int, S] = {}

    def __len__(self) -> int:
        return len(self.keys)

    def __getitem__(self, index: Any) -> Any:
        numbers = range(len(self))[index]
        if isinstance(numbers, range):
            return [self[number] for number in numbers]
        if numbers in self.kept:
            return self.kept[numbers]
        made = self._make(self.keys[numbers])
        if self.keep:
            self.kept[numbers] = made
        return made


def by_prefix(bundle: ArrayBundle, parts: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the names of a store's arrays ``{set}_{part}``, by set and by part."""
    names: dict[str, dict[str, str]] = {}
    for name in bundle.names:
        for part in parts:
            if name.endswith(f"_{part}"):
                names.setdefault(name.removesuffix(f"_{part}"), {})[part] = name
    return dict(sorted(names.items()))


def rounded(values: Float, number_format: NumberFormat) -> Float:
    """Round single values to 12 significant bits under "uint8", to 16 under "uint16".

    They span too many decades for a common scale. The trailing bits, all 0, take no room in a
    compressed store.
    """
    if number_format == "float32":
        return values
    dropped = _FLOAT32_BITS - _SIGNIFICANT[number_format]
    bits = np.ascontiguousarray(values).view(np.uint32)
    half, mask = np.uint32(1 << (dropped - 1)), np.uint32(2**32 - (1 << dropped))
    nearest = ((bits + half) & mask).view(np.float32)
    result: Float = np.where(np.isfinite(values) & np.isfinite(nearest), nearest, values)
    return result
