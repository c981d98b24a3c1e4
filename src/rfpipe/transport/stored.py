"""Sets of arrays in a store, read when they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar, overload

from rfpipe.store import ArrayBundle

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


class SetsOnDemand(Sequence[S]):
    """Sets that are read when used, and kept in memory or read anew each time.

    Parameters
    ----------
    names : sequence of str
    read : callable
        Returns the set of a name.
    keep : bool
        Whether to keep in memory what was read.
    """

    def __init__(self, names: Sequence[str], read: Callable[[str], S], *, keep: bool) -> None:
        self._names = list(names)
        self._read = read
        self._keep = keep
        self._held: dict[int, S] = {}

    def __len__(self) -> int:
        return len(self._names)

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
        found = self._read(self._names[index])
        if self._keep:
            self._held[index] = found
        return found
