"""Footprint acquisition: few random patterns for any rig, up to a target error.

The model ``T = D + diag(f) L S R^T diag(g)`` (`rfpipe.methods.footprints.model`) is fitted to
rounds of random patterns. The projector pixels that each camera pixel sees are found from the same
pictures, without calibration or structured light. Where the model does not fit, the residual model
or dual photography follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from numpy.typing import NDArray

from rfpipe.array_types import Bools
from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.decisions import ASIDE
from rfpipe.methods.adaptive.rounds import Adaptive
from rfpipe.methods.adaptive.state import AdaptiveState, latest, merged
from rfpipe.methods.base import LevelImages, StateArrays
from rfpipe.methods.error_estimate import HELD_OUT
from rfpipe.methods.footprints.candidates import Candidates
from rfpipe.methods.footprints.direct_light import pixels_without_direct_light, projector_cells
from rfpipe.methods.footprints.fit import fit_model, solution_count
from rfpipe.methods.footprints.model import transport_arrays, uniform_arrays
from rfpipe.methods.footprints.patterns import view_patterns
from rfpipe.methods.footprints.pictures import radiance_unit, split_pictures
from rfpipe.methods.images import Pictures
from rfpipe.methods.residual.model import CameraCells, ProjectorCells
from rfpipe.methods.states import with_prefix, without_prefix
from rfpipe.steps import steps
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints import FootprintTransport
from rfpipe.transport.sum import SumTransport

ROUNDS = (24, 26, 36, 48, 64, 80, 110, 150)
"""Largest number of random patterns of each round, for one projector view.

Fewer than 24 patterns do not distinguish the footprints of small scenes.
"""

# Largest number of patterns on each view in each round, if there are several.
_VIEW_ROUNDS = (24, 12, 16, 24, 32, 40, 50, 60)


def patterns_in_round(number: int, views: int) -> int:
    """Return the largest number of patterns of a round, numbered from 0, for all views together."""
    if views == 1:
        return ROUNDS[number]
    # the first round also shows a floodlit pattern on each view
    return views * (_VIEW_ROUNDS[number] + (number == 0))


@dataclass(frozen=True)
class FootprintState(AdaptiveState):
    """State of a footprint acquisition.

    Attributes
    ----------
    model : dict of str to ndarray, optional
        Arrays of the `FootprintTransport` of the last fit.
    footprints : Candidates, optional
        Footprints of the channels' sum, in the unit of the fit: the start of the next search.
    """

    hierarchy = "dual"

    model: dict[str, NDArray[Any]] | None = None
    footprints: Candidates | None = None

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the arrays that the last level changed, with those of the model."""
        parts = super().to_arrays(previous)
        if self.model is not None and self.model is not previous.model:
            parts = merged(parts, with_prefix("model_", self.model), has_model=True)
        footprints = self.footprints
        if footprints is not None and footprints is not previous.footprints:
            arrays = {
                "keys": footprints.keys,
                "variance": footprints.variance,
                "weights": footprints.weights,
            }
            sizes = [footprints.camera_size, footprints.projector_size]
            parts = merged(parts, with_prefix("footprints_", arrays), footprint_sizes=sizes)
        return parts

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state from the arrays of all levels."""
        state = super().from_arrays(start, levels)
        level = latest("has_model", levels)
        if level is not None:
            state = replace(state, model=dict(without_prefix("model_", level.arrays)))
        level = latest("footprint_sizes", levels)
        if level is not None:
            sizes = level.attributes["footprint_sizes"]
            arrays = without_prefix("footprints_", level.arrays)
            state = replace(state, footprints=Candidates(*sizes, **arrays))
        return state


class Footprints(Adaptive):
    """Footprint acquisition as a `Method`, for any rig.

    Rounds of random patterns are fitted until the estimated error is at most ``target_error``. If
    the model does not fit, or more rounds do not help, dual photography follows, with a tolerance
    that the target allows. The transport that predicts the held-out pictures best is returned, with
    its estimated error.
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
        """Return rounds of the model, levels of dual photography, and rounds of its residual."""
        rounds = (("model", patterns_in_round(k, projector.views)) for k in range(len(ROUNDS)))
        return (*rounds, *self.below(projector))

    def _in_round(self, state: AdaptiveState, slot: int) -> int:
        """Return the number of patterns; 0 for a model that is known not to fit."""
        return 0 if state.unfit and not state.inner else super()._in_round(state, slot)

    def _patterns(self, state: AdaptiveState, slot: int, count: int) -> Bools:
        return view_patterns(state.projector.shape, slot, count)

    def _begun(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        after = super()._begun(state, images)
        suits = suits_random_patterns(state.projector, state.options.patterns)
        return replace(after, unfit=not (suits and after.pictures.shine()))

    def _fitted(self, state: AdaptiveState) -> AdaptiveState:
        """Fit the model, then the residual."""
        assert isinstance(state, FootprintState)
        arrays, footprints = fit_pictures(
            state.camera, state.projector, state.pictures, state.footprints
        )
        nodes, scalar = len(arrays["cores_columns"]), len(arrays["footprints_columns"])
        state = state.counted(nodes=nodes, scalar=scalar)
        fitted = replace(state, model=arrays, footprints=footprints, residual=None)
        return self._with_residual(fitted)

    def _sender(self, state: AdaptiveState, base: Transport, canvas: CameraCells) -> ProjectorCells:
        return projector_cells(_footprint_transport(state).direct(), base, canvas)

    def _model(self, state: AdaptiveState, *more: Transport) -> SumTransport:
        return SumTransport([_footprint_transport(state), *more], list(state.rows))

    def _dark(self, state: AdaptiveState) -> Bools:
        return pixels_without_direct_light(_footprint_transport(state).direct())


def suits_random_patterns(projector: RayDomain, limit: int) -> bool:
    """Return True if random patterns need fewer pictures than dual photography from the start.

    Parameters
    ----------
    projector : RayDomain
        With at least four times as many rays as the patterns of the first round.
    limit : int
        Largest number of patterns, 0 for none. Several views need a floodlit pattern and more than
        four other patterns on each view.
    """
    views = projector.views
    if views > 1 and limit and limit <= 1 + len(HELD_OUT) + 5 * views:
        return False
    return projector.size >= 4 * ROUNDS[0] * views


def fit_pictures(
    camera: RayDomain, projector: RayDomain, pictures: Pictures, previous: Candidates | None
) -> tuple[dict[str, NDArray[Any]], Candidates]:
    """Fit the model to pictures of all channels.

    Parameters
    ----------
    camera, projector : RayDomain
    pictures : Pictures
        The first is floodlit.
    previous : Candidates, optional
        Footprints of the channels' sum of the last fit.

    Returns
    -------
    arrays : dict of str to ndarray
        Of the `FootprintTransport`.
    footprints : Candidates
        Footprints of the channels' sum.
    """
    unit, views, channels = radiance_unit(pictures), projector.views, pictures.channels
    grey = split_pictures(pictures.grey() if channels > 1 else pictures, unit, views)
    single = (
        split_pictures(pictures.channel(index), unit, views)
        for index in range(channels if channels > 1 else 0)
    )
    with steps("footprints", solution_count(projector, channels, is_first=previous is None)):
        model = fit_model(camera, projector, grey, single, previous)
    return transport_arrays(model, unit), model.grey


def _footprint_transport(state: AdaptiveState) -> FootprintTransport:
    """Return the fitted transport; before any fit, one by the floodlit image."""
    arrays = state.model
    if arrays is None:
        arrays = uniform_arrays(state.pictures.floodlit, state.projector.size)
    shapes = state.camera.shape, state.projector.shape
    return FootprintTransport(*shapes, state.channels, [], arrays)
