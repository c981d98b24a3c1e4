"""State of an acquisition in rounds: its pictures, its models and their estimated errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Method, StateArrays, get_method, options_of
from rfpipe.methods.error_estimate import Estimate
from rfpipe.methods.images import Pictures
from rfpipe.methods.residual.model import CellPictures, Residual
from rfpipe.methods.states import MethodState, joined, with_prefix, without_prefix

SURE = 0.95
"""Share of the target at which an estimate ends an acquisition.

Estimates have a standard deviation of 15 % on open scenes of 32 x 36 pixels and more, and of 20 %
on smaller ones: 95 % of the targets are met within a fifth.
"""

_PLAIN = ("slot", "following", "of_hierarchy", "unfit", "tolerance")


@dataclass(frozen=True)
class AdaptiveState(MethodState):
    """State of an acquisition in rounds.

    Attributes
    ----------
    slot : int
        Number of the last round in the method's table of rounds; 0 for the floodlit image. It
        seeds the random patterns.
    following : str
        Purpose of the next round: ``model``, ``residual``, ``hierarchy`` or ``done``.
    taken, others : Pictures and CellPictures, optional
        Pictures of the model's rounds, the floodlit one first; of all other levels, in cells.
    estimates : sequence of Estimate
        After each level that had images, of the transport that would be returned.
    model : object, optional
        What the method fits to `taken`.
    residual : Residual, optional
        Residual of the model, or of the hierarchy (`of_hierarchy`).
    unfit : bool
        Whether the model has turned out not to fit: its rounds show held-out patterns alone.
    inner : MethodState, optional
        State of the hierarchy.
    tolerance : float
        Tolerance of the hierarchy.
    descended : tuple of int
        The levels of the hierarchy's own rows.
    """

    hierarchy: ClassVar[str]
    """Name of the method that goes down the block tree."""

    options: Any
    slot: int = 0
    following: str = "model"
    taken: Pictures | None = None
    others: CellPictures | None = None
    held: Pictures | None = None
    estimates: tuple[Estimate, ...] = ()
    model: Any = None
    residual: Residual | None = None
    of_hierarchy: bool = False
    unfit: bool = False
    inner: Any = None
    tolerance: float = 0.0
    descended: tuple[int, ...] = ()

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return new pictures, models that were replaced, and what the hierarchy added."""
        attributes: dict[str, Any] = {name: getattr(self, name) for name in _PLAIN}
        attributes |= {
            "rows": list(self.rows),
            "descended": list(self.descended),
            "estimates": [asdict(estimate) for estimate in self.estimates],
        }
        arrays: dict[str, NDArray[Any]] = {}
        for name, pictures, known in (
            ("taken_", self.taken, previous.taken),
            ("others_", self.others, previous.others),
            ("held_", self.held, previous.held),
        ):
            if pictures is not None and pictures is not known:
                count = 0 if known is None else len(known.lit)
                arrays |= with_prefix(name, _picture_arrays(pictures, count))
        if self.residual is not previous.residual:
            attributes["has_residual"] = self.residual is not None
            if self.residual is not None:
                arrays |= with_prefix("residual_", _residual_arrays(self.residual))
        if self.inner is not previous.inner:
            start = hierarchy_start(self) if previous.inner is None else previous.inner
            inner = self.inner.to_arrays(start)
            arrays |= with_prefix("inner_", inner.arrays)
            attributes["inner"] = dict(inner.attributes)
        return StateArrays(arrays, attributes)

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state; the hierarchy's leaves are read when first used."""
        if not levels:
            return start
        last = levels[-1].attributes
        estimates = tuple(Estimate(**values) for values in last["estimates"])
        state = replace(
            start,
            rows=tuple(last["rows"]),
            descended=tuple(last["descended"]),
            estimates=estimates,
            taken=_pictures_of(Pictures, "taken_", levels),
            others=_pictures_of(CellPictures, "others_", levels),
            held=_pictures_of(Pictures, "held_", levels),
            residual=_residual_of(levels),
            **{name: last[name] for name in _PLAIN},
        )
        inner = [
            StateArrays(without_prefix("inner_", level.arrays), level.attributes["inner"])
            for level in levels
            if "inner" in level.attributes
        ]
        if not inner:
            return state
        before = hierarchy_start(state)
        return replace(state, inner=type(before).from_arrays(before, inner))

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
        targets = self.options.target_error, self.options.target_indirect
        total, indirect = (SURE * (target or np.inf) for target in targets)
        return [float(np.fmax(e.error / total, e.indirect / indirect)) for e in self.estimates]

    @property
    def reached(self) -> bool:
        """Whether the last estimate is at most what is surely the target."""
        return bool(self.estimates) and self.excess[-1] <= 1

    def counted(self, **counts: Any) -> Self:
        """Return the state with more entries in the last level's row of the table."""
        return replace(self, rows=(*self.rows[:-1], {**self.rows[-1], **counts}))

    def estimated(self, estimate: Estimate) -> Self:
        """Return the state with an estimate, also in the last level's row."""
        entries = {"estimated_error": estimate.error}
        if np.isfinite(estimate.indirect):
            entries["estimated_indirect"] = estimate.indirect
        return replace(self.counted(**entries), estimates=(*self.estimates, estimate))

    def with_taken(self, pictures: Pictures) -> Self:
        """Return the state with more pictures for the model."""
        taken = pictures if self.taken is None else joined([self.taken, pictures], axis=0)
        return replace(self, taken=taken)

    def with_others(self, pictures: CellPictures) -> Self:
        """Return the state with more pictures for the residual alone."""
        others = pictures if self.others is None else joined([self.others, pictures], axis=0)
        return replace(self, others=others)


def hierarchy_start(state: AdaptiveState) -> Any:
    """Return the state of the hierarchy before the floodlit image."""
    method = get_method(state.hierarchy)
    assert isinstance(method, Method)
    significance = state.options.noise_significance
    options = options_of(method, tolerance=state.tolerance, noise_significance=significance)
    return method.start(state.camera, state.projector, state.channels, options)


def _picture_arrays(pictures: Pictures | CellPictures, first: int) -> dict[str, NDArray[Any]]:
    return {
        "lit": pictures.lit[first:],
        "radiance": pictures.radiance[first:],
        "variance": pictures.variance[first:],
    }


def _residual_arrays(residual: Residual) -> dict[str, NDArray[Any]]:
    return {
        "pairs": residual.pairs,
        "cores": residual.cores,
        "projector_factor": residual.projector_factor,
    }


def _pictures_of(kind: Any, prefix: str, levels: Sequence[StateArrays]) -> Any:
    """Concatenate the pictures of all levels; None where there are none."""
    parts = [
        kind(**without_prefix(prefix, level.arrays))
        for level in levels
        if f"{prefix}lit" in level.arrays
    ]
    return joined(parts, axis=0) if parts else None


def _residual_of(levels: Sequence[StateArrays]) -> Residual | None:
    """Read the residual of the last level that replaced it."""
    level = latest("has_residual", levels)
    if level is None or not level.attributes["has_residual"]:
        return None
    return Residual(**without_prefix("residual_", level.arrays))


def latest(attribute: str, levels: Sequence[StateArrays]) -> StateArrays | None:
    """Return the last level that has an attribute; None where none of them has it."""
    return next((level for level in reversed(levels) if attribute in level.attributes), None)


def merged(parts: StateArrays, arrays: Mapping[str, Any], **attributes: Any) -> StateArrays:
    """Return stored parts of a state with more arrays and attributes."""
    return StateArrays({**parts.arrays, **arrays}, {**parts.attributes, **attributes})
