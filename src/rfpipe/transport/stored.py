"""Sets of arrays, read from a store when they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar, overload

from rfpipe.store import ArrayBundle

K = TypeVar("K")
S = TypeVar("S")


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


def fits(bundle: ArrayBundle, memory_budget: int) -> bool:
    """Tell whether all arrays of a store fit into memory."""
    return sum(bundle.nbytes(name) for name in bundle.names) <= memory_budget


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
        self._keys = keys
        self._make = make
        self._keep = keep
        self._held: dict[int, S] = {}

    def __len__(self) -> int:
        return len(self._keys)

    @overload
    def __getitem__(self, index: int) -> S: ...

    @overload
    def __getitem__(self, index: slice) -> list[S]: ...

    def __getitem__(self, index: int | slice) -> S | list[S]:
        if isinstance(index, slice):
            return [self[n] for n in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        if index in self._held:
            return self._held[index]
        found = self._make(self._keys[index])
        if self._keep:
            self._held[index] = found
        return found
