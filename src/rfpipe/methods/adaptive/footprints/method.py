"""Footprint acquisition: near/far acquisition for rigs that aren't coaxial.

Direct light and indirect light are found together from random patterns, as in near/far acquisition.
Here nothing says which projector pixels a camera pixel sees: that is found from the same pictures,
with no structured light. Where the model doesn't fit, dual photography follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log2
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.decisions import ASIDE
from rfpipe.methods.adaptive.rounds import Adaptive
from rfpipe.methods.adaptive.state import AdaptiveState, latest, merged
from rfpipe.methods.base import LevelImages, StateArrays
from rfpipe.methods.error_estimate import HELD_OUT, held_out_patterns
from rfpipe.methods.footprints.candidates import Candidates
from rfpipe.methods.footprints.fit import fit_model
from rfpipe.methods.footprints.model import transport_arrays
from rfpipe.methods.footprints.patterns import view_patterns
from rfpipe.methods.footprints.pictures import radiance_unit, split_pictures
from rfpipe.methods.images import nearest, relight_white
from rfpipe.methods.residual.model import CameraCells, ProjectorCells, residual_cells, root_factor
from rfpipe.methods.states import with_prefix, without_prefix
from rfpipe.steps import steps
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints import FootprintTransport, sparse_arrays
from rfpipe.transport.multiscale import coarsest_scale
from rfpipe.transport.sum import SumTransport

# Random patterns of each round, a level. The first has to be enough to find footprints. Of several
# views, which are lit one at a time, each has as many as the second tuple tells.
ROUNDS = (24, 26, 36, 48, 64, 80, 110, 150)
_VIEW_ROUNDS = (24, 12, 16, 24, 32, 40, 50, 60)


def in_round(number: int, views: int) -> int:
    """Return the patterns of a round, numbered from 0, of a projector of so many views."""
    if views == 1:
        return ROUNDS[number]
    # each view is lit whole at first
    return views * (_VIEW_ROUNDS[number] + (number == 0))


@dataclass(frozen=True)
class FootprintState(AdaptiveState):
    """The state of a footprint acquisition.

    Attributes
    ----------
    model : dict of str to ndarray, optional
        The arrays of the `FootprintTransport` of the last fit.
    found : Candidates, optional
        With what the next search begins, in the unit of the fits.
    """

    hierarchy = "dual"

    model: dict[str, NDArray[Any]] | None = None
    found: Candidates | None = None

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return what the last level changed, the model and the candidates among it."""
        parts = super().to_arrays(previous)
        if self.model is not None and self.model is not previous.model:
            parts = merged(parts, with_prefix("model_", self.model), has_model=True)
        if self.found is not None and self.found is not previous.found:
            names = ("keys", "variance", "weights")
            arrays = {name: getattr(self.found, name) for name in names}
            sizes = [self.found.camera_size, self.found.projector_size]
            parts = merged(parts, with_prefix("found_", arrays), candidates=sizes)
        return parts

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state."""
        state = super().from_arrays(start, levels)
        level = latest("has_model", levels)
        if level is not None:
            state = replace(state, model=dict(without_prefix("model_", level.arrays)))
        level = latest("candidates", levels)
        if level is not None:
            sizes = level.attributes["candidates"]
            arrays = without_prefix("found_", level.arrays)
            state = replace(state, found=Candidates(*sizes, **arrays))
        return state


class Footprints(Adaptive):
    """Footprint acquisition as a `Method`, for any rig.

    Rounds of random patterns are fitted until the estimate of the error, from pictures that no fit
    sees, is at most ``target_error``. Where the model doesn't fit, or more rounds don't help, dual
    photography follows, no finer than the target asks for. The held-out pictures decide what is
    returned, whenever that is asked, and how good it is.
    """

    name = "footprints"
    title = "Footprint acquisition"
    colour = "#6a3d9a"
    marker = "p"
    bytes_per_ray = 100_000
    way = ASIDE
    trials = (0.05, 0.01, 0.005)
    State = FootprintState

    def levels(self, projector: RayDomain) -> tuple[tuple[str, int], ...]:
        """Return rounds, then the levels of dual photography, and of what that leaves."""
        rounds = (("model", in_round(k, projector.views)) for k in range(len(ROUNDS)))
        return (*rounds, *self.below(projector))

    def _in_round(self, state: AdaptiveState, slot: int) -> int:
        """Return the patterns of a round; none where held-out ones are all that is left."""
        return 0 if state.unfit and not state.inner else super()._in_round(state, slot)

    def _patterns(self, state: AdaptiveState, slot: int, count: int) -> NDArray[np.bool_]:
        return view_patterns(state.projector.shape, slot, count)

    def _begun(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        after = super()._begun(state, images)
        return replace(after, unfit=not after.pictures.shine() or not self._fits(state))

    def _fits(self, state: AdaptiveState) -> bool:
        """Tell whether a rig is large enough for random patterns to pay."""
        rays, views = state.projector.size, state.projector.views
        limit = state.options.patterns
        # the whole view, and four patterns of each
        if views > 1 and limit and limit <= 1 + len(HELD_OUT) + 5 * views:
            return False
        # smaller projectors are lit block by block at once
        return rays >= 4 * ROUNDS[0] * views

    def _fitted(self, state: AdaptiveState) -> AdaptiveState:
        """Fit the model, and find what it leaves."""
        assert isinstance(state, FootprintState)
        pictures, views = state.pictures, state.projector.views
        unit, channels = radiance_unit(pictures), state.channels
        grey = split_pictures(pictures.grey() if channels > 1 else pictures, unit, views)
        indices = range(channels if channels > 1 else 0)
        parts = (split_pictures(pictures.channel(index), unit, views) for index in indices)
        # two solutions a scale, twice where nothing is known; then one or two of each channel
        scales = round(log2(coarsest_scale(state.projector.image_shape)))
        solutions = (2 if state.found is None else 1) * (3 + 2 * scales)
        with steps("footprints", solutions + (1 + len(indices)) * min(views, 2)):
            model = fit_model(state.camera, state.projector, grey, parts, state.found)
        arrays = transport_arrays(model, unit)
        nodes, scalar = len(arrays["cores_columns"]), len(arrays["footprints_columns"])
        state = state.counted(nodes=nodes, scalar=scalar)
        return self._with_residual(replace(state, model=arrays, found=model.grey, residual=None))

    def _sender(self, state: AdaptiveState, base: Transport, canvas: CameraCells) -> ProjectorCells:
        """Return the projector's cells, what they send, and where the camera sees them lit."""
        channels, camera = range(state.channels), state.camera
        _, row, column = np.indices(camera.stack_shape).reshape(3, -1)
        light = np.stack([np.ones_like(row), row, column]).astype(np.float32)
        planar = np.repeat(light[:, None], state.channels, axis=1)
        cells, side = residual_cells(state.projector.shape), canvas.cells.side
        lit, *moments = cells.total(
            _model_of(state).direct().adjoint(planar, channels).sum(axis=1)
        ).T.astype(np.float64)
        seen = lit > 0
        places = np.stack(moments) / np.where(seen, lit, 1) / side
        if seen.any() and not seen.all():
            places = places[:, nearest(seen.reshape(cells.stack))]
        white = np.maximum(base.adjoint(planar[:1], channels)[0], 0)
        return ProjectorCells(cells, root_factor(white), places.T.astype(np.float32))

    def _model(self, state: AdaptiveState, *more: Transport) -> SumTransport:
        """Return footprints, smooth light between them, and more parts."""
        return SumTransport([_model_of(state), *more], list(state.rows))

    def _dark(self, state: AdaptiveState) -> NDArray[np.bool_]:
        """Return the camera pixels with at most a 50th of their direct light."""
        lit = held_out_patterns(state.projector.shape).reshape(len(HELD_OUT), -1)
        shown = np.concatenate([np.ones_like(lit[:1]), lit])
        full, *direct = relight_white(_model_of(state).direct(), shown).sum(axis=1)
        return ~np.asarray(np.stack(direct) > 0.02 * full)


def _model_of(state: AdaptiveState) -> FootprintTransport:
    """Return the model, or, before there is one, what the floodlit image says."""
    arrays = state.model
    if arrays is None:
        from scipy.sparse import csr_array

        channels, pixels, rays = state.channels, state.camera.size, state.projector.size
        nothing: Any = csr_array((pixels, rays), dtype=np.float32)
        one = np.ones((1, 1), np.float32)
        arrays = {
            **sparse_arrays("footprints", nothing, [nothing.data] * channels),
            **sparse_arrays("left", csr_array(np.ones((pixels, 1), np.float32))),
            **sparse_arrays("right", csr_array(np.ones((rays, 1), np.float32))),
            **sparse_arrays("cores", csr_array(one), [np.full(1, 1 / rays, np.float32)] * channels),
            "camera_factor": np.maximum(state.pictures.floodlit, 0),
            "projector_factor": np.ones((channels, rays), np.float32),
        }
    shapes = state.camera.shape, state.projector.shape
    return FootprintTransport(*shapes, state.channels, [], arrays)
