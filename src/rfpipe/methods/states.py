"""What the states of methods share: rows of the table of levels, packing and restoring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Method, Pack, State

__all__ = ["Packing", "PackingMethod", "arrays_of", "level_row", "unprefixed", "with_arrays"]

Arrays = Mapping[str, NDArray[Any]]
S = TypeVar("S", bound=Any)

_COUNTS = ("nodes", "empty", "rank1", "scalar", "subdivided")


def level_row(level: int, patterns: int, **counts: Any) -> dict[str, Any]:
    """Return a row of the table of levels; what isn't counted is 0."""
    return {"level": level, "patterns": patterns, **dict.fromkeys(_COUNTS, 0), **counts}


@dataclass(frozen=True)
class Packing:
    """Which fields of a method's states are packed, and how.

    Attributes
    ----------
    plain : tuple of str
        Plain data; tuples are packed as lists.
    arrays : tuple of str
    groups : mapping of str to str
        Dataclasses of arrays, and what the names of their arrays begin with.
    latest : tuple of str
        Tuples of arrays to which each level adds one.
    """

    plain: tuple[str, ...]
    arrays: tuple[str, ...] = ()
    groups: Mapping[str, str] = field(default_factory=dict)
    latest: tuple[str, ...] = ()


class PackingMethod(Method[State]):
    """A method that packs and restores its states by the names of their fields.

    Attributes
    ----------
    packing : Packing
    """

    packing: ClassVar[Packing]

    def pack(self, state: State) -> Pack:
        """Return what the last refinement added, and what the next one needs."""
        arrays = {name: _stored(getattr(state, name)) for name in self.packing.arrays}
        arrays |= {name: getattr(state, name)[-1] for name in self.packing.latest}
        for name, prefix in self.packing.groups.items():
            arrays |= arrays_of(getattr(state, name), prefix)
        plain = {name: getattr(state, name) for name in self.packing.plain}
        return Pack(
            arrays,
            {name: list(v) if isinstance(v, tuple) else v for name, v in plain.items()},
        )

    def restore(self, start: State, packs: Sequence[Pack]) -> State:
        """Return the state after the last of `packs`, one a level from level 0 on."""
        return self._restored(start, packs) if packs else start

    def _restored(self, start: State, packs: Sequence[Pack]) -> State:
        last = packs[-1]
        plain = {name: last.attributes[name] for name in self.packing.plain}
        found = {name: tuple(v) if isinstance(v, list) else v for name, v in plain.items()}
        for name in self.packing.arrays:
            found[name] = _like(getattr(start, name), last.arrays[name])
        for name in self.packing.latest:
            found[name] = tuple(pack.arrays[name] for pack in packs)
        for name, prefix in self.packing.groups.items():
            found[name] = with_arrays(getattr(start, name), last.arrays, prefix)
        restored: State = replace(start, **found)  # type: ignore[type-var]
        return restored


def arrays_of(group: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Return the arrays of a dataclass by name, as stores keep them."""
    return {f"{prefix}{name}": _stored(array) for name, array in _held(group).items()}


def with_arrays(group: S, arrays: Arrays, prefix: str = "") -> S:
    """Return a dataclass with other arrays, by the names that `arrays_of` gave them."""
    own = {name: _like(array, arrays[f"{prefix}{name}"]) for name, array in _held(group).items()}
    return replace(group, **own)


def unprefixed(prefix: str, arrays: Arrays) -> dict[str, NDArray[Any]]:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    return {
        name.removeprefix(prefix): array
        for name, array in arrays.items()
        if name.startswith(prefix)
    }


def _held(group: Any) -> dict[str, NDArray[Any]]:
    values = {found.name: getattr(group, found.name) for found in fields(group)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def _stored(array: NDArray[Any]) -> NDArray[Any]:
    """Return truth values as stores keep them, other arrays as they are."""
    return array.astype(np.uint8) if array.dtype == np.bool_ else array


def _like(array: NDArray[Any], stored: NDArray[Any]) -> NDArray[Any]:
    """Undo `_stored`."""
    return stored.astype(np.bool_) if array.dtype == np.bool_ else stored
