"""Sets of arrays, read from a store when they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar, overload

from rfpipe.store.arrays import ArrayBundle

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
    return bundle.nbytes <= memory_budget


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
