"""What the states of methods share: rows of the table of levels, packing and restoring."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.base import Method, Pack, State

__all__ = [
    "Descent",
    "MethodState",
    "Packing",
    "PackingMethod",
    "appended",
    "arrays_of",
    "joined",
    "level_row",
    "unprefixed",
    "with_arrays",
]

Arrays = Mapping[str, NDArray[Any]]
S = TypeVar("S", bound=Any)

_COUNTS = ("nodes", "empty", "rank1", "scalar", "subdivided")


def level_row(level: int, patterns: int, **counts: Any) -> dict[str, Any]:
    """Return a row of the table of levels; what isn't counted is 0."""
    return {"level": level, "patterns": patterns, **dict.fromkeys(_COUNTS, 0), **counts}


@dataclass(frozen=True)
class MethodState:
    """What the states of rfpipe's own methods have in common.

    Attributes
    ----------
    camera, projector : RayDomain
        The same for methods that need a coaxial rig.
    channels : int
    options : Options
        The method's own.
    level : int
        Level to be scheduled next; 0 is the first.
    rows : tuple of dict
        The table of levels so far.
    """

    camera: RayDomain
    projector: RayDomain
    channels: int
    options: Any
    level: int = field(default=0, kw_only=True)
    rows: tuple[dict[str, Any], ...] = field(default=(), kw_only=True)

    def after(self, row: dict[str, Any], **found: Any) -> Self:
        """Return the state after a level: its row of the table, and what it found by name."""
        return replace(self, level=self.level + 1, rows=(*self.rows, row), **found)


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


class Descent(PackingMethod[State]):
    """A method that goes down the projector's block tree, from the floodlit root to its rays.

    Attributes
    ----------
    thesis_patterns : int
        Those of a scene of the thesis at 310 x 350 rays, in ten levels.
    tolerance_share : float
        The tolerance at which to meet a ``target_error``, as a share of it.
    """

    thesis_patterns: ClassVar[int]
    tolerance_share: ClassVar[float]

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the depth of the block tree."""
        self.check(camera, projector)
        return BlockTree(projector).n_levels

    def asks(self, state: Any) -> bool:
        """Tell whether blocks are left to subdivide, without colouring them."""
        return state.level == 0 or len(state.frontier) > 0

    def expected_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Guess the patterns from those of the thesis' scene, so many a level."""
        levels = self.n_levels(camera, projector)
        return min(projector.size, round(levels * self.thesis_patterns / 10))

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Return the patterns of a scene for which all blocks are lit one by one."""
        tree = BlockTree(projector)
        return sum(tree.n_blocks(level) for level in range(tree.n_levels))


def arrays_of(group: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Return the arrays of a dataclass by name, as stores keep them."""
    return {f"{prefix}{name}": _stored(array) for name, array in _held(group).items()}


def with_arrays(group: S, arrays: Arrays, prefix: str = "") -> S:
    """Return a dataclass with other arrays, by the names that `arrays_of` gave them."""
    own = {name: _like(array, arrays[f"{prefix}{name}"]) for name, array in _held(group).items()}
    return replace(group, **own)


def joined(parts: Sequence[S], axis: int = -1) -> S:
    """Put the arrays of dataclasses, found one after the other, together; `parts` isn't empty."""
    if len(parts) == 1:
        return parts[0]
    held = [_held(part) for part in parts]
    return replace(parts[0], **{n: np.concatenate([own[n] for own in held], axis) for n in held[0]})


def appended(before: S | None, more: S) -> S:
    """Put the arrays of a dataclass behind those of another, where there is one, by axis 0."""
    return more if before is None else joined([before, more], axis=0)


def unprefixed(prefix: str, arrays: Arrays) -> Arrays:
    """Return the arrays whose names begin with a prefix, by the rest of their names.

    Those of a store are read only where they are asked for.
    """
    names = {name.removeprefix(prefix): name for name in arrays if name.startswith(prefix)}
    return _Renamed(names, arrays)


@dataclass(frozen=True)
class _Renamed(Mapping[str, NDArray[Any]]):
    """Some of the arrays of a mapping, by other names."""

    names: Mapping[str, str]
    arrays: Arrays

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.arrays[self.names[name]]

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)


def _held(group: Any) -> dict[str, NDArray[Any]]:
    values = {found.name: getattr(group, found.name) for found in fields(group)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def _stored(array: NDArray[Any]) -> NDArray[Any]:
    """Return truth values as stores keep them, other arrays as they are."""
    return array.astype(np.uint8) if array.dtype == np.bool_ else array


def _like(array: NDArray[Any], stored: NDArray[Any]) -> NDArray[Any]:
    """Undo `_stored`."""
    return stored.astype(np.bool_) if array.dtype == np.bool_ else stored
