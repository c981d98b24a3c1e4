"""What a footprint acquisition knows before a level, and which level is of which kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from numpy.typing import NDArray

from rfpipe.methods.dual import DualState
from rfpipe.methods.footprints.candidates import Footprints
from rfpipe.methods.held_out.patterns import MOST_HELD_OUT
from rfpipe.methods.held_out.rounds import HeldOutState
from rfpipe.methods.near_far.pictures import Pictures

__all__ = ["ROUNDS", "FootprintState", "Kind", "in_round", "kind_of", "most_of"]

Kind = Literal["floodlit", "round", "hierarchy", "done"]

# Random patterns of each round, a level. The first has to be enough to find footprints. Of several
# views, which are lit one at a time, each has as many as the second tuple tells.
ROUNDS = (24, 26, 36, 48, 64, 80)
_VIEW_ROUNDS = (24, 12, 16, 24, 32, 40)


def in_round(number: int, views: int) -> int:
    """Return the patterns of a round, numbered from 0, of a projector of so many views."""
    if views == 1:
        return ROUNDS[number]
    # each view is lit whole at first
    return views * (_VIEW_ROUNDS[number] + (number == 0))


def most_of(views: int) -> int:
    """Return the patterns of all rounds, the floodlit and the held-out ones among them."""
    return 1 + MOST_HELD_OUT + sum(in_round(number, views) for number in range(len(ROUNDS)))


def kind_of(level: int) -> Kind:
    """Return what a level is for: rounds come first, then the levels of dual photography."""
    if level == 0:
        return "floodlit"
    return "round" if level <= len(ROUNDS) else "hierarchy"


@dataclass(frozen=True)
class FootprintState(HeldOutState):
    """The state of a footprint acquisition, beside what those of all rounds have.

    Attributes
    ----------
    following : Kind
        What is asked for next. Levels that are for something else show nothing.
    unfit : bool
        Whether the model has turned out not to fit: all that its rounds still show is what is held
        out.
    pictures : Pictures, optional
        All pictures of the rounds; None before the floodlit image.
    model : mapping of str to ndarray, optional
        The arrays of the `FootprintTransport` that was found last.
    found : Footprints, optional
        With what the next search begins, in the unit of the fits.
    dual : DualState, optional
        Where dual photography has taken over.
    """

    following: Kind = "round"
    unfit: bool = False
    pictures: Pictures | None = None
    model: Mapping[str, NDArray[Any]] | None = None
    found: Footprints | None = None
    dual: DualState | None = None

    @property
    def kind(self) -> Kind:
        """What the next level is for."""
        return kind_of(self.level)
