"""The adaptive loop: show patterns, fit models, estimate the error, decide how to continue.

A *round* is one level of an acquisition: patterns, their pictures, and the fit to them. An
acquisition passes through phases, each of several rounds and each of which it may skip::

    floodlit            one picture, from which a first model is made
    prior               three held-out pictures, which judge a transport of an earlier acquisition
    model               random patterns; the model is fitted to all pictures so far
    residual            random blocks; the residual of the model is fitted
    hierarchy           multiplexed dual photography, for light that no model describes; a round
                        shows one level of the block tree, or more patterns of single rays; where
                        it doesn't help, its pictures serve the fit of the residual
    dense               random blocks for the residual again, where the light isn't sparse

With the first round of the model six held-out pictures are taken, or three more after a prior.
After each round the transport that predicts them best is the current result, and its error on them
is the estimated error (`rfpipe.methods.error_estimate`). The method then decides on the next phase,
or to end (`rfpipe.methods.adaptive.decisions`).
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.candidates import (
    Candidate,
    best_candidate,
    best_without_residual,
    camera_cells,
    error_of,
    floodlit_of,
    hierarchy_candidate,
    model_candidate,
)
from rfpipe.methods.adaptive.decisions import (
    ALL_SHOWN,
    LIMIT_REACHED,
    Decision,
    after_dense_round,
    after_hierarchy_round,
    end,
)
from rfpipe.methods.adaptive.forecast import (
    EXPECTED,
    LOWER_QUARTILE,
    UPPER_QUARTILE,
    hierarchy_hours,
    most_patterns,
    remaining_patterns,
)
from rfpipe.methods.adaptive.model import AdaptiveModel
from rfpipe.methods.adaptive.prior import USEFUL_PRIOR, pooled_estimate
from rfpipe.methods.adaptive.rounds import Rounds, next_round, random_pattern_count
from rfpipe.methods.adaptive.state import (
    HIERARCHY_METHOD,
    STOPPING_FRACTION,
    AdaptiveState,
    Phase,
    hierarchy_start,
)
from rfpipe.methods.base import (
    MEMORY_BYTES,
    ErrorOptions,
    Forecast,
    LevelImages,
    Method,
    check_rays,
)
from rfpipe.methods.held_out import held_out_patterns
from rfpipe.methods.images import Pictures, ScheduledImages
from rfpipe.methods.residual.fit import fit_residual
from rfpipe.methods.residual.model import CameraCells, residual_cells
from rfpipe.methods.residual.patterns import block_patterns
from rfpipe.methods.states import joined, level_row, picture_count
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport

_log = logging.getLogger(__name__)

# Where it is optional, the residual of a model is fitted in the second round, and kept if it leaves
# less than this share of the error. On the tuning scenes it is kept there or in no round.
_RESIDUAL_ROUND, _RESIDUAL_GAIN = 1, 0.95


class AdaptiveMethod(Method[AdaptiveState]):
    """A method that shows rounds of patterns until its estimated error meets the target.

    Attributes
    ----------
    State : type of AdaptiveState
    residual_is_optional : bool
        If True, the residual of a model is fitted in the second round, and dropped unless it
        reduces the error by 5 %. Otherwise it is fitted after each round, and used if it reduces
        the error.
    """

    estimates_error = True
    uses_prior = True
    Options = ErrorOptions
    trades = "target_error"
    State: ClassVar[type[AdaptiveState]]
    residual_is_optional: ClassVar[bool]

    @abstractmethod
    def rounds(self, projector: RayDomain) -> Rounds:
        """Return the rounds of each phase, in the order of the phases."""

    @abstractmethod
    def first_model(self, state: AdaptiveState, floodlit: Pictures) -> AdaptiveModel:
        """Make the model of the floodlit picture alone, with the prior that the state accepts."""

    @abstractmethod
    def decide(self, state: AdaptiveState, phase: Phase, is_last: bool) -> Decision:
        """Decide after a round of a phase at which the acquisition does not `end`.

        `is_last` is True if the phase has no further round.
        """

    # --- the loop

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> AdaptiveState:
        """Return the state before the floodlit picture."""
        check_rays(self, camera, projector)
        return self.State(camera, projector, channels, options)

    def next_schedule(self, state: AdaptiveState) -> Schedule | None:
        """Return the next round's patterns, held-out ones before random ones."""
        coming, shape = state.next_round, state.projector.shape
        if coming is None:
            return None
        if coming.phase is Phase.FLOODLIT:
            return Schedule.floodlit(shape)
        if coming.phase is Phase.HIERARCHY:
            assert state.hierarchy_state is not None
            schedule = HIERARCHY_METHOD.next_schedule(state.hierarchy_state)
            if schedule is None:
                return None
            assert schedule.weights is not None
            weights = schedule.weights[: coming.count or None]
            return Schedule(coming.key, shape, len(weights), weights=weights)
        if coming.phase is Phase.MODEL:
            patterns = self._model(state).next_patterns(coming.key, coming.count)
        else:
            patterns = block_patterns(residual_cells(shape), coming.key, coming.count)
        before = 0 if state.held_out is None else len(state.held_out.lit)
        held_out = held_out_patterns(shape)[before : before + coming.held_out]
        weights = np.concatenate([held_out, patterns])
        return Schedule(coming.key, shape, len(weights), weights=weights.astype(np.float32))

    def refine(
        self, state: AdaptiveState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> AdaptiveState:
        """Fit all pictures so far, estimate the error, and choose the next round."""
        shown = state.next_round
        assert shown is not None, "the acquisition has ended"
        if shown.phase is Phase.FLOODLIT:
            return self._after_floodlit(state, images)
        if shown.phase is Phase.HIERARCHY:
            return self._after_hierarchy_level(state, images, memory_bytes)
        row = level_row(state.level, images.schedule.count)
        after = replace(state, rows=(*state.rows, row))
        if shown.held_out:
            after = after.with_held_out(_read(state, images, 0, shown.held_out))
        if shown.count and shown.phase is Phase.MODEL:
            after = self._with_model_pictures(after, images, shown.held_out)
            after, best = self._fit_model(after)
        elif shown.count:
            cell_pictures = camera_cells(state).read(images, shown.held_out)
            after, best = self._fit_residual(after.with_cell_pictures(cell_pictures))
        else:
            best = best_candidate(after, self._model(after))
        if shown.phase is Phase.PRIOR:
            return self._after_prior(after, best)
        after = _with_estimate_of(after, state, best)
        is_last = shown.index + 1 == len(self.rounds(state.projector)[shown.phase])
        if shown.phase is Phase.DENSE:
            decision = end(after) or after_dense_round(after, is_last=is_last)
        else:
            decision = end(after) or self.decide(after, shown.phase, is_last)
        return self._continue(after, decision)

    def transport(self, state: AdaptiveState) -> Transport:
        """Return the transport that predicts the held-out pictures best."""
        if state.residual is None and state.hierarchy_state is None:
            return self._model(state).transport(list(state.rows))  # the only one
        return best_candidate(state, self._model(state)).transport

    # --- rounds

    def _after_floodlit(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        """Make the first model from the floodlit picture."""
        row = level_row(state.level, 1, scalar=state.camera.size)
        floodlit = self.prepared_floodlit(state, _read(state, images, 0, 1))
        model = self.first_model(state, floodlit)
        after = replace(state, rows=(row,), floodlit=floodlit, model=model)
        after = _with_prepared(after, model, camera_cells(after), [floodlit])
        phase = Phase.MODEL if state.prior is None else Phase.PRIOR
        return self._continue(after, Decision(phase))

    def _after_prior(self, state: AdaptiveState, best: Candidate) -> AdaptiveState:
        """End with the prior, continue from it, or drop it."""
        assert state.prior is not None
        after = state.with_estimate(pooled_estimate(best.estimate, state.prior))
        if best.estimate.error <= USEFUL_PRIOR or after.meets_target:
            return self._continue(after, end(after) or Decision(Phase.MODEL))
        _log.info("the prior has an error of %.2g; continuing without it", best.estimate.error)
        after = replace(after, prior_is_refuted=True)
        after = replace(after, model=self.first_model(after, floodlit_of(after)))
        # an acquisition that ends here returns this model
        best = best_candidate(after, self._model(after))
        after = after.with_estimate(best.estimate)
        return self._continue(replace(after, estimates=()), Decision(Phase.MODEL))

    def _with_model_pictures(
        self, state: AdaptiveState, images: LevelImages, first: int
    ) -> AdaptiveState:
        """Read the pictures of a round of the model from index `first` on, a few at a time."""
        pictures = Pictures.batches(images, state.channels, state.camera.size, first)
        return _with_prepared(state, self._model(state), camera_cells(state), pictures)

    def prepared_floodlit(self, state: AdaptiveState, picture: Pictures) -> Pictures:
        """Return the floodlit picture as the model uses it; here unchanged."""
        return picture

    def _fit_model(self, state: AdaptiveState) -> tuple[AdaptiveState, Candidate]:
        """Fit the model to all pictures, and its residual where that may help."""
        shown, model = state.next_round, self._model(state).fit(state.pictures)
        state = replace(state.with_row(**model.counts), model=model, residual=None)
        assert shown is not None
        base = best_without_residual(state, model)
        if self.residual_is_optional and shown.index != _RESIDUAL_ROUND:
            return state, base
        if state.with_estimate(base.estimate).meets_target:
            return state, base
        after = self._with_residual(state)
        best = best_candidate(after, model, base)
        is_useful = best.estimate.error < _RESIDUAL_GAIN * base.estimate.error
        return (after, best) if is_useful or not self.residual_is_optional else (state, base)

    def _fit_residual(self, state: AdaptiveState) -> tuple[AdaptiveState, Candidate]:
        """Fit the residual of the model, unless the model meets the target."""
        model = self._model(state)
        base = best_without_residual(state, model)
        if not state.with_estimate(base.estimate).meets_target:
            state = self._with_residual(state)
        return state, best_candidate(state, model, base)

    def _with_residual(self, state: AdaptiveState) -> AdaptiveState:
        """Fit the residual of the model to the pictures of all rounds."""
        camera, pictures, model = camera_cells(state), state.cell_pictures, self._model(state)
        assert pictures is not None, "the floodlit picture comes first"
        base = model.transport(list(state.rows))
        projector = model.projector_cells(camera, base)
        residual = fit_residual(camera, projector, pictures, base, state.residual)
        return replace(state, residual=residual)

    # --- the hierarchy

    def _start_hierarchy(self, state: AdaptiveState) -> AdaptiveState:
        """Hand the floodlit picture over to the hierarchy, and those of the model's rounds."""
        pictures, shape = floodlit_of(state), (1, *state.camera.shape, state.channels)
        radiance, variance = (
            np.ascontiguousarray(images[0].T).reshape(shape)
            for images in (pictures.radiance, pictures.variance)
        )
        schedule = Schedule.floodlit(state.projector.shape)
        floodlit = ScheduledImages(schedule, lambda *_: (radiance, variance))
        inner = HIERARCHY_METHOD.refine(hierarchy_start(state), floodlit)
        earlier = self._pictures_of_model(state)
        if earlier is not None:
            inner = replace(inner, pictures=(*inner.pictures, earlier))
        return replace(state, hierarchy_state=inner)

    def _pictures_of_model(self, state: AdaptiveState) -> Pictures | None:
        """Return the pictures of the model's rounds without the floodlit one, where known."""
        random = state.pictures[1:]
        if not random or state.cell_pictures is None:
            return None
        # patterns of a residual follow those of the model
        prepared = joined(random, axis=0)
        lit = state.cell_pictures.lit[1 : 1 + picture_count(prepared)]
        return self._model(state).taken(prepared, lit)

    def _after_hierarchy_level(
        self, state: AdaptiveState, images: LevelImages, memory_bytes: int
    ) -> AdaptiveState:
        """Refine the hierarchy; where it doesn't help, fit the residual to its pictures, too."""
        assert state.hierarchy_state is not None
        inner = HIERARCHY_METHOD.refine(state.hierarchy_state, images, memory_bytes)
        levels = (*state.hierarchy_levels, state.level)
        row = {**inner.rows[-1], "level": state.level}
        after = replace(
            state, rows=(*state.rows, row), hierarchy_state=inner, hierarchy_levels=levels
        )
        after = after.with_cell_pictures(camera_cells(after).read(images))
        model = self._model(after)
        hierarchy = hierarchy_candidate(after, model)
        base = min(model_candidate(after, model), hierarchy, key=error_of)
        best = best_candidate(after, model, base)
        is_of_rays = len(levels) >= len(inner.levels)
        if is_of_rays and best.estimate.error < hierarchy.estimate.error:
            refitted = self._with_residual(after)
            candidate = best_candidate(refitted, model, base)
            if candidate.estimate.error < best.estimate.error:
                after, best = refitted, candidate
        after = after.with_estimate(best.estimate)
        decision = end(after) or after_hierarchy_round(after, hierarchy.estimate.error)
        return self._continue(after, decision)

    def _model(self, state: AdaptiveState) -> AdaptiveModel:
        """Return the model; before the floodlit picture is taken, the model of a dark one."""
        if state.model is not None:
            return state.model
        dark = np.zeros((1, state.channels, state.camera.size), np.float32)
        lit = np.ones((1, state.projector.size), np.bool_)
        return self.first_model(state, Pictures(lit, dark, dark))

    # --- the next round

    def _continue(self, state: AdaptiveState, decision: Decision) -> AdaptiveState:
        """Choose the next round; log, and note in the table of levels, the reason of an end."""
        phase = decision.phase
        if phase is Phase.HIERARCHY and state.hierarchy_state is None:
            _log.info("%s; continuing with %s", decision.reason, HIERARCHY_METHOD.title.lower())
            hours = hierarchy_hours(state.camera.size)
            if hours[1] > 1:
                message = "its fits take about %.2g to %.2g hours of processor time"
                _log.warning(message, *hours)
            state = self._start_hierarchy(state)
        elif phase is not None and decision.reason:
            _log.info("%s; continuing with random blocks", decision.reason)
        coming = None
        if phase is not None:
            rounds, is_suitable = self.rounds(state.projector), self._model(state).is_suitable
            coming = next_round(state, rounds, phase, is_suitable=is_suitable)
        if coming is None and not state.meets_target:
            shortage = LIMIT_REACHED if state.options.patterns else ALL_SHOWN
            reason = shortage if phase is not None else decision.reason
            state = state.with_row(ended=reason)
            if state.estimates:
                ratio = STOPPING_FRACTION * state.excess[-1]
                message = "ended at an estimated error of %.2f times the target: %s"
                _log.warning(message, ratio, reason)
        return replace(state, next_round=coming)

    # --- forecast

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> Forecast:
        """Forecast the patterns from the target error, see `rfpipe.methods.adaptive.forecast`."""
        check_rays(self, camera, projector)
        rounds = self.rounds(projector)
        random_patterns, dense_patterns = random_pattern_count(rounds), sum(rounds[Phase.DENSE])
        largest = most_patterns(projector, random_patterns, dense_patterns, options)
        lower, patterns, upper = (
            min(round(law.at(projector.views, options.total_target)), projector.size, largest)
            for law in (LOWER_QUARTILE, EXPECTED, UPPER_QUARTILE)
        )
        forecast = self.forecast_of(camera, channels, patterns, largest)
        return replace(forecast, quartiles=(lower, upper))

    def remaining_patterns(self, state: AdaptiveState) -> int:
        """Forecast the number of patterns that the target still takes."""
        return remaining_patterns(state)


def _with_estimate_of(
    state: AdaptiveState, previous: AdaptiveState, best: Candidate
) -> AdaptiveState:
    """Add the best estimate; keep the models before the round if they are better."""
    if not previous.estimates or best.estimate.error <= previous.estimates[-1].error:
        return state.with_estimate(best.estimate)
    _log.info("the fit to more pictures has a larger error; keeping the previous one")
    state = replace(
        state,
        model=previous.model,
        residual=previous.residual,
    )
    return state.with_estimate(previous.estimates[-1])


def _read(state: AdaptiveState, images: LevelImages, first: int, last: int) -> Pictures:
    return Pictures.read(images, state.channels, state.camera.size, first, last)


def _with_prepared(
    state: AdaptiveState, model: AdaptiveModel, camera: CameraCells, batches: Iterable[Pictures]
) -> AdaptiveState:
    """Add pictures, as the model's fit and the residual's take them."""
    in_cells = []

    def prepared() -> Iterator[Any]:
        for batch in batches:
            in_cells.append(camera.cell_pictures(batch.lit, batch.radiance, batch.variance))
            yield model.prepared(batch)

    state = state.with_pictures(prepared())
    return state.with_cell_pictures(joined(in_cells, axis=0))
