"""The state of an acquisition in rounds: its pictures, its models, and what they are wrong by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from rfpipe.methods.error_estimate import Estimate
from rfpipe.methods.images import Pictures
from rfpipe.methods.residual.model import CellPictures, Residual
from rfpipe.methods.states import MethodState, grown, kept, lengthened

SURE = 0.95
"""Share of the target at which an estimate ends an acquisition.

Estimates have a standard deviation of 15 % on open scenes of 32 x 36 pixels and more, and of 20 %
on smaller ones: 95 % of the targets are met within a fifth.
"""


@dataclass(frozen=True)
class AdaptiveState(MethodState):
    """The state of an acquisition in rounds.

    Attributes
    ----------
    following : str
        What the next level that shows patterns is for: ``model``, ``residual``, ``hierarchy`` or
        ``done``.
    taken, others : Pictures and CellPictures, optional
        Of the model's rounds, the floodlit one first; of all other levels, in cells alone.
    estimates : sequence of Estimate
        After each level that had images, of what is returned from then on.
    model : object, optional
        What the method fits to `taken`.
    residual : Residual, optional
        What the model, or the hierarchy (`of_hierarchy`), leaves.
    unfit : bool
        Whether the model has turned out not to fit: all that its rounds still show is held out.
    inner : MethodState, optional
        Where a hierarchy has taken over.
    tolerance : float
        Of the hierarchy.
    descended : tuple of int
        The levels of the hierarchy's own rows.
    """

    options: Any
    following: str = "model"
    taken: Pictures | None = lengthened(Pictures)
    others: CellPictures | None = lengthened(CellPictures)
    held: Pictures | None = kept(Pictures)
    estimates: Sequence[Estimate] = grown(Estimate)
    model: Any = None
    residual: Residual | None = kept(Residual)
    of_hierarchy: bool = False
    unfit: bool = False
    inner: Any = None
    tolerance: float = 0.0
    descended: tuple[int, ...] = ()

    @property
    def pictures(self) -> Pictures:
        """All pictures of the model's rounds; before any, a dark floodlit one."""
        if self.taken is not None:
            return self.taken
        dark = np.zeros((1, self.channels, self.camera.size), np.float32)
        return Pictures(np.ones((1, self.projector.size), np.bool_), dark, dark)

    @property
    def shown(self) -> int:
        """Patterns shown so far."""
        return sum(row["patterns"] for row in self.rows)

    @property
    def excess(self) -> list[float]:
        """The estimates over what is surely the target, in total or of indirect light."""
        targets = self.options.target_error, getattr(self.options, "target_indirect", None)
        total, indirect = (SURE * (target or np.inf) for target in targets)
        return [float(np.fmax(e.error / total, e.indirect / indirect)) for e in self.estimates]

    @property
    def reached(self) -> bool:
        """Whether the last estimate is at most what is surely the target."""
        return bool(self.estimates) and self.excess[-1] <= 1

    def counted(self, **counts: Any) -> Self:
        """Return the state with more in the last level's row of the table."""
        return replace(self, rows=(*self.rows[:-1], {**self.rows[-1], **counts}))

    def estimated(self, estimate: Estimate) -> Self:
        """Return the state with an estimate, told in the last level's row."""
        told = {"estimated_error": estimate.error}
        if np.isfinite(estimate.indirect):
            told["estimated_indirect"] = estimate.indirect
        return self.counted(**told).changed(estimates=[estimate])
