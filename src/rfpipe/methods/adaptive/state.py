"""State of an adaptive acquisition: pictures, models, estimated errors and the next round."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.adaptive.model import AdaptiveModel
from rfpipe.methods.base import ErrorOptions, StateArrays, options_of
from rfpipe.methods.error_estimate import Estimate
from rfpipe.methods.images import Pictures
from rfpipe.methods.multiplexed.method import Multiplexed, MultiplexedOptions, MultiplexedState
from rfpipe.methods.residual.model import CellPictures, Residual
from rfpipe.methods.states import MethodState, joined, picture_count, with_prefix, without_prefix
from rfpipe.transport.base import Transport
from rfpipe.transport.lazy import LazySequence

STOPPING_FRACTION = 0.95
"""Estimated error at which an acquisition ends, relative to the target.

On the benchmark's tuning scenes (`rfpipe.methods.adaptive.decisions`), estimates have a standard
deviation of 15 % from 32 x 36 pixels on and of 20 % on smaller images. With this margin 98 % of the
results have an error of at most 1.2 times the target.
"""

HIERARCHY_METHOD = Multiplexed()
"""Method of the hierarchy."""

HIERARCHY_TOLERANCE = 0.2
"""Tolerance of the hierarchy, relative to the target of the total error."""


class Phase(StrEnum):
    """Phases of an acquisition, in their order; each may be skipped."""

    FLOODLIT = "floodlit"
    PRIOR = "prior"
    """Held-out pictures of each kind, which judge the prior."""
    MODEL = "model"
    """Rounds of random patterns for the model."""
    RESIDUAL = "residual"
    """Rounds of random blocks for the model's residual."""
    HIERARCHY = "hierarchy"
    """Rounds of multiplexed dual photography, which don't use the model."""
    DENSE = "dense"
    """Rounds of random blocks for the residual, after a hierarchy that doesn't suit the light."""


@dataclass(frozen=True)
class Round:
    """The patterns of one level.

    Attributes
    ----------
    phase : Phase
    index : int
        Number of the round within its phase, from 0.
    key : int
        Number of the round over all phases: 1 + the largest numbers of rounds of all earlier
        phases + `index`. Rounds draw different random patterns because their keys differ.
    held_out, count : int
        Numbers of held-out patterns, and of random patterns after them; 0 for the floodlit pattern.
        In a hierarchy, `count` is the largest number of patterns, 0 for as many as it takes.
    """

    phase: Phase
    index: int = 0
    key: int = 0
    held_out: int = 0
    count: int = 0


@dataclass(frozen=True)
class AdaptiveState(MethodState):
    """State of an adaptive acquisition between two rounds.

    Attributes
    ----------
    next_round : Round, optional
        None at the end.
    floodlit : Pictures, optional
        The floodlit picture alone. None before it is taken.
    pictures : sequence of pictures of `pictures_type`
        Pictures of the model's rounds as the model's fit takes them, in parts that are never
        copied; the first is floodlit. Those of a restored state are read when first used.
    cell_pictures : CellPictures, optional
        Pictures of all rounds, fitted to cells; the first is floodlit.
    held_out : Pictures, optional
        Held-out pictures.
    estimates : tuple of Estimate
        Estimated error after each round, of the transport that would be returned.
    model : AdaptiveModel, optional
        The model fitted to `pictures`; None before the floodlit picture.
    residual : Residual, optional
        Residual of the model.
    hierarchy_state : MultiplexedState, optional
        State of multiplexed dual photography, once it has begun.
    hierarchy_levels : tuple of int
        Numbers of the acquisition's levels that refined the hierarchy.
    prior : Transport, optional
        Transport of the same rig, of an earlier acquisition of this or a similar scene.
    prior_is_refuted : bool
        Whether held-out pictures have shown that the prior doesn't help.
    """

    pictures_type: ClassVar[Any]
    """Type of `pictures`: a dataclass of arrays whose first axis are the pictures."""

    options: ErrorOptions
    next_round: Round | None = Round(Phase.FLOODLIT)
    floodlit: Pictures | None = None
    pictures: Sequence[Any] = ()
    cell_pictures: CellPictures | None = None
    held_out: Pictures | None = None
    estimates: tuple[Estimate, ...] = ()
    model: AdaptiveModel | None = None
    residual: Residual | None = None
    hierarchy_state: MultiplexedState | None = None
    hierarchy_levels: tuple[int, ...] = ()
    prior: Transport | None = None
    prior_is_refuted: bool = False

    # --- derived quantities

    @property
    def accepted_prior(self) -> Transport | None:
        """The prior of the models, None if the held-out pictures refuted it."""
        return None if self.prior_is_refuted else self.prior

    @property
    def patterns_shown(self) -> int:
        """Number of patterns so far; `options.patterns` is the largest number, 0 for no limit."""
        return sum(row["patterns"] for row in self.rows)

    @property
    def allows_hierarchy(self) -> bool:
        """True without a limit on the number of patterns: a hierarchy must be complete."""
        return not self.options.patterns

    @property
    def errors(self) -> list[float]:
        """Estimated errors of relit pictures after each round."""
        return [estimate.error for estimate in self.estimates]

    @property
    def excess(self) -> list[float]:
        """Estimated errors after each round, divided by 95 % of their targets.

        The larger ratio of two: for all light, and for indirect light.
        """
        total = STOPPING_FRACTION * self.options.target_error
        indirect = STOPPING_FRACTION * (self.options.target_indirect or np.inf)
        return [float(np.fmax(e.error / total, e.indirect / indirect)) for e in self.estimates]

    @property
    def meets_target(self) -> bool:
        """True if the last estimate is at most 95 % of the target."""
        return bool(self.estimates) and self.excess[-1] <= 1

    # --- the next state

    def with_row(self, **entries: Any) -> Self:
        """Add entries to the last level's row of the table."""
        return replace(self, rows=(*self.rows[:-1], {**self.rows[-1], **entries}))

    def with_estimate(self, estimate: Estimate) -> Self:
        """Add an estimate, also to the last level's row.

        An error of indirect light above 1 says that there is less of it than noise.
        """
        entries = {"estimated_error": estimate.error}
        if estimate.indirect <= 1:
            entries["estimated_indirect"] = estimate.indirect
        return replace(self.with_row(**entries), estimates=(*self.estimates, estimate))

    def with_held_out(self, pictures: Pictures) -> Self:
        """Add held-out pictures."""
        parts = [pictures] if self.held_out is None else [self.held_out, pictures]
        return replace(self, held_out=joined(parts, axis=0))

    def with_pictures(self, parts: Iterable[Any]) -> Self:
        """Add pictures of a round of the model, prepared for its fit."""
        return replace(self, pictures=(*self.pictures, *parts))

    def with_cell_pictures(self, pictures: CellPictures) -> Self:
        """Add pictures of a round, fitted to cells."""
        parts = [pictures] if self.cell_pictures is None else [self.cell_pictures, pictures]
        return replace(self, cell_pictures=joined(parts, axis=0))

    # --- storage

    @classmethod
    def restored_pictures(cls, arrays: Mapping[str, NDArray[Any]]) -> Any:
        """Restore pictures of `pictures_type` from their arrays."""
        return cls.pictures_type(**arrays)

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return new pictures, parts that were replaced, and what the hierarchy added."""
        attributes: dict[str, Any] = {
            "prior_is_refuted": self.prior_is_refuted,
            "next_round": None if self.next_round is None else asdict(self.next_round),
            "rows": list(self.rows),
            "hierarchy_levels": list(self.hierarchy_levels),
            "estimates": [asdict(estimate) for estimate in self.estimates],
        }
        arrays: dict[str, NDArray[Any]] = {}
        for prefix, pictures, before in (
            ("floodlit_", self.floodlit, previous.floodlit),
            ("cell_pictures_", self.cell_pictures, previous.cell_pictures),
            ("held_out_", self.held_out, previous.held_out),
        ):
            if pictures is not None and pictures is not before:
                arrays |= with_prefix(prefix, _new_pictures(pictures, before))
        if added := self.pictures[len(previous.pictures) :]:
            arrays |= with_prefix("pictures_", _new_pictures(joined(added, axis=0), None))
        if self.residual is not previous.residual:
            attributes["has_residual"] = self.residual is not None
            if self.residual is not None:
                arrays |= with_prefix("residual_", _residual_arrays(self.residual))
        inner = self.hierarchy_state
        if inner is not None and inner is not previous.hierarchy_state:
            start = previous.hierarchy_state
            start = hierarchy_start(self) if start is None else start
            changed = inner.to_arrays(start)
            arrays |= with_prefix("hierarchy_", changed.arrays)
            attributes["hierarchy"] = dict(changed.attributes)
        return StateArrays(arrays, attributes)

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore a state; the model is restored by the method's own class of states."""
        if not levels:
            return start
        last = levels[-1].attributes
        next_round = last["next_round"]
        pictures = [without_prefix("pictures_", level.arrays) for level in levels]
        state = replace(
            start,
            next_round=None if next_round is None else _round(**next_round),
            rows=tuple(last["rows"]),
            hierarchy_levels=tuple(last["hierarchy_levels"]),
            estimates=tuple(Estimate(**values) for values in last["estimates"]),
            floodlit=_all(_pictures(Pictures, "floodlit_", levels)),
            pictures=LazySequence(
                [arrays for arrays in pictures if arrays], cls.restored_pictures, keep=True
            ),
            cell_pictures=_all(_pictures(CellPictures, "cell_pictures_", levels)),
            held_out=_all(_pictures(Pictures, "held_out_", levels)),
            residual=_residual(levels),
            prior_is_refuted=last["prior_is_refuted"],
        )
        added = [
            StateArrays(without_prefix("hierarchy_", level.arrays), level.attributes["hierarchy"])
            for level in levels
            if "hierarchy" in level.attributes
        ]
        if not added:
            return state
        before = hierarchy_start(state)
        return replace(state, hierarchy_state=MultiplexedState.from_arrays(before, added))


def hierarchy_start(state: AdaptiveState) -> MultiplexedState:
    """Return the state of the hierarchy before its floodlit level."""
    options = options_of(
        HIERARCHY_METHOD,
        tolerance=HIERARCHY_TOLERANCE * state.options.total_target,
        noise_significance=state.options.noise_significance,
    )
    assert isinstance(options, MultiplexedOptions)
    return HIERARCHY_METHOD.start(state.camera, state.projector, state.channels, options)


def latest(attribute: str, levels: Sequence[StateArrays]) -> StateArrays | None:
    """Return the last level that has an attribute; None if none of them has it."""
    return next((level for level in reversed(levels) if attribute in level.attributes), None)


def merged(parts: StateArrays, arrays: Mapping[str, Any], **attributes: Any) -> StateArrays:
    """Return stored parts of a state with more arrays and attributes."""
    return StateArrays({**parts.arrays, **arrays}, {**parts.attributes, **attributes})


def _round(phase: str, **numbers: int) -> Round:
    return Round(Phase(phase), **numbers)


def _new_pictures(pictures: Any, before: Any) -> dict[str, NDArray[Any]]:
    """Return the arrays of pictures without those that there were before, None for none."""
    first = 0 if before is None else picture_count(before)
    arrays = {entry.name: getattr(pictures, entry.name) for entry in fields(pictures)}
    return {name: array[first:] if first else array for name, array in arrays.items()}


def _residual_arrays(residual: Residual) -> dict[str, NDArray[Any]]:
    return {
        "pairs": residual.pairs,
        "cores": residual.cores,
        "projector_factor": residual.projector_factor,
    }


def _pictures(kind: Any, prefix: str, levels: Sequence[StateArrays]) -> tuple[Any, ...]:
    """Return the pictures of each level that has some."""
    first = fields(kind)[0].name
    return tuple(
        kind(**without_prefix(prefix, level.arrays))
        for level in levels
        if f"{prefix}{first}" in level.arrays
    )


def _all(parts: tuple[Any, ...]) -> Any:
    """Concatenate pictures; None if there are none."""
    return joined(parts, axis=0) if parts else None


def _residual(levels: Sequence[StateArrays]) -> Residual | None:
    """Read the residual of the last level that replaced it."""
    level = latest("has_residual", levels)
    if level is None or not level.attributes["has_residual"]:
        return None
    return Residual(**without_prefix("residual_", level.arrays))
