"""Near/far acquisition: transport by range, from few pictures, with a live error estimate.

Direct light, near-range and far-range indirect light (S. K. Nayar et al., *Fast separation of
direct and global components*, SIGGRAPH 2006, for the first step) are found together from random
patterns. What that model leaves is found from all pictures together, and where light is thrown to
single places, symmetric photography comes before that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log2
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.decisions import COAXIAL
from rfpipe.methods.adaptive.rounds import BLOCK_ROUNDS, Adaptive
from rfpipe.methods.adaptive.state import AdaptiveState, latest, merged
from rfpipe.methods.base import LevelImages, StateArrays
from rfpipe.methods.near_far.fit import fit_smooth_model as fit
from rfpipe.methods.near_far.model import LightRange, light_range
from rfpipe.methods.near_far.model import SmoothModel as Smooth
from rfpipe.methods.near_far.model import near_far_transport as as_transport
from rfpipe.methods.near_far.patterns import probe_patterns
from rfpipe.methods.states import without_prefix
from rfpipe.steps import steps
from rfpipe.transport.base import Transport
from rfpipe.transport.multiscale import coarsest_scale
from rfpipe.transport.sum import SumTransport

# Probes of each round, a level: a round should cut the error, and end soon where the target is met.
ROUNDS = (6, 10, 8, 12, 16, 24, 32)
# What is left helps where the error with it is less than so much of that without.
_HELPS = 0.95


@dataclass(frozen=True)
class NearFarState(AdaptiveState):
    """State of a near/far acquisition; its model is smooth light."""

    hierarchy = "symmetric"

    model: Smooth | None = None

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return what the last level changed, the model among it."""
        parts = super().to_arrays(previous)
        if self.model is None or self.model is previous.model:
            return parts
        arrays = {"model_functions": self.model.functions, "model_cores": self.model.cores}
        return merged(parts, arrays, model_shape=list(self.model.shape))

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state."""
        state = super().from_arrays(start, levels)
        level = latest("model_shape", levels)
        if level is None:
            return state
        arrays = without_prefix("model_", level.arrays)
        return replace(state, model=Smooth(level.attributes["model_shape"], **arrays))


class NearFar(Adaptive):
    """Near/far acquisition as a `Method`.

    Rounds of random patterns are fitted until the estimate of the error, from pictures that no fit
    sees, is at most ``target_error``. Where smooth light isn't all there is, rounds of random
    blocks tell what it leaves; where light goes to single places, symmetric photography makes a
    hierarchy first, no finer than the target asks for. The held-out pictures decide what is
    returned, whenever that is asked, and how good it is.
    """

    name = "near_far"
    title = "Near/far acquisition"
    colour = "#b3263a"
    marker = "D"
    needs_coaxial_rig = True
    bytes_per_ray = 10_000
    way = COAXIAL
    trials = (0.05, 0.01, 0.003)
    State = NearFarState

    def levels(self, projector: RayDomain) -> tuple[tuple[str, int], ...]:
        """Return rounds of smooth light, of what it leaves, the hierarchy, and what that leaves."""
        model = tuple(("model", count) for count in ROUNDS)
        return (*model, *BLOCK_ROUNDS, *self.below(projector))

    def _patterns(self, state: AdaptiveState, slot: int, count: int) -> NDArray[np.bool_]:
        shape = state.projector.shape
        return probe_patterns(shape, slot, count, self._range(state) if slot > 1 else None)

    def _range(self, state: AdaptiveState) -> LightRange:
        assert state.model is not None
        return light_range(state.projector.shape, state.model, state.pictures.floodlit)

    def _begun(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        """Take the floodlit image; unknown pixels are as bright as their neighbours."""
        after = super()._begun(state, images)
        completed = after.pictures.completed(state.projector.shape)
        return replace(after, taken=completed)

    def _fitted(self, state: AdaptiveState) -> AdaptiveState:
        """Fit smooth light; from the second round on, find what it leaves."""
        shape = state.projector.shape
        # a solution a scale, two of all, one of each channel
        with steps("smooth light", round(log2(coarsest_scale(shape))) + 2 + state.channels):
            model = fit(shape, state.pictures)
        state = state.counted(nodes=len(model.basis.first))
        state = replace(state, model=model, residual=None)
        if state.slot <= 1:
            return state
        # where that helps, rounds of blocks follow
        after = self._with_residual(state)
        helps = self._best(after)[0].error < _HELPS * self._best(state)[0].error
        return after if helps else state

    def _dark(self, state: AdaptiveState) -> NDArray[np.bool_]:
        assert state.held is not None
        return np.asarray(~state.held.lit)

    def _model(self, state: AdaptiveState, *more: Transport) -> SumTransport:
        """Return smooth light and more parts; the rest is direct light."""
        rows = list(state.rows)
        return as_transport(state.projector.shape, rows, state.model, state.pictures, more)

    def _instead(self, state: AdaptiveState, *parts: Transport) -> SumTransport:
        """Return the hierarchy and what it leaves; the rest is direct light."""
        rows = list(state.rows)
        return as_transport(state.projector.shape, rows, None, state.pictures, parts)
