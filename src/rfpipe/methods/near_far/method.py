"""Near/far acquisition: transport by range on coaxial rigs, from few pictures.

Direct light, near-range and far-range indirect light are fitted together to pictures of random
patterns (`rfpipe.methods.near_far.model`). The residual of this model is fitted to pictures of
random blocks. Light that goes to single places, as by mirrors and glass, is left to
multiplexed dual photography.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import log2
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools
from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.decisions import (
    NOT_SUITABLE,
    Decision,
    after_round_before_hierarchy,
    has_stalled,
    is_mostly_noise,
)
from rfpipe.methods.adaptive.loop import AdaptiveMethod
from rfpipe.methods.adaptive.rounds import RESIDUAL_ROUNDS, Rounds, hierarchy_rounds
from rfpipe.methods.adaptive.state import AdaptiveState, Phase, latest, merged
from rfpipe.methods.base import LIBRARY_BYTES, Forecast, StateArrays
from rfpipe.methods.images import Pictures
from rfpipe.methods.near_far.fit import fit_smooth_model
from rfpipe.methods.near_far.model import SmoothModel, light_range, near_far_transport
from rfpipe.methods.near_far.patterns import probe_patterns
from rfpipe.methods.near_far.pictures import MOST_PIXELS, SplitPictures, fit_cells
from rfpipe.methods.near_far.prior import denoised_floodlit, without_indirect_light
from rfpipe.methods.residual.model import CameraCells, ProjectorCells, coaxial_projector
from rfpipe.methods.states import joined, without_prefix
from rfpipe.steps import steps
from rfpipe.transport.base import Transport
from rfpipe.transport.multiscale import coarsest_scale
from rfpipe.transport.sum import SumTransport, terms_of

ROUNDS = (6, 10, 8, 12, 16, 24, 32)
"""Largest number of patterns of each round of the model. Many scenes need only the first two."""

WRONG_MODEL = 0.1
"""Estimated error of the first round above which multiplexed dual photography follows. The first
round leaves 2 to 8 % on diffuse and glossy scenes, 10 to 20 % with mirrors or glass."""

# Memory of a pixel and channel outside the fit: floodlit and held-out pictures, and relit ones.
_IMAGE_VALUE_BYTES = 150

_NOISE = "the remaining error is noise of the floodlit image"


@dataclass(frozen=True)
class NearFarModel:
    """The near/far model in the adaptive loop.

    Attributes
    ----------
    floodlit : Pictures
        The floodlit picture alone.
    shape : tuple of int
        The ray domain.
    smooth : SmoothModel, optional
        Indirect light in addition to the prior's; None before the first fit, when it is 0.
    prior : Transport, optional
        Transport whose indirect light is part of the model.
    """

    floodlit: Pictures
    shape: tuple[int, ...]
    smooth: SmoothModel | None = None
    prior: Transport | None = None

    @classmethod
    def of(
        cls,
        floodlit: Pictures,
        shape: tuple[int, ...],
        prior: Transport | None,
        smooth: SmoothModel | None = None,
    ) -> Self:
        """Make the model of a floodlit picture, which a prior makes less noisy."""
        if prior is not None:
            floodlit = denoised_floodlit(floodlit, prior)
        return cls(floodlit, shape, smooth, prior)

    @property
    def counts(self) -> Mapping[str, int]:
        """Columns of the round's row in the table of levels: ``nodes`` is the number of cores."""
        return {} if self.smooth is None else {"nodes": len(self.smooth.basis.first)}

    @property
    def is_suitable(self) -> bool:
        """True: the first fit decides."""
        return True

    def next_patterns(self, key: int, count: int) -> NDArray[np.bool_]:
        """Draw octave noise; after a fit, with bands of equal range of the indirect light."""
        if self.smooth is None or self.prior is not None:
            return probe_patterns(self.shape, key, count)
        origin = light_range(self.shape, self.smooth, self.floodlit.floodlit)
        return probe_patterns(self.shape, key, count, origin)

    def prepared(self, pictures: Pictures) -> SplitPictures:
        """Sum up the lit and the dark pixels of cells, without the prior's indirect light."""
        if self.prior is not None:
            pictures = without_indirect_light(pictures, self.prior)
        return SplitPictures.of(fit_cells(self.shape), self.floodlit, pictures)

    def taken(self, prepared: SplitPictures, lit: Bools) -> Pictures | None:
        """Add lit and dark pixels up again, where each cell is a single pixel."""
        if self.prior is not None or fit_cells(self.shape).side > 1:
            return None
        return prepared.of_pixels(self.floodlit, lit)

    def fit(self, pictures: Sequence[SplitPictures]) -> Self:
        """Fit the indirect light to all pictures."""
        # one solution for each scale, two for the sum of the channels, one for each of several
        probes = joined(pictures, axis=0).probes
        single_channels = probes.channels if probes.channels > 1 else 0
        solutions = round(log2(coarsest_scale(self.shape))) + 2 + single_channels
        with steps("smooth light", solutions):
            smooth = fit_smooth_model(fit_cells(self.shape), self.floodlit, probes)
            return replace(self, smooth=smooth)

    def transport(
        self,
        rows: list[dict[str, Any]],
        residual: Sequence[Transport] = (),
    ) -> SumTransport:
        """Assemble indirect light, and the remainder of the floodlit image as direct light."""
        terms = () if self.prior is None else terms_of(self.prior)
        parts = [*terms, *residual]
        return near_far_transport(self.shape, rows, self.smooth, self.floodlit, parts)

    def dark_pixels(self, lit: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the pixels that a pattern leaves dark: camera and projector share their rays."""
        return ~lit

    def projector_cells(self, camera: CameraCells, base: Transport) -> ProjectorCells:
        """Return the camera's cells."""
        return coaxial_projector(camera)


@dataclass(frozen=True)
class NearFarState(AdaptiveState):
    """State of a near/far acquisition."""

    pictures_type = SplitPictures

    model: NearFarModel | None = None

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the parts that the last level changed, the model among them."""
        parts = super().to_arrays(previous)
        if self.model is None or self.model.smooth is None or self.model is previous.model:
            return parts
        smooth = self.model.smooth
        return merged(
            parts,
            {"model_functions": smooth.functions, "model_cores": smooth.cores},
            has_model=True,
        )

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state."""
        state = super().from_arrays(start, levels)
        if state.floodlit is None:
            return state
        smooth, level = None, latest("has_model", levels)
        if level is not None:
            arrays = without_prefix("model_", level.arrays)
            smooth = SmoothModel(fit_cells(state.projector.shape), **arrays)
        shape, prior = state.projector.shape, state.accepted_prior
        return replace(state, model=NearFarModel.of(state.floodlit, shape, prior, smooth))


class NearFar(AdaptiveMethod):
    """Near/far acquisition, for coaxial rigs.

    It ends at ``target_error``, by the estimate from held-out pictures, and returns the transport
    that predicts these best.
    """

    name = "near_far"
    title = "Near/far acquisition"
    colour = "#b3263a"
    marker = "D"
    needs_coaxial_rig = True
    bytes_per_ray: int = 10_000
    trials = (0.05, 0.01, 0.003)
    State = NearFarState
    residual_is_optional = True

    def rounds(self, projector: RayDomain) -> Rounds:
        """Return the rounds of all phases."""
        return {
            Phase.MODEL: ROUNDS,
            Phase.RESIDUAL: RESIDUAL_ROUNDS,
            **hierarchy_rounds(projector),
        }

    def forecast_of(
        self, camera: RayDomain, channels: int, patterns: int, max_patterns: int
    ) -> Forecast:
        """Forecast an acquisition of known numbers of patterns; a fit is of a limited size."""
        fit_bytes = self.bytes_per_ray * min(camera.size, MOST_PIXELS)
        image_bytes = _IMAGE_VALUE_BYTES * channels * camera.size
        return Forecast(patterns, max_patterns, LIBRARY_BYTES + fit_bytes + image_bytes)

    def first_model(self, state: AdaptiveState, floodlit: Pictures) -> NearFarModel:
        """Make the model whose indirect light is the prior's, or 0."""
        return NearFarModel.of(floodlit, state.projector.shape, state.accepted_prior)

    def prepared_floodlit(self, state: AdaptiveState, picture: Pictures) -> Pictures:
        """Give masked pixels the radiance of the nearest known pixel: they light others, too."""
        return picture.with_masked_filled(state.projector.shape)

    def decide(self, state: AdaptiveState, phase: Phase, is_last: bool) -> Decision:
        """Decide after a round, by its phase."""
        if phase is Phase.MODEL:
            return _after_model_round(state, is_last)
        return _after_residual_round(state, is_last)


def _after_model_round(state: AdaptiveState, is_last: bool) -> Decision:
    """Decide after a round of the model whose error is above the target."""
    is_exhausted = is_last or has_stalled(state)
    if is_exhausted and is_mostly_noise(state):
        return Decision(None, _NOISE)
    if len(state.errors) == 1 and state.errors[0] > WRONG_MODEL and state.allows_hierarchy:
        return Decision(Phase.HIERARCHY, NOT_SUITABLE)
    # the residual reduces the error; blocks determine more of it than the model's patterns do
    if is_exhausted or state.residual is not None:
        return Decision(Phase.RESIDUAL, "smooth light doesn't explain the pictures")
    return Decision(Phase.MODEL)


def _after_residual_round(state: AdaptiveState, is_last: bool) -> Decision:
    """Decide after a round of the model's residual whose error is above the target."""
    if is_last and is_mostly_noise(state):
        return Decision(None, _NOISE)
    return after_round_before_hierarchy(state, Phase.RESIDUAL, is_last=is_last)
