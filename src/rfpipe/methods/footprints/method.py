"""Footprint acquisition: few random patterns for any rig, up to a target error.

The model ``T = D + diag(f) L S R^T diag(g)`` (`rfpipe.methods.footprints.model`) is fitted to
rounds of random patterns. The projector pixels that each camera pixel sees are found from the same
pictures, without calibration or structured light. Where the model does not fit, multiplexed dual
photography follows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Self

from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float
from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.decisions import (
    NOT_SUITABLE,
    Decision,
    after_round_before_hierarchy,
)
from rfpipe.methods.adaptive.loop import AdaptiveMethod
from rfpipe.methods.adaptive.rounds import Rounds, hierarchy_rounds
from rfpipe.methods.adaptive.state import AdaptiveState, Phase, latest, merged
from rfpipe.methods.base import StateArrays
from rfpipe.methods.footprints.candidates import StoredCandidates
from rfpipe.methods.footprints.direct_light import pixels_without_direct_light, projector_cells
from rfpipe.methods.footprints.fit import fit_model, solution_count
from rfpipe.methods.footprints.model import transport_arrays, uniform_arrays
from rfpipe.methods.footprints.patterns import view_patterns
from rfpipe.methods.footprints.pictures import (
    PackedPictures,
    radiance_unit,
    split_pictures,
)
from rfpipe.methods.held_out import HELD_OUT
from rfpipe.methods.images import Pictures
from rfpipe.methods.residual.model import CameraCells, ProjectorCells
from rfpipe.methods.states import with_prefix, without_prefix
from rfpipe.steps import steps
from rfpipe.store.scratch import ScratchArray
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints import FootprintTransport
from rfpipe.transport.lazy import LazyArrays
from rfpipe.transport.sum import SumTransport, terms_of

ROUNDS = (24, 26, 36, 48, 64, 80, 110, 150)
"""Largest number of random patterns of each round, for one projector view.

Fewer than 24 patterns do not distinguish the footprints of small scenes.
"""

# Largest number of patterns on each view in each round, if there are several.
_VIEW_ROUNDS = (24, 12, 16, 24, 32, 40, 50, 60)

WRONG_MODEL = 0.07
"""Estimated error of the first round above which multiplexed dual photography follows. The first
round leaves 3 to 5 % on diffuse scenes, 8 to 11 % on caustics."""


def patterns_in_round(number: int, views: int) -> int:
    """Return the largest number of patterns of a round, numbered from 0, for all views together."""
    if views == 1:
        return ROUNDS[number]
    # the first round also shows a floodlit pattern on each view
    return views * (_VIEW_ROUNDS[number] + (number == 0))


def suits_random_patterns(projector: RayDomain, limit: int) -> bool:
    """Test whether the model can be fitted to the random patterns of the first round.

    Otherwise none are shown: multiplexed dual photography follows, or the acquisition ends if it
    has a limit.
    The projector must have at least 96 rays per view, four times as many as the first round has
    patterns. With several views, `limit` must leave a floodlit pattern and more than four random
    ones for each view, besides the floodlit and the held-out pictures.

    Parameters
    ----------
    projector : RayDomain
    limit : int
        Largest number of patterns of the acquisition, 0 for no limit.
    """
    views = projector.views
    if views > 1 and limit and limit <= 1 + len(HELD_OUT) + 5 * views:
        return False
    return projector.size >= 4 * ROUNDS[0] * views


def fit_pictures(
    camera: RayDomain,
    projector: RayDomain,
    pictures: Sequence[PackedPictures],
    unit: float,
    previous: StoredCandidates | None,
) -> tuple[dict[str, NDArray[Any]], StoredCandidates]:
    """Fit the model to pictures of all channels.

    Parameters
    ----------
    camera, projector : RayDomain
    pictures : sequence of PackedPictures
        The first picture is floodlit.
    unit : float
        Unit of their radiance.
    previous : StoredCandidates, optional
        Footprints of the channels' sum of the last fit.

    Returns
    -------
    arrays : dict of str to ndarray
        Of the `FootprintTransport`.
    footprints : StoredCandidates
        Footprints of the channels' sum.
    """
    channels = pictures[0].channels
    grey = split_pictures(pictures, slice(None), projector)
    single_channels = (
        split_pictures(pictures, slice(index, index + 1), projector)
        for index in range(channels if channels > 1 else 0)
    )
    with steps("footprints", solution_count(projector, channels, is_first=previous is None)):
        fitted = fit_model(camera, projector, grey, single_channels, previous)
    return transport_arrays(fitted, unit), fitted.grey


@dataclass(frozen=True)
class FootprintModel:
    """The footprint model in the adaptive loop.

    Attributes
    ----------
    camera, projector : RayDomain
    floodlit : ndarray of float32, shape (C, M)
        The floodlit image.
    unit : float
        Unit of radiance in the fit.
    is_suitable : bool
        False for dark scenes and small projectors.
    arrays : mapping of str to ndarray, optional
        The arrays of the fitted `FootprintTransport`; None before the first fit.
    footprints : StoredCandidates, optional
        Footprints of the channels' sum, in the unit of the fit: the start of the next search.
    prior : Transport, optional
        The transport before the first fit.
    """

    camera: RayDomain
    projector: RayDomain
    floodlit: Float
    unit: float
    is_suitable: bool
    arrays: Mapping[str, NDArray[Any]] | None = None
    footprints: StoredCandidates | None = None
    prior: Transport | None = None

    @classmethod
    def of(
        cls,
        floodlit: Pictures,
        camera: RayDomain,
        projector: RayDomain,
        limit: int,
        prior: Transport | None,
    ) -> Self:
        """Make the model of a floodlit picture.

        `limit` is the largest number of patterns of the acquisition, 0 for no limit.
        """
        is_suitable = suits_random_patterns(projector, limit) and floodlit.has_light()
        unit = radiance_unit(floodlit)
        return cls(camera, projector, floodlit.floodlit, unit, is_suitable, prior=prior)

    @property
    def counts(self) -> Mapping[str, int]:
        """Columns of the round's row in the table of levels, see `Transport.level_rows`.

        ``nodes`` is the number of cores (entries of S), ``scalar`` the number of entries of D.
        """
        if self.arrays is None:
            return {}
        nodes, scalar = self.arrays["cores_columns"], self.arrays["footprints_columns"]
        return {"nodes": len(nodes), "scalar": len(scalar)}

    @property
    def prior_terms(self) -> tuple[Transport, ...]:
        """Terms of the prior, which the first fit replaces."""
        return terms_of(self.prior) if self.prior is not None and self.arrays is None else ()

    def next_patterns(self, key: int, count: int) -> Bools:
        """Draw random patterns of three kinds of detail, see `view_patterns`."""
        return view_patterns(self.projector.shape, key, count)

    def prepared(self, pictures: Pictures) -> PackedPictures:
        """Pack pictures."""
        return PackedPictures.of(pictures, self.unit)

    def taken(self, prepared: PackedPictures, lit: Bools) -> Pictures:
        """Unpack pictures."""
        return prepared.unpacked(lit, self.unit)

    def fit(self, pictures: Sequence[PackedPictures]) -> Self:
        """Fit footprints and indirect light to all pictures."""
        arrays, footprints = fit_pictures(
            self.camera, self.projector, pictures, self.unit, self.footprints
        )
        return replace(self, arrays=arrays, footprints=footprints)

    def transport(
        self,
        rows: list[dict[str, Any]],
        residual: Sequence[Transport] = (),
    ) -> SumTransport:
        """Assemble footprints with indirect light, and the residual."""
        base = self.prior_terms or [self.fitted_transport()]
        return SumTransport([*base, *residual], rows)

    def dark_pixels(self, lit: Bools) -> Bools:
        """Find the camera pixels with at most 2 % of their direct light."""
        return pixels_without_direct_light(self.fitted_transport().direct(), lit)

    def projector_cells(self, camera: CameraCells, base: Transport) -> ProjectorCells:
        """Find the places that the projector's residual cells light in the camera's image."""
        return projector_cells(self.fitted_transport().direct(), base, camera)

    def fitted_transport(self) -> FootprintTransport:
        """Return the fit; before it, the prior's fit, or the floodlit image spread evenly."""
        fits = [term for term in self.prior_terms if isinstance(term, FootprintTransport)]
        if fits:
            return fits[0]
        arrays = self.arrays
        if arrays is None:
            arrays = uniform_arrays(self.floodlit, self.projector.size)
        shapes = self.camera.shape, self.projector.shape
        return FootprintTransport(*shapes, len(self.floodlit), [], arrays)


_FOOTPRINT_ARRAYS = ("starts", "projector_pixels", "variance", "weights")


@dataclass(frozen=True)
class FootprintState(AdaptiveState):
    """State of a footprint acquisition."""

    pictures_type = PackedPictures

    model: FootprintModel | None = None

    def with_pictures(self, parts: Iterable[PackedPictures]) -> Self:
        """Add pictures of a round, in temporary files."""
        return super().with_pictures([PackedPictures.stored(parts)])

    @classmethod
    def restored_pictures(cls, arrays: Mapping[str, NDArray[Any]]) -> PackedPictures:
        """Restore the pictures of a round, in temporary files."""
        return PackedPictures.stored([PackedPictures(**arrays)])

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the parts that the last level changed, the model among them."""
        parts, model = super().to_arrays(previous), self.model
        if model is None or model.arrays is None or model is previous.model:
            return parts
        footprints = model.footprints
        assert footprints is not None
        arrays = {name: getattr(footprints, name) for name in _FOOTPRINT_ARRAYS}
        sizes = [footprints.camera_size, footprints.projector_size]
        parts = merged(parts, with_prefix("model_", model.arrays))
        return merged(parts, with_prefix("footprints_", arrays), footprint_sizes=sizes)

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state."""
        state = super().from_arrays(start, levels)
        if state.floodlit is None:
            return state
        model = _first_model(state, state.floodlit)
        level = latest("footprint_sizes", levels)
        if level is not None:
            camera_size, projector_size = level.attributes["footprint_sizes"]
            stored = without_prefix("footprints_", level.arrays)
            arrays = {name: ScratchArray.of(stored[name]) for name in _FOOTPRINT_ARRAYS}
            footprints = StoredCandidates(camera_size, projector_size, **arrays)
            fitted = without_prefix("model_", level.arrays)
            fitted = LazyArrays(list(fitted), cache(fitted.__getitem__))
            model = replace(model, arrays=fitted, footprints=footprints)
        return replace(state, model=model)


class Footprints(AdaptiveMethod):
    """Footprint acquisition, for any rig.

    It ends at ``target_error``, by the estimate from held-out pictures, and returns the transport
    that predicts these best. `Method` and `AdaptiveMethod` describe the class attributes.
    """

    name = "footprints"
    title = "Footprint acquisition"
    colour = "#6a3d9a"
    marker = "p"
    bytes_per_ray = 100_000
    trials = (0.05, 0.01, 0.005)
    State = FootprintState
    residual_is_optional = False

    def rounds(self, projector: RayDomain) -> Rounds:
        """Return the rounds of all phases; the model's residual is fitted to its own rounds."""
        views = projector.views
        counts = tuple(patterns_in_round(number, views) for number in range(len(ROUNDS)))
        return {Phase.MODEL: counts, **hierarchy_rounds(projector)}

    def first_model(self, state: AdaptiveState, floodlit: Pictures) -> FootprintModel:
        """Make the model of the floodlit picture alone."""
        return _first_model(state, floodlit)

    def decide(self, state: AdaptiveState, phase: Phase, is_last: bool) -> Decision:
        """Decide after a round of the model whose error is above the target."""
        assert state.model is not None
        is_wrong = len(state.errors) == 1 and state.errors[0] > WRONG_MODEL
        if state.allows_hierarchy and (is_wrong or not state.model.is_suitable):
            return Decision(Phase.HIERARCHY, NOT_SUITABLE)
        if not state.model.is_suitable:
            return Decision(None, NOT_SUITABLE)
        return after_round_before_hierarchy(state, phase, is_last=is_last)


def _first_model(state: AdaptiveState, floodlit: Pictures) -> FootprintModel:
    limit, prior = state.options.patterns, state.accepted_prior
    return FootprintModel.of(floodlit, state.camera, state.projector, limit, prior)
