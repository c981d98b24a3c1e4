"""What a targeted acquisition knows before a level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.held_out.estimate import Held
from rfpipe.methods.held_out.patterns import MOST_HELD_OUT
from rfpipe.methods.states import MethodState

__all__ = ["Kind", "Shown", "TargetedState"]

Kind = Literal["inner", "held", "done"]


@dataclass(frozen=True)
class Shown:
    """What a level was for.

    Attributes
    ----------
    kind : Kind
    patterns : int
    error : float or None
        Estimated of what would be returned from then on; None where nothing was seen of it.
    """

    kind: Kind
    patterns: int
    error: float | None


@dataclass(frozen=True)
class TargetedState:
    """The state of a targeted acquisition before a level.

    Attributes
    ----------
    inner, best : MethodState
        The state of the method that goes down the tree, and that whose transport predicts the
        held-out pictures best: of a level further up, where the levels below made it worse.
    target_error : float
    shown : tuple of Shown
        The levels so far.
    following : Kind
        What the next level is for: the inner method, held-out pictures or nothing.
    held : Held, optional
        Pictures that the inner method doesn't see; None before there are any.
    known : ndarray of bool, shape (M,), optional
        Camera pixels that the pictures show; None before.
    error : float, optional
        Estimated of `best`; None before there are held-out pictures.
    """

    inner: MethodState
    best: MethodState
    target_error: float
    shown: tuple[Shown, ...] = ()
    following: Kind = "inner"
    held: Held | None = None
    known: NDArray[np.bool_] | None = None
    error: float | None = None

    @property
    def level(self) -> int:
        """Level to be scheduled next."""
        return len(self.shown)

    @property
    def all_held(self) -> bool:
        """Whether all held-out pictures are there."""
        return self.held is not None and len(self.held.lit) == MOST_HELD_OUT

    @cached_property
    def rows(self) -> tuple[dict[str, Any], ...]:
        """The table of levels so far: those of the inner method under their numbers here.

        ``block_level`` is the level of the block tree that they have reached.
        """
        rows, block_level = [], -1
        for level, shown in enumerate(self.shown):
            counts = dict.fromkeys(self.inner.rows[0], 0)
            if shown.kind == "inner":
                block_level += 1
                counts = self.inner.rows[block_level]
            own = {"level": level, "patterns": shown.patterns, "block_level": block_level}
            told = {} if shown.error is None else {"estimated_error": shown.error}
            rows.append({**counts, **own, **told})
        return tuple(rows)

    def after(self, shown: Shown, following: Kind) -> TargetedState:
        """Return the state after a level."""
        return replace(self, shown=(*self.shown, shown), following=following)
