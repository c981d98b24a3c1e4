"""States of methods: the table of levels, and what each level changes, packed and restored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Method, Pack, State
from rfpipe.transport.lazy import LazySequence

Arrays = Mapping[str, NDArray[Any]]
S = TypeVar("S", bound=Any)


def level_row(level: int, patterns: int, **counts: Any) -> dict[str, Any]:
    """Return a row of the table of levels; what isn't counted is 0."""
    names = ("nodes", "empty", "rank1", "scalar", "subdivided")
    return {"level": level, "patterns": patterns, **dict.fromkeys(names, 0), **counts}


def kept(kind: type) -> Any:
    """Return a state's field for a dataclass of arrays, or None; levels replace it."""
    return field(default=None, kw_only=True, metadata={"kind": kind})


def grown(kind: type) -> Any:
    """Return a state's field for a sequence of dataclasses of arrays; levels add to it."""
    return field(default=(), kw_only=True, metadata={"kind": kind, "grows": True})


def lengthened(kind: type) -> Any:
    """Return a state's field for a dataclass of arrays, or None; levels add rows to its arrays."""
    return field(default=None, kw_only=True, metadata={"kind": kind, "lengthens": True})


@dataclass(frozen=True)
class MethodState:
    """What the states of rfpipe's own methods have in common.

    Fields are plain data, arrays, or dataclasses of both (`kept`, `grown`, `lengthened`). What a
    level changes, by `after` and `changed`, is packed and restored by its name.

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
    news : mapping of str to int
        Fields that the last level changed; how many sets or rows it added to those that grow.
    """

    camera: RayDomain
    projector: RayDomain
    channels: int
    options: Any
    level: int = field(default=0, kw_only=True)
    rows: tuple[dict[str, Any], ...] = field(default=(), kw_only=True)
    news: Mapping[str, int] = field(default_factory=dict, kw_only=True, repr=False)

    def after(self, row: dict[str, Any], **new: Any) -> Self:
        """Return the state after a level: its row of the table, and what `changed` takes."""
        following = replace(self, level=self.level + 1, rows=(*self.rows, row), news={})
        return following.changed(**new)

    def changed(self, **new: Any) -> Self:
        """Return the state with other fields; of those that grow, with more sets or rows."""
        news = dict(self.news)
        for each in fields(self):
            name, count = each.name, 1
            if name not in new:
                continue
            before, more = getattr(self, name), new[name]
            if "grows" in each.metadata:
                count, new[name] = len(more), (*before, *more)
            elif "lengthens" in each.metadata:
                count = len(next(iter(_values(more).values())))
                new[name] = more if before is None else joined([before, more], axis=0)
            news[name] = news.get(name, 0) + count
        return replace(self, **new, news=news)


class PackingMethod(Method[State]):
    """A method that packs and restores its states by the names of their fields."""

    def pack(self, state: Any) -> Pack:
        """Return what the last level changed."""
        arrays: dict[str, NDArray[Any]] = {}
        plain: dict[str, Any] = {}
        for each in fields(state):
            name, value = each.name, getattr(state, each.name)
            if name not in {"level", "rows", *state.news}:
                continue
            if isinstance(value, np.ndarray):
                arrays[name] = value
            elif "grows" in each.metadata:
                first = len(value) - state.news[name]
                plain[name] = [
                    _split(one, f"{name}_{number:03d}_", arrays)
                    for number, one in enumerate(value[first:], first)
                ]
            elif "lengthens" in each.metadata:
                rows = {
                    n: array[len(array) - state.news[name] :] for n, array in _values(value).items()
                }
                plain[name] = _split(rows, f"{name}_", arrays)
            elif "kind" in each.metadata and value is not None:
                plain[name] = _split(value, f"{name}_", arrays)
            else:
                plain[name] = list(value) if isinstance(value, tuple) else value
        truths = [name for name, array in arrays.items() if array.dtype == np.bool_]
        return Pack(
            arrays | {name: arrays[name].astype(np.uint8) for name in truths},
            plain | {"truths": truths},
        )

    def restore(self, start: Any, packs: Sequence[Pack]) -> Any:
        """Return the state after the last of `packs`, one a level from level 0 on."""
        values: dict[str, Any] = {}
        for each in fields(start):
            name = each.name
            kind: Any = each.metadata.get("kind")
            log = [pack for pack in packs if name in pack.attributes or name in pack.arrays]
            if not log:
                continue
            value = log[-1].attributes.get(name)
            if "grows" in each.metadata:
                sets = [(pack, plain) for pack in log for plain in pack.attributes[name]]
                numbered = [(f"{name}_{n:03d}_", *one) for n, one in enumerate(sets)]
                values[name] = LazySequence(numbered, partial(_whole, kind), keep=True)
            elif "lengthens" in each.metadata:
                parts = [_whole(kind, (f"{name}_", pack, pack.attributes[name])) for pack in log]
                values[name] = joined(parts, axis=0)
            elif name in log[-1].arrays:
                values[name] = _array(log[-1], name)
            elif kind is not None and value is not None:
                values[name] = _whole(kind, (f"{name}_", log[-1], value))
            else:
                values[name] = tuple(value) if isinstance(value, list) else value
        return replace(start, **values)


def _split(group: Any, prefix: str, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Write the arrays of a dataclass, or a mapping, by their names; return its plain data."""
    values: dict[str, Any] = group if isinstance(group, dict) else _values(group)
    members = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    arrays |= {f"{prefix}{name}": array for name, array in members.items()}
    return {name: value for name, value in values.items() if name not in members}


def _values(group: Any) -> dict[str, Any]:
    return {each.name: getattr(group, each.name) for each in fields(group) if each.init}


def _whole(kind: type, held: tuple[str, Pack, dict[str, Any]]) -> Any:
    """Undo `_split`."""
    prefix, pack, plain = held
    names = [name for name in pack.arrays if name.startswith(prefix)]
    return kind(**plain, **{name.removeprefix(prefix): _array(pack, name) for name in names})


def _array(pack: Pack, name: str) -> NDArray[Any]:
    array = pack.arrays[name]
    return array.astype(np.bool_) if name in pack.attributes["truths"] else array


def joined(parts: Sequence[S], axis: int = -1) -> S:
    """Put the arrays of dataclasses, one after the other, together; `parts` isn't empty."""
    if len(parts) == 1:
        return parts[0]
    groups = [_values(part) for part in parts]
    names = [name for name, value in groups[0].items() if isinstance(value, np.ndarray)]
    return replace(parts[0], **{n: np.concatenate([g[n] for g in groups], axis) for n in names})


def unprefixed(prefix: str, arrays: Arrays) -> Arrays:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    names = [name for name in arrays if name.startswith(prefix)]
    return {name.removeprefix(prefix): arrays[name] for name in names}
