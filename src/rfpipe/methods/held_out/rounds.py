"""Acquisitions in rounds that end when held-out pictures are predicted well enough."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, astuple, dataclass, fields, replace
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import ErrorOptions, Float, Pack
from rfpipe.methods.held_out.estimate import Estimate, Held
from rfpipe.methods.held_out.patterns import (
    HELD_OUT,
    held_out_shapes,
    held_out_spots,
    held_out_strip,
)
from rfpipe.methods.states import MethodState, PackingMethod, appended, arrays_of
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport

__all__ = ["HeldOutMethod", "HeldOutState", "due", "gathered", "latest"]

_HELD = "held_"


@dataclass(frozen=True)
class HeldOutState(MethodState):
    """The state of an acquisition in rounds, beside what all states have.

    Attributes
    ----------
    new, new_held : int
        How many pictures for fits, and of `held`, the last level brought.
    held : Held, optional
        Pictures that no fit sees; None before the first round.
    estimates : tuple of Estimate
        After each level that had images, of what is returned from then on.
    """

    options: ErrorOptions
    _: KW_ONLY
    new: int = 0
    new_held: int = 0
    held: Held | None = None
    estimates: tuple[Estimate, ...] = ()

    @property
    def shown(self) -> int:
        """Patterns shown so far."""
        return sum(row["patterns"] for row in self.rows)

    def asked(
        self, count: int, nearness: Callable[[], Float]
    ) -> tuple[list[NDArray[np.bool_]], int]:
        """Return a round's held-out patterns, each as often as it is shown, and how many others.

        Parameters
        ----------
        count : int
            Others without a limit of patterns; where held-out ones are all that is left, 0.
        nearness : callable
            Tells how much light stays near, as `due` takes it.
        """
        held = due(self.projector.shape, self.held, nearness)
        if not self.options.patterns:
            return held, count
        room = self.options.patterns - self.shown
        if room >= len(held) + min(count, 1):
            return held, min(count, room - len(held))
        # without any held-out pictures a round would say nothing of the error
        return [], min(count, max(room, 0)) if self.held else 0

    def round(self, held: Sequence[NDArray[np.bool_]], others: NDArray[Any]) -> Schedule:
        """Return a round's patterns, the held-out ones first."""
        shape = self.projector.shape
        weights = np.concatenate([np.reshape(held, (len(held), *shape)), others])
        return Schedule(self.level, shape, len(weights), weights=weights.astype(np.float32))

    def with_held(self, lit: NDArray[np.bool_], radiance: Float) -> Self:
        """Return a state that has more held-out pictures."""
        return replace(self, held=appended(self.held, Held(lit, radiance)), new_held=len(lit))

    def best(
        self, candidates: Iterator[Transport], estimate: Callable[[Transport], Estimate]
    ) -> tuple[Transport, Estimate]:
        """Return what predicts the held-out pictures best, and how well."""
        if self.held is None:
            return next(candidates), Estimate(1.0, 1.0, 1.0, 1.0, 1.0)
        estimated = [(each, estimate(each)) for each in candidates]
        return min(estimated, key=lambda pair: pair[1].error)

    def judged(self, found: Estimate) -> Self:
        """Return the state after the last level's estimate of the error."""
        row = {**self.rows[-1], "estimated_error": found.error}
        return replace(self, rows=(*self.rows[:-1], row), estimates=(*self.estimates, found))

    def leaves(self, share: float) -> bool:
        """Tell whether the last round left more than this share of the error before it."""
        # by other held-out pictures, errors don't compare
        if self.new_held or len(self.estimates) < 3:
            return False
        before, found = self.estimates[-2:]
        return bool(found.error > share * before.error)


H = TypeVar("H", bound=HeldOutState)
S = TypeVar("S", bound=Any)


class HeldOutMethod(PackingMethod[H]):
    """A method in rounds, told the error to end at.

    Attributes
    ----------
    most : int
        Patterns of all rounds.
    """

    estimates_error = True
    Options = ErrorOptions
    trades = "target_error"
    most: ClassVar[int]

    def expected_patterns(
        self, camera: RayDomain, projector: RayDomain, options: ErrorOptions
    ) -> int:
        """Return the patterns of all rounds: they don't grow with the resolution."""
        return min(projector.size, options.patterns or self.most)

    def pack(self, state: H) -> Pack:
        """Return the last level's held-out pictures, and all estimates."""
        own = super().pack(state)
        held = latest(state.held, state.new_held, _HELD) if state.new_held else {}
        estimates = [list(astuple(each)) for each in state.estimates]
        return own | Pack(held, {"estimates": estimates})

    def _restored(self, start: H, packs: Sequence[Pack]) -> H:
        return replace(
            super()._restored(start, packs),
            held=gathered(Held, packs, _HELD),
            estimates=tuple(Estimate(*found) for found in packs[-1].attributes["estimates"]),
        )


def due(
    shape: tuple[int, ...], held: Held | None, nearness: Callable[[], Float]
) -> list[NDArray[np.bool_]]:
    """Return the held-out patterns that are due, each as often as it is shown.

    Shapes at first, then the strip and spots, for which `nearness` tells how much light stays near.
    """
    shown = []
    if held is None:
        shown = [held_out_shapes(shape)]
    elif len(held.lit) == HELD_OUT:
        shown = [held_out_strip(nearness()), held_out_spots(shape)]
    return [each for each in shown for _ in range(HELD_OUT)]


def latest(pictures: Any, count: int, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Return the arrays of the last pictures by name, as `gathered` takes them."""
    return {name: array[-count:] for name, array in arrays_of(pictures, prefix).items()}


def gathered(kind: type[S], packs: Sequence[Pack], prefix: str = "", **alike: Any) -> S | None:
    """Put together the pictures that each pack has, by the names of `latest`; None without any.

    `alike` are fields of all pictures alike, which not all packs have.
    """
    own = [pack.arrays for pack in packs if f"{prefix}lit" in pack.arrays]
    if not own:
        return None
    names = {each.name for each in fields(kind)} - set(alike)
    found = {name: np.concatenate([each[f"{prefix}{name}"] for each in own]) for name in names}
    pictures: S = kind(**{**found, "lit": found["lit"].astype(np.bool_)}, **alike)
    return pictures
