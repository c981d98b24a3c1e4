"""Common parts of the states of rfpipe's methods: the table of levels, and groups of arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.store.scratch import ScratchArray
from rfpipe.transport.lazy import LazyArrays

Arrays = Mapping[str, NDArray[Any]]
Group = TypeVar("Group", bound=Any)


def level_row(level: int, patterns: int, **counts: Any) -> dict[str, Any]:
    """Return a row of the table of levels; counts that aren't given are 0."""
    names = ("nodes", "empty", "rank1", "scalar", "subdivided")
    return {"level": level, "patterns": patterns, **dict.fromkeys(names, 0), **counts}


@dataclass(frozen=True)
class MethodState:
    """Fields of the state of every method of rfpipe.

    Attributes
    ----------
    camera, projector : RayDomain
        The same for methods that need a coaxial rig.
    channels : int
        Colour channels.
    options : Options
        The method's options.
    rows : tuple of dict
        The table of levels so far, one row per level.
    """

    camera: RayDomain
    projector: RayDomain
    channels: int
    options: Any
    rows: tuple[dict[str, Any], ...] = field(default=(), kw_only=True)

    @property
    def level(self) -> int:
        """Number of the next level, from 0. Methods that go down a block tree show its levels."""
        return len(self.rows)


def with_prefix(prefix: str, arrays: Arrays) -> dict[str, NDArray[Any]]:
    """Return arrays by their names with a prefix."""
    return {f"{prefix}{name}": array for name, array in arrays.items()}


def without_prefix(prefix: str, arrays: Arrays) -> LazyArrays:
    """Return the arrays of one prefix by their names without it; each is read when first used."""
    names = [name.removeprefix(prefix) for name in arrays if name.startswith(prefix)]
    return LazyArrays(names, lambda name: arrays[f"{prefix}{name}"])


def picture_count(pictures: Any) -> int:
    """Return the number of pictures in a dataclass whose arrays have a picture a row."""
    return len(getattr(pictures, fields(pictures)[0].name))


def joined(parts: Sequence[Group], axis: int = -1) -> Group:
    """Concatenate the arrays of dataclasses, field by field; `parts` isn't empty."""
    if len(parts) == 1:
        return parts[0]
    names = [
        entry.name
        for entry in fields(parts[0])
        if entry.init and isinstance(getattr(parts[0], entry.name), np.ndarray | ScratchArray)
    ]
    arrays = {name: np.concatenate([getattr(part, name) for part in parts], axis) for name in names}
    return replace(parts[0], **arrays)
