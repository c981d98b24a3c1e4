"""Arrays of a store that are read when they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Generic, TypeVar

from numpy.typing import NDArray

from rfpipe.store.arrays import ArrayBundle

K = TypeVar("K")
S = TypeVar("S")


class LazyArrays(Mapping[str, NDArray[Any]]):
    """Named arrays that are read at each use.

    Parameters
    ----------
    names : sequence of str
    read : callable
        Reads the array of a name.
    """

    def __init__(self, names: Sequence[str], read: Callable[[str], NDArray[Any]]) -> None:
        self._names, self._read = names, read

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(name)
        return self._read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._names  # the inherited method would read the array

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class LazySequence(Sequence[S], Generic[K, S]):
    """Items that are made from their keys when they are used.

    Parameters
    ----------
    keys : sequence
    make : callable
        Makes the item of a key.
    keep : bool
        Whether items stay in memory, in `kept`, by their index.
    """

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
        item = self._make(self.keys[numbers])
        if self.keep:
            self.kept[numbers] = item
        return item


def names_by_prefix(bundle: ArrayBundle, parts: Iterable[str]) -> dict[str, dict[str, str]]:
    """Group the names ``{prefix}_{part}`` of a store's arrays by prefix, then by part."""
    names: dict[str, dict[str, str]] = {}
    for name in bundle.names:
        for part in parts:
            if name.endswith(f"_{part}"):
                names.setdefault(name.removesuffix(f"_{part}"), {})[part] = name
    return dict(sorted(names.items()))
