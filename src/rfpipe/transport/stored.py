"""Sets of arrays, read from a store when they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.places import Place

K = TypeVar("K")
S = TypeVar("S")


class Bundle(Protocol):
    """Named arrays and attributes of a store: an `rfpipe.store.ArrayBundle`, or a part of one."""

    path: Path | Place
    attributes: dict[str, Any]
    names: tuple[str, ...]

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array, without reading it."""

    def nbytes(self, name: str) -> int:
        """Bytes of an array in memory, without reading it."""

    def read(self, name: str) -> NDArray[Any]:
        """Read a whole array and check it against its digest."""

    def read_runs(self, name: str, runs: NDArray[np.int64]) -> NDArray[Any]:
        """Read runs ``(n, 2)`` of an array along its last axis, one after the other."""

    @property
    def nbytes_stored(self) -> int:
        """Bytes on disk."""

    def nbytes_stored_of(self, prefix: str) -> int:
        """Bytes on disk of the arrays whose names begin with `prefix`."""


class PartOfBundle:
    """The arrays of a bundle whose names begin alike, by the rest of their names.

    Parameters
    ----------
    whole : Bundle
    prefix : str
    attributes : dict
        Of the part.
    """

    def __init__(self, whole: Bundle, prefix: str, attributes: dict[str, Any]) -> None:
        self.path = whole.path
        self.attributes = attributes
        self.names = tuple(
            name.removeprefix(prefix) for name in whole.names if name.startswith(prefix)
        )
        self._whole: Bundle = whole
        self._prefix: str = prefix
        if isinstance(whole, PartOfBundle):
            self._whole, self._prefix = whole._whole, whole._prefix + prefix

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array, without reading it."""
        return self._whole.shape(self._prefix + name)

    def nbytes(self, name: str) -> int:
        """Bytes of an array in memory, without reading it."""
        return self._whole.nbytes(self._prefix + name)

    def read(self, name: str) -> NDArray[Any]:
        """Read a whole array and check it against its digest."""
        return self._whole.read(self._prefix + name)

    def read_runs(self, name: str, runs: NDArray[np.int64]) -> NDArray[Any]:
        """Read runs ``(n, 2)`` of an array along its last axis, one after the other."""
        return self._whole.read_runs(self._prefix + name, runs)

    @property
    def nbytes_stored(self) -> int:
        """Bytes on disk of its arrays."""
        return self.nbytes_stored_of("")

    def nbytes_stored_of(self, prefix: str) -> int:
        """Bytes on disk of its arrays whose names begin with `prefix`."""
        return self._whole.nbytes_stored_of(self._prefix + prefix)


def by_prefix(bundle: Bundle, parts: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the names of a store's arrays, by the set and by the part of it that they are.

    An array is named by its set, an underscore and its part.
    """
    found: dict[str, dict[str, str]] = {}
    for name in bundle.names:
        for part in parts:
            if name.endswith(f"_{part}"):
                found.setdefault(name.removesuffix(f"_{part}"), {})[part] = name
    return dict(sorted(found.items()))


def bytes_in_memory(bundle: Bundle) -> int:
    """Bytes of all arrays of a store, once read."""
    return sum(bundle.nbytes(name) for name in bundle.names)


def fits(bundle: Bundle, memory_budget: int) -> bool:
    """Tell whether all arrays of a store fit into memory."""
    return bytes_in_memory(bundle) <= memory_budget


class SetsOnDemand(Sequence[S], Generic[K, S]):
    """Sets that are made when used, and kept in memory or made anew each time.

    Parameters
    ----------
    keys : sequence
    make : callable
        Returns the set of a key.
    keep : bool
        Whether to keep in memory what was made.
    """

    def __init__(self, keys: Sequence[K], make: Callable[[K], S], *, keep: bool) -> None:
        self.keys, self.keep = keys, keep
        self._make = make
        self._kept: dict[int, S] = {}

    def __len__(self) -> int:
        return len(self.keys)

    def kept(self, index: int) -> S | None:
        """Return a set that is in memory, None for one that isn't."""
        return self._kept.get(index)

    @overload
    def __getitem__(self, index: int) -> S: ...

    @overload
    def __getitem__(self, index: slice) -> list[S]: ...

    def __getitem__(self, index: int | slice) -> S | list[S]:
        if isinstance(index, slice):
            return [self[n] for n in range(*index.indices(len(self)))]
        number = range(len(self))[index]
        found = self._kept.get(number)
        if found is None:
            found = self._make(self.keys[number])
            if self.keep:
                self._kept[number] = found
        return found
