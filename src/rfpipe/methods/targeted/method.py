"""A method that goes down a block tree, ended at an error that held-out pictures tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import MEMORY_BYTES, LevelImages, Method, Pack, TargetOptions
from rfpipe.methods.held_out.estimate import Held, error_of
from rfpipe.methods.held_out.patterns import MOST_HELD_OUT
from rfpipe.methods.held_out.rounds import due, gathered, latest
from rfpipe.methods.images import read_planar
from rfpipe.methods.nested import Nested
from rfpipe.methods.states import Descent, MethodState, appended
from rfpipe.methods.targeted.nearness import nearness
from rfpipe.methods.targeted.state import Kind, Shown, TargetedState
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport

__all__ = ["Targeted"]

_HELD = "held_"


class Targeted(Method[TargetedState]):
    """A method that goes down a block tree, until held-out pictures are predicted well enough.

    After the floodlit image come pictures of random shapes; when those are predicted, or the tree
    is at its end, pictures of the strip where most light stays near and of small spots, too. None
    of them is shown to the inner method. What predicts them best is returned.

    Parameters
    ----------
    inner : Descent
    """

    estimates_error = True

    def __init__(self, inner: Descent[Any]) -> None:
        self.inner, self.nested = inner, Nested(inner, "inner")
        self.name, self.title, self.colour = inner.name, inner.title, inner.colour
        self.marker, self.line = inner.marker, inner.line
        self.needs_coaxial_rig = inner.needs_coaxial_rig
        self.bytes_per_ray = inner.bytes_per_ray
        self.Options = inner.Options
        self.trades, self.trials = inner.trades, inner.trials

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the depth of the block tree, and two levels of held-out pictures."""
        return self.inner.n_levels(camera, projector) + 2

    def expected_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Guess the patterns from those of the inner method."""
        return self.inner.expected_patterns(camera, projector, options) + MOST_HELD_OUT

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Return the patterns of a scene for which all blocks are lit one by one."""
        return self.inner.most_patterns(camera, projector, options) + MOST_HELD_OUT

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: TargetOptions
    ) -> TargetedState:
        """Return the state before the floodlit image.

        Options without a ``target_error`` end at none.
        """
        begun = self.inner.start(camera, projector, channels, self._own(options))
        return TargetedState(begun, begun, options.target_error or 0.0)

    def _own(self, options: Any) -> Any:
        """Return the inner method's options: its tolerance follows from the target."""
        if options.target_error is None:
            return options
        asked, default = options.tolerance, type(options).model_fields["tolerance"].default
        follows = self.inner.tolerance_share * options.target_error
        tolerance = follows if asked == default else min(asked, follows)
        return options.model_copy(update={"target_error": None, "tolerance": tolerance})

    def schedule(self, state: TargetedState) -> Schedule:
        """Show what the inner method asks for, or held-out patterns."""
        level, shape = state.level, state.inner.projector.shape
        if state.following == "inner":
            return self.nested.schedule(state.inner, level)
        if state.following == "done":
            return Schedule.nothing(level, shape)
        held = due(shape, state.held, lambda: nearness(self.transport(state)))
        weights = np.stack(held).astype(np.float32)
        return Schedule(level, shape, len(weights), weights=weights)

    def asks(self, state: TargetedState) -> bool:
        """Tell whether the next level has patterns to show."""
        if state.following == "inner":
            return self.inner.asks(state.inner)
        return super().asks(state)

    def refine(
        self, state: TargetedState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> TargetedState:
        """Refine the inner method's level, or take held-out pictures; estimate the error."""
        kind, count = state.following, images.schedule.count
        if kind == "done":
            return state.after(Shown(kind, 0, None), "done")
        if kind == "held":
            state = self._with_held(state, images)
            state = self._judged(replace(state, error=self._error(state, state.best)))
        else:
            inner = self.nested.refine(state.inner, images, memory_bytes)
            state = replace(state, inner=inner)
            state = self._judged(state) if count and state.held else state
        if state.held is None:
            return replace(state, best=state.inner).after(Shown(kind, count, None), "held")
        error = state.error if count else None
        return state.after(Shown(kind, count, error), self._following(state))

    def _with_held(self, state: TargetedState, images: LevelImages) -> TargetedState:
        """Take held-out pictures."""
        count, inner = images.schedule.count, state.inner
        lit = images.schedule.batch(0, count).reshape(count, -1) > 0
        radiance, variance = read_planar(images, inner.channels, inner.camera.size, count)
        known = np.asarray(np.isfinite(variance).all(axis=(0, 1)))
        return replace(state, held=appended(state.held, Held(lit, radiance)), known=known)

    def _judged(self, state: TargetedState) -> TargetedState:
        """Take the inner method's transport for the best where it is no worse."""
        assert state.error is not None
        if state.best is state.inner:
            return state
        error = self._error(state, state.inner)
        return state if error > state.error else replace(state, best=state.inner, error=error)

    def _error(self, state: TargetedState, inner: MethodState) -> float:
        """Estimate the error of the transport of a state of the inner method's."""
        assert state.held is not None
        assert state.known is not None
        return error_of(self.inner.transport(inner), state.held, state.known).error

    def _following(self, state: TargetedState) -> Kind:
        """Go on down the tree, ask for what held-out pictures are missing, or end."""
        assert state.error is not None
        inner = state.inner
        last = inner.level == self.inner.n_levels(inner.camera, inner.projector)
        if state.error > state.target_error and not last:
            return "inner"
        return "done" if state.all_held else "held"

    def transport(self, state: TargetedState) -> Transport:
        """Return what predicts the held-out pictures best, of the inner method's kind."""
        found = self.inner.transport(state.best)
        found.level_rows = list(state.rows)
        return found

    def known(self, state: TargetedState) -> Transport:
        """Return what the inner method goes on with."""
        return self.inner.known(state.inner)

    def pack(self, state: TargetedState) -> Pack:
        """Return what the inner method packs, or the held-out pictures."""
        last = state.shown[-1]
        attributes: dict[str, Any] = {
            "shown": list(astuple(last)),
            "following": state.following,
            "best": state.best.level,
            "error": state.error,
        }
        if last.kind == "inner":
            return Pack({}, attributes) | self.nested.packed(state.inner)
        if last.kind == "done":
            return Pack({}, attributes)
        assert state.held is not None
        assert state.known is not None
        held = latest(state.held, last.patterns, _HELD)
        return Pack({**held, "known": state.known.astype(np.uint8)}, attributes)

    def restore(self, start: TargetedState, packs: Sequence[Pack]) -> TargetedState:
        """Return the state after the last of `packs`, one a level from level 0 on."""
        if not packs:
            return start
        about = packs[-1].attributes
        own = self.nested.packs_in(packs)
        inner = self.inner.restore(start.inner, own)
        best = about["best"]
        known = [pack.arrays["known"] for pack in packs if "known" in pack.arrays]
        return replace(
            start,
            inner=inner,
            best=inner if best == inner.level else self.inner.restore(start.inner, own[:best]),
            shown=tuple(Shown(*pack.attributes["shown"]) for pack in packs),
            following=about["following"],
            held=gathered(Held, packs, _HELD),
            known=known[-1].astype(np.bool_) if known else None,
            error=about["error"],
        )
