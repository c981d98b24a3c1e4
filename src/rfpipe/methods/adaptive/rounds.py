"""Rounds of patterns that end when held-out pictures are predicted well enough.

A round shows patterns, a model is fitted to all pictures so far, and pictures that no fit sees tell
its error. From that `rfpipe.methods.adaptive.decisions` tells what follows: another round, a
hierarchy that goes down the block tree, or the end.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.adaptive.decisions import (
    PATTERNS,
    Way,
    hierarchy_patterns,
    next_round,
    target_of,
    total_error,
    what_follows,
)
from rfpipe.methods.adaptive.state import SURE, AdaptiveState, hierarchy_start
from rfpipe.methods.base import (
    MEMORY_BYTES,
    ErrorOptions,
    Forecast,
    LevelImages,
    Method,
    check_rays,
    get_method,
)
from rfpipe.methods.error_estimate import HELD_OUT, Estimate, estimate_error, held_out_patterns
from rfpipe.methods.images import ImagesAs, Pictures
from rfpipe.methods.residual.fit import fit_residual
from rfpipe.methods.residual.model import (
    CameraCells,
    ProjectorCells,
    coaxial_projector,
    residual_cells,
)
from rfpipe.methods.residual.patterns import block_patterns
from rfpipe.methods.states import joined, level_row
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport
from rfpipe.transport.sum import SumTransport

_log = logging.getLogger(__name__)

BLOCK_ROUNDS = tuple(("residual", count) for count in (12, 20, 28, 40, 60, 88, 124, 170))
"""Rounds of what models leave, in random blocks: each has some 1.4 times all patterns before it."""

HIERARCHY_MARGIN = 4.0
"""Largest number of patterns of a hierarchy, over the number that `hierarchy_patterns` expects."""


class Adaptive(Method[AdaptiveState]):
    """A method in rounds, ended at an error that held-out pictures tell."""

    estimates_error = True
    Options = ErrorOptions
    trades = "target_error"
    State: ClassVar[type[AdaptiveState]] = AdaptiveState
    way: ClassVar[Way]

    @cached_property
    def hierarchy(self) -> Method[Any]:
        """The method that goes down the block tree."""
        method = get_method(self.State.hierarchy)
        assert isinstance(method, Method)
        return method

    @abstractmethod
    def levels(self, projector: RayDomain) -> tuple[tuple[str, int], ...]:
        """Return the table of rounds: the purpose of each, and its largest number of patterns.

        Rounds are numbered from 1; an acquisition skips those of another purpose than is due.
        """

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> Forecast:
        """Forecast the patterns from the target, by the benchmark's open scenes; see `PATTERNS`."""
        check_rays(self, camera, projector)
        a_view, power = PATTERNS
        typical = projector.views * a_view * float((0.01 / total_error(options)) ** power)
        most = self._max_patterns(projector, options)
        return self.forecast_of(camera, channels, min(round(typical), projector.size, most), most)

    def _max_patterns(self, projector: RayDomain, options: Any) -> int:
        """Bound the patterns of all rounds and of a hierarchy between them.

        A hierarchy shows at most each block of each level once. On large projectors that is far
        more than it needs, and `HIERARCHY_MARGIN` times its law bounds it.
        """
        rounds = sum(count for _, count in self.levels(projector))
        tree = BlockTree(projector)
        blocks = sum(tree.n_blocks(level) for level in range(1, tree.n_levels))
        law = hierarchy_patterns(total_error(options), tree.n_levels, self.way.law)
        hierarchy = min(blocks, round(HIERARCHY_MARGIN * law))
        total = 1 + len(HELD_OUT) + rounds + hierarchy
        return min(total, options.patterns or total)

    def below(self, projector: RayDomain) -> tuple[tuple[str, int], ...]:
        """Return the levels of the hierarchy below its floodlit one, and of what that leaves."""
        return (*(("hierarchy", 0),) * (BlockTree(projector).n_levels - 1), *BLOCK_ROUNDS)

    def _in_round(self, state: AdaptiveState, slot: int) -> int:
        """Number of patterns of a round, held-out ones not counted."""
        return next_round(state, self.levels(state.projector)[slot - 1][1])

    @abstractmethod
    def _patterns(self, state: AdaptiveState, slot: int, count: int) -> NDArray[np.bool_]:
        """Return the next round's patterns for the model, (count, *shape)."""

    @abstractmethod
    def _fitted(self, state: AdaptiveState) -> AdaptiveState:
        """Return the state with a fit to its pictures."""

    @abstractmethod
    def _model(self, state: AdaptiveState, *more: Transport) -> SumTransport:
        """Return what was fitted, and more parts of the light."""

    def _instead(self, state: AdaptiveState, *parts: Transport) -> SumTransport:
        """Return the hierarchy and what it leaves."""
        return SumTransport(parts, list(state.rows))

    @abstractmethod
    def _dark(self, state: AdaptiveState) -> NDArray[np.bool_]:
        """Return the camera pixels without direct light in each held-out picture."""

    def _sender(self, state: AdaptiveState, base: Transport, canvas: CameraCells) -> ProjectorCells:
        """Return the projector's cells."""
        return coaxial_projector(canvas)

    def _candidates(self, state: AdaptiveState) -> Iterator[tuple[Transport, bool]]:
        """Yield what may be returned, and whether it is the hierarchy: with what it leaves, too."""
        rest = []
        if state.residual is not None:
            canvas = CameraCells.of_pictures(state.camera.shape, state.pictures)
            rest = [state.residual.transport(canvas, state.projector.shape)]
        yield self._model(state), False
        if rest and not state.of_hierarchy:
            yield self._model(state, *rest), False
        if state.inner is not None:
            inner = self.hierarchy.transport(state.inner)
            yield SumTransport([inner], list(state.rows)), True
            if rest and state.of_hierarchy:
                yield self._instead(state, inner, *rest), True

    def _with_residual(self, state: AdaptiveState) -> AdaptiveState:
        """Find what the better model leaves of all pictures, unless it is good enough."""
        estimate, base, of_hierarchy = self._best(replace(state, residual=None))
        if state.estimated(estimate).reached:
            return state
        canvas, series = CameraCells.of_pictures(state.camera.shape, state.pictures), state.pictures
        pictures = [canvas.summed(series.lit, series.radiance, series.variance)]
        pictures += [] if state.others is None else [state.others]
        sender = self._sender(state, base, canvas)
        residual = fit_residual(canvas, sender, joined(pictures, axis=0), base)
        return replace(state, residual=residual, of_hierarchy=of_hierarchy)

    def decided(self, state: AdaptiveState) -> AdaptiveState:
        """Go on, go another way, or end; and say so."""
        rounds = self.levels(state.projector)
        just, slot = rounds[state.slot - 1][0], rounds[min(state.slot, len(rounds) - 1)][0]
        depth = BlockTree(state.projector).n_levels
        following, why = what_follows(state, self.way, just, slot, depth)
        if following == "hierarchy":
            _log.info("%s; going on with %s", why, self.hierarchy.title.lower())
            return self._hand_over(state, self.way.tolerance * target_of(state))
        if following == "done" and not state.reached:
            times = SURE * state.excess[-1]
            _log.warning("ended at an estimated %.2f times the error asked for: %s", times, why)
            state = state.counted(ended=why)
        elif why:
            _log.info("%s; going on with random blocks", why)
        return replace(state, following=following)

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> AdaptiveState:
        """Return the state before the floodlit image."""
        check_rays(self, camera, projector)
        return self.State(camera, projector, channels, options)

    def _next_slot(self, state: AdaptiveState) -> int | None:
        """Number of the next round in the table of rounds; None after the last one."""
        if not state.rows:
            return 0
        rounds = self.levels(state.projector)
        slots = range(state.slot + 1, len(rounds) + 1)
        slot = next((slot for slot in slots if rounds[slot - 1][0] == state.following), None)
        if slot is None:
            return None
        if state.following == "hierarchy":
            return slot if len(state.inner.frontier) else None
        return slot if sum(self._counts(state, slot)) else None

    def _counts(self, state: AdaptiveState, slot: int) -> tuple[int, int]:
        """Return the numbers of held-out patterns and of all other patterns of a round."""
        held = 0 if state.held else len(HELD_OUT)
        count, limit = self._in_round(state, slot), state.options.patterns
        if not limit:
            return held, count
        room = limit - state.shown
        if room >= held + min(count, 1):
            return held, min(count, room - held)
        # without any held-out pictures a round would say nothing of the error
        return 0, min(count, max(room, 0)) if state.held else 0

    def next_schedule(self, state: AdaptiveState) -> Schedule | None:
        """Show the floodlit pattern, then rounds, held-out patterns before the others."""
        shape, slot = state.projector.shape, self._next_slot(state)
        if slot is None:
            return None
        if slot == 0:
            return Schedule.floodlit(shape)
        if state.following == "hierarchy":
            schedule = self.hierarchy.next_schedule(state.inner)
            return None if schedule is None else replace(schedule, seed=slot)
        held, count = self._counts(state, slot)
        if state.following == "residual":
            patterns = block_patterns(residual_cells(shape), slot, count)
        else:
            patterns = self._patterns(state, slot, count)
        shown = [held_out_patterns(shape)[:held], patterns]
        weights = np.concatenate(shown).astype(np.float32)
        return Schedule(slot, shape, len(weights), weights=weights)

    def refine(
        self, state: AdaptiveState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> AdaptiveState:
        """Fit all pictures so far, or refine the hierarchy, and estimate the error."""
        slot, due, count = self._next_slot(state), state.following, images.schedule.count
        assert slot is not None
        if slot == 0:
            return self._begun(state, images)
        held, _ = self._counts(state, slot) if due != "hierarchy" else (0, 0)
        before = state
        state = replace(state, slot=slot)
        if due == "hierarchy":
            after = self._descend(state, images, memory_bytes)
            return replace(after, following="done") if after.reached else after
        after = replace(state, rows=(*state.rows, level_row(state.level, count)))
        if held:
            pictures = Pictures.read(images, state.channels, state.camera.size, 0, held)
            after = replace(after, held=pictures)
        if count > held and due == "residual":
            canvas = CameraCells.of_pictures(state.camera.shape, state.pictures)
            after = self._with_residual(after.with_others(canvas.read(images, held)))
        elif count > held:
            taken = Pictures.read(images, state.channels, state.camera.size, held, count)
            after = self._fitted(after.with_taken(taken))
        return self.decided(self._judged(after, before))

    def _begun(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        """Take the floodlit image."""
        floodlit = Pictures.read(images, state.channels, state.camera.size, 0, 1)
        row = level_row(state.level, 1, scalar=state.camera.size)
        return replace(state, rows=(row,), taken=floodlit)

    def _descend(
        self, state: AdaptiveState, images: LevelImages, memory_bytes: int
    ) -> AdaptiveState:
        """Let the hierarchy refine a level of its own; its pictures tell of what models leave."""
        inner = self.hierarchy.refine(state.inner, images, memory_bytes)
        levels = (*state.descended, state.level)
        rows = [*state.rows, level_row(state.level, images.schedule.count)]
        # a level may have changed the row of the one before it
        for back in range(1, min(len(levels), 2) + 1):
            level = levels[-back]
            rows[level] = {**rows[level], **inner.rows[-back], "level": level}
        state = replace(state, rows=tuple(rows), inner=inner, descended=levels)
        if not state.held:
            return state
        return self._judged(self._seen(state, images))

    def _seen(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        """Keep a hierarchy's pictures; after the last of its levels, find what it leaves."""
        canvas = CameraCells.of_pictures(state.camera.shape, state.pictures)
        state = state.with_others(canvas.read(images))
        if len(state.inner.frontier):
            return state
        return self._with_residual(replace(state, following="residual"))

    def _hand_over(self, state: AdaptiveState, tolerance: float) -> AdaptiveState:
        """Begin the hierarchy with the floodlit image, which is there already."""
        state = replace(state, following="hierarchy", tolerance=tolerance)
        pictures, shape = state.pictures, (1, *state.camera.shape, state.channels)
        radiance, variance = (
            np.ascontiguousarray(each[0].T).reshape(shape)
            for each in (pictures.radiance, pictures.variance)
        )
        schedule = Schedule.floodlit(state.projector.shape)
        floodlit = ImagesAs(schedule, lambda *_: (radiance, variance))
        return replace(state, inner=self.hierarchy.refine(hierarchy_start(state), floodlit))

    def _best(self, state: AdaptiveState) -> tuple[Estimate, Transport, bool]:
        """Return what predicts the held-out pictures best, how well, and if it's the hierarchy."""
        if not state.held:
            return Estimate(1.0, 1.0, 1.0), *next(self._candidates(state))
        held, floodlit, dark = state.held, state.pictures.floodlit, self._dark(state)
        estimated = [
            (estimate_error(transport, held, floodlit, dark), transport, of_hierarchy)
            for transport, of_hierarchy in self._candidates(state)
        ]
        return min(estimated, key=lambda each: each[0].error)

    def _judged(self, state: AdaptiveState, before: AdaptiveState | None = None) -> AdaptiveState:
        """Estimate the error of what would be returned; keep the model before, where better."""
        estimate = self._best(state)[0]
        if before and before.estimates and estimate.error > before.estimates[-1].error:
            _log.info("the fit to more pictures is worse than the one before, which is kept")
            fields = ("model", "residual", "of_hierarchy")
            state = replace(state, **{name: getattr(before, name) for name in fields})
            # the same model, held-out pictures and floodlit image
            estimate = before.estimates[-1]
        return state.estimated(estimate)

    def transport(self, state: AdaptiveState) -> Transport:
        """Return what predicts the held-out pictures best."""
        return self._best(state)[1]

    def transport_of_dark_rays(self, state: AdaptiveState) -> Transport:
        """Return the hierarchy while it is refined, whatever its error."""
        if state.following != "hierarchy":
            return self.transport(state)
        return self.hierarchy.transport(state.inner)
