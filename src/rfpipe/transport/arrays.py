"""What transports share that hold arrays of their own: how they are made, kept and opened."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, cached_property
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.store.arrays import ArrayBundle
from rfpipe.store.chunks import take_runs
from rfpipe.transport.base import Float, Transport
from rfpipe.units import NumberFormat

Arrays = Mapping[str, NDArray[Any]]

# Bits that are kept of single values, the leading one included.
_SIGNIFICANT = {"uint8": 12, "uint16": 16}
_FLOAT32_BITS = 24


class LevelSet(Protocol):
    """Arrays about the blocks of one level."""

    @property
    def level(self) -> int:
        """The level."""

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""

    def __len__(self) -> int: ...


Held = TypeVar("Held")
K = TypeVar("K")
S = TypeVar("S")
L = TypeVar("L", bound=LevelSet)


class HoldingTransport(Transport, Generic[Held]):
    """A transport that is made of what it holds, in memory or read when used.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    held
        What it is made of.
    nbytes : int, optional
        Bytes on disk; by default the bytes in memory.
    """

    shape_names: ClassVar[tuple[str, ...]] = ("camera_shape", "projector_shape")
    """By which stores name the ray domains that the constructor takes."""

    def __init__(
        self,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        channels: int,
        level_rows: list[dict[str, Any]],
        held: Held,
        nbytes: int | None = None,
    ) -> None:
        super().__init__(camera_shape, projector_shape, channels, level_rows, nbytes)
        self._held = held

    def _holding(self, level_rows: list[dict[str, Any]], held: Held) -> Self:
        """Return a transport between the same rays that is made of something else."""
        shapes: dict[str, Any] = {name: getattr(self, name) for name in self.shape_names}
        return type(self)(channels=self.channels, level_rows=level_rows, held=held, **shapes)

    @abstractmethod
    def _packed(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:
        """Return what is held as named arrays."""

    @classmethod
    @abstractmethod
    def _opened(cls, bundle: ArrayBundle, keep: bool) -> Held:
        """Return what a store keeps, to be read when used, and to be kept in memory or not."""

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the arrays and attributes that a store keeps."""
        return self._packed(number_format), {
            "kind": self.kind,
            "number_format": number_format,
            **{name: list(getattr(self, name)) for name in self.shape_names},
            "channels": self.channels,
            "levels": self.level_rows,
        }

    @classmethod
    def unpack(cls, bundle: ArrayBundle, memory_budget: int) -> Self:
        """Build a transport from a store; its arrays are read when first used."""
        about = bundle.attributes
        shapes: dict[str, Any] = {name: about[name] for name in cls.shape_names}
        return cls(
            channels=about["channels"],
            level_rows=about["levels"],
            held=cls._opened(bundle, bundle.nbytes <= memory_budget),
            nbytes=bundle.nbytes_stored,
            **shapes,
        )


class CoaxialTransport(HoldingTransport[Held]):
    """A symmetric transport over the ray domain, `shape`, that camera and projector share."""

    shape_names = ("shape",)

    def __init__(
        self,
        shape: tuple[int, ...],
        channels: int,
        level_rows: list[dict[str, Any]],
        held: Held,
        nbytes: int | None = None,
    ) -> None:
        super().__init__(shape, shape, channels, level_rows, held, nbytes)

    @property
    def shape(self) -> tuple[int, ...]:
        """The ray domain."""
        return self.camera_shape

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c = T c`` for planar images ``(P, K, N)``."""
        return self.forward(images, channels)


class ArrayTransport(HoldingTransport[Arrays]):
    """A transport made of a few named arrays, none of which is rounded in a store.

    They are read when first used, and kept.
    """

    def _bytes_in_memory(self) -> int:
        return sum(array.nbytes for array in self._held.values())

    def _packed(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:  # noqa: ARG002
        return dict(self._held)

    @classmethod
    def _opened(cls, bundle: ArrayBundle, keep: bool) -> Arrays:  # noqa: ARG003
        return LazyArrays(bundle.names, bundle.read, bundle.read_runs)


class LevelTransport(HoldingTransport[Sequence[L]]):
    """A transport made of sets of arrays, each about the blocks of one level.

    The sets stay in memory where all of them fit; else they are read each time. The acquisition's
    levels are those of the blocks, unless its rows say otherwise by a ``block_level``.
    """

    @cached_property
    def tree(self) -> BlockTree:
        """The block tree of the projector's rays."""
        return BlockTree(RayDomain(self.projector_shape))

    @property
    def last_level(self) -> int:
        """The last of `known_levels`: that of single rays."""
        return max(self._block_levels, default=self.finest)

    @property
    def known_levels(self) -> range:
        """All levels: what is found below a level adds up to what the level had measured."""
        return range(self.last_level + 1)

    @property
    def finest(self) -> int:
        """Level of the block tree that has single rays."""
        return self.tree.n_levels - 1

    @property
    def _block_levels(self) -> dict[int, int]:
        """Level of the blocks by that of the acquisition, where the two differ."""
        rows = self.level_rows
        return {row["level"]: row["block_level"] for row in rows if "block_level" in row}

    def truncate(self, level: int) -> Transport:
        """Return the transport as if the acquisition had stopped after `level` (Fig. 5.7)."""
        super().truncate(level)  # refuses a level that there isn't
        rows = [row for row in self.level_rows if row["level"] <= level]
        return self._truncated(self._block_levels.get(level, level), rows)

    @abstractmethod
    def _truncated(self, level: int, level_rows: list[dict[str, Any]]) -> Transport:
        """Return the transport at a level of the blocks, `level_rows` its table of levels."""

    def _bytes_in_memory(self) -> int:
        return sum(found.nbytes for found in self._held)


class LazyArrays(Mapping[str, NDArray[Any]]):
    """Named arrays that are read when first used; a plain mapping serves as well.

    Parameters
    ----------
    names : sequence of str
    read : callable
        Returns the array of a name.
    read_runs : callable, optional
        Returns runs of an array, see `runs_of`.
    """

    def __init__(
        self,
        names: Sequence[str],
        read: Callable[[str], NDArray[Any]],
        read_runs: Callable[[str, NDArray[np.int64]], NDArray[Any]] | None = None,
    ) -> None:
        self._names = tuple(names)
        self._read = cache(read)
        self.read_runs = read_runs

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(name)
        return self._read(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def runs_of(held: Arrays, name: str, runs: NDArray[np.int64]) -> NDArray[Any]:
    """Return runs ``(n, 2)`` of an array along its last axis, and read little else of it."""
    if isinstance(held, LazyArrays) and held.read_runs is not None:
        return held.read_runs(name, runs)
    return take_runs(held[name], runs)


class SetsOnDemand(Sequence[S], Generic[K, S]):
    """Sets that are made when used, and kept in memory or made anew each time.

    Parameters
    ----------
    keys : sequence
    make : callable
        Returns the set of a key.
    keep : bool
        Whether to keep in memory what was made, in `kept`.
    """

    def __init__(self, keys: Sequence[K], make: Callable[[K], S], *, keep: bool) -> None:
        self.keys, self.keep = keys, keep
        self._make = make
        self.kept: dict[int, S] = {}

    def __len__(self) -> int:
        return len(self.keys)

    @overload
    def __getitem__(self, index: int) -> S: ...

    @overload
    def __getitem__(self, index: slice) -> list[S]: ...

    def __getitem__(self, index: int | slice) -> S | list[S]:
        if isinstance(index, slice):
            return [self[n] for n in range(*index.indices(len(self)))]
        number = range(len(self))[index]
        if number in self.kept:
            return self.kept[number]
        found = self._make(self.keys[number])
        if self.keep:
            self.kept[number] = found
        return found


def by_prefix(bundle: ArrayBundle, parts: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the names of a store's arrays, by the set and by the part of it that they are.

    An array is named by its set, an underscore and its part.
    """
    found: dict[str, dict[str, str]] = {}
    for name in bundle.names:
        for part in parts:
            if name.endswith(f"_{part}"):
                found.setdefault(name.removesuffix(f"_{part}"), {})[part] = name
    return dict(sorted(found.items()))


def rounded(values: Float, number_format: NumberFormat) -> Float:
    """Round single values to 12 significant bits under "uint8", to 16 under "uint16".

    They span too many decades for a common scale. The trailing bits, all 0, take no room in a
    compressed store.
    """
    if number_format == "float32":
        return values
    dropped = _FLOAT32_BITS - _SIGNIFICANT[number_format]
    bits = np.ascontiguousarray(values).view(np.uint32)
    half = np.uint32(1 << (dropped - 1))
    mask = np.uint32(2**32 - (1 << dropped))
    found = ((bits + half) & mask).view(np.float32)
    result: Float = np.where(np.isfinite(values) & np.isfinite(found), found, values)
    return result
