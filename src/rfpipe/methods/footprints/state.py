"""What a footprint acquisition knows before a level, and which level is of which kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from numpy.typing import NDArray

from rfpipe.methods.base import ErrorOptions
from rfpipe.methods.dual import DualState
from rfpipe.methods.footprints.candidates import Footprints
from rfpipe.methods.held_out.estimate import Estimate, Held
from rfpipe.methods.held_out.patterns import MOST_HELD_OUT
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.states import MethodState

__all__ = ["MOST", "ROUNDS", "FootprintState", "Kind", "kind_of"]

Kind = Literal["floodlit", "round", "hierarchy", "done"]

# Random patterns of each round, a level. The first has to be enough to find footprints.
ROUNDS = (24, 26, 36, 48, 64, 80)
MOST = 1 + MOST_HELD_OUT + sum(ROUNDS)
"""Patterns of all rounds."""


def kind_of(level: int) -> Kind:
    """Return what a level is for: rounds come first, then the levels of dual photography."""
    if level == 0:
        return "floodlit"
    return "round" if level <= len(ROUNDS) else "hierarchy"


@dataclass(frozen=True)
class FootprintState(MethodState):
    """The state of a footprint acquisition, beside what all states have.

    Attributes
    ----------
    following : Kind
        What is asked for next. Levels that are for something else show nothing.
    unfit : bool
        Whether the model has turned out not to fit: all that its rounds still show is what is held
        out.
    pictures : Pictures, optional
        All pictures of the rounds; None before the floodlit image.
    new, new_held : int
        How many of them, and of `held`, the last level brought.
    held : Held, optional
        Patterns of the projector and pictures that no fit sees; None before the first round.
    model : mapping of str to ndarray, optional
        The arrays of the `FootprintTransport` that was found last.
    found : Footprints, optional
        With what the next search begins, in the unit of the fits.
    dual : DualState, optional
        Where dual photography has taken over.
    estimates : tuple of Estimate
        After each level that had images, of what is returned from then on.
    """

    options: ErrorOptions
    following: Kind = "round"
    unfit: bool = False
    pictures: Pictures | None = None
    new: int = 0
    new_held: int = 0
    held: Held | None = None
    model: Mapping[str, NDArray[Any]] | None = None
    found: Footprints | None = None
    dual: DualState | None = None
    estimates: tuple[Estimate, ...] = ()

    @property
    def kind(self) -> Kind:
        """What the next level is for."""
        return kind_of(self.level)

    @property
    def shown(self) -> int:
        """Patterns shown so far."""
        return sum(row["patterns"] for row in self.rows)
