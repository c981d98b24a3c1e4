"""What a near/far acquisition knows before a level, and which level is of which kind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rfpipe.methods.held_out.patterns import MOST_HELD_OUT
from rfpipe.methods.held_out.rounds import HeldOutState
from rfpipe.methods.near_far.model import Model
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.residual.estimate import Residual
from rfpipe.methods.residual.pictures import CellPictures
from rfpipe.methods.symmetric.method import SymmetricState

__all__ = ["BLOCKS", "MOST", "ROUNDS", "Kind", "NearFarState", "kind_of"]

Kind = Literal["floodlit", "smooth", "residual", "hierarchy", "done"]

# Probes of each round, a level: a round should cut the error, and end soon where the target is met.
ROUNDS = (6, 10, 8, 12, 16, 24, 32)
# Block patterns of each round of what the model leaves: some 1.4 times all before it.
BLOCKS = (12, 20, 28, 40, 60, 88)
MOST = 1 + MOST_HELD_OUT + sum(ROUNDS) + sum(BLOCKS)
"""Patterns of all rounds, those after a hierarchy not counted."""


def kind_of(level: int, hierarchy: int) -> Kind:
    """Return what a level is for.

    Rounds of smooth light come first, then rounds of what they leave, then the levels of symmetric
    photography below its floodlit one, then rounds of what those leave.

    Parameters
    ----------
    level : int
    hierarchy : int
        Levels of symmetric photography, the floodlit one included.
    """
    ends = (0, len(ROUNDS), len(ROUNDS) + len(BLOCKS), len(ROUNDS) + len(BLOCKS) + hierarchy - 1)
    kinds: tuple[Kind, ...] = ("floodlit", "smooth", "residual", "hierarchy")
    for kind, end in zip(kinds, ends, strict=True):
        if level <= end:
            return kind
    return "residual"


@dataclass(frozen=True)
class NearFarState(HeldOutState):
    """The state of a near/far acquisition, beside what those of all rounds have.

    Attributes
    ----------
    hierarchy : int
        Levels that symmetric photography has of this rig.
    following : Kind
        What is asked for next. Levels that are for something else show nothing.
    pictures : Pictures, optional
        All pictures of smooth light's rounds; None before the floodlit image.
    taken : CellPictures, optional
        Those of all other levels, which are looked at in cells alone.
    model : Model, optional
        Smooth light.
    symmetric : SymmetricState, optional
        Where symmetric photography has taken over.
    residual : Residual, optional
        What a model leaves, as it was found last.
    of_hierarchy : bool
        Whether that is what the hierarchy leaves.
    """

    hierarchy: int
    following: Kind = "smooth"
    pictures: Pictures | None = None
    taken: CellPictures | None = None
    model: Model | None = None
    symmetric: SymmetricState | None = None
    residual: Residual | None = None
    of_hierarchy: bool = False

    @property
    def kind(self) -> Kind:
        """What the next level is for."""
        return kind_of(self.level, self.hierarchy)
