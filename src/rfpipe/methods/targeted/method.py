"""A method that goes down a block tree, ended at an error that held-out pictures tell."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import MEMORY_BYTES, Float, LevelImages, Method, Pack, TargetOptions
from rfpipe.methods.held_out.estimate import Estimate, Held, error_of
from rfpipe.methods.held_out.patterns import (
    HELD_OUT,
    MOST_HELD_OUT,
    held_out_shapes,
    held_out_spots,
    held_out_strip,
)
from rfpipe.methods.images import read_planar, renumbered
from rfpipe.methods.states import Descent, appended, arrays_of, unprefixed
from rfpipe.methods.targeted.nearness import nearness
from rfpipe.methods.targeted.state import Kind, Shown, TargetedState
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport

__all__ = ["Targeted"]

# A level that leaves more than this of the error before it has shown that more may not help.
_STALLED = 0.85
# A pixel with less than this part of its light under random shapes has no direct light from them.
_DARK = 0.5
_INNER, _HELD = "inner_", "held_"

_log = logging.getLogger(__name__)


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
        self.inner = inner
        self.name, self.title, self.colour = inner.name, inner.title, inner.colour
        self.marker, self.line = inner.marker, inner.line
        self.needs_coaxial_rig = inner.needs_coaxial_rig
        self.thesis_table = inner.thesis_table
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
            return replace(self.inner.schedule(state.inner), level=level)
        if state.following == "done":
            nothing = np.full(shape, -1, np.int32)
            return Schedule(level, shape, 0, pattern_of_ray=nothing)
        held = [held_out_shapes(shape)]
        if state.held is not None:
            near = nearness(self.transport(state))
            held = [held_out_strip(near), held_out_spots(shape)]
        weights = np.repeat(np.stack(held), HELD_OUT, axis=0).astype(np.float32)
        return Schedule(level, shape, len(weights), weights=weights)

    def refine(
        self, state: TargetedState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> TargetedState:
        """Refine the inner method's level, or take held-out pictures; estimate the error."""
        kind, count = state.following, images.schedule.count
        if kind == "done":
            return state.after(Shown(kind, 0, None), "done")
        if kind == "held":
            state = self._judged_anew(self._with_held(state, images))
        else:
            own = renumbered(images, state.inner.level)
            state = replace(state, inner=self.inner.refine(state.inner, own, memory_bytes))
            state = self._judged(state) if count and state.held else state
        if state.held is None:
            return replace(state, best=state.inner).after(Shown(kind, count, None), "held")
        assert state.estimate is not None
        error = state.estimate.error if count else None
        return state.after(Shown(kind, count, error), self._following(state))

    def _with_held(self, state: TargetedState, images: LevelImages) -> TargetedState:
        """Take held-out pictures."""
        count, inner = images.schedule.count, state.inner
        lit = images.schedule.batch(0, count).reshape(count, -1) > 0
        radiance, variance = read_planar(images, inner.channels, inner.camera.size, count)
        if state.held is None:
            known = np.asarray(np.isfinite(variance).all(axis=(0, 1)))
            state = replace(state, known=known, dark=self._dark(inner, lit[0], radiance))
        return replace(state, held=appended(state.held, Held(lit, radiance)))

    def _dark(self, inner: Any, shapes: NDArray[np.bool_], pictures: Float) -> NDArray[np.bool_]:
        """Tell which camera pixels have no direct light from random shapes (N,)."""
        if self.needs_coaxial_rig:
            return ~shapes
        white = np.ones((1, inner.channels, inner.projector.size), np.float32)
        floodlit = self.inner.transport(inner).forward(white, range(inner.channels))[0]
        return np.asarray(pictures.mean(axis=0).sum(axis=0) < _DARK * floodlit.sum(axis=0))

    def _judged(self, state: TargetedState) -> TargetedState:
        """Estimate the error of the inner method's transport; keep it where it is the best."""
        found = self._estimate(state, state.inner)
        stalled = found.shapes > _STALLED * state.latest
        state = replace(state, latest=found.shapes, stalled=stalled)
        if state.estimate is not None and found.error > state.estimate.error:
            return state
        return replace(state, best=state.inner, estimate=found)

    def _judged_anew(self, state: TargetedState) -> TargetedState:
        """Estimate errors from all held-out pictures, after there were more of them."""
        found = self._estimate(state, state.best)
        state = replace(state, estimate=found, latest=min(state.latest, found.shapes))
        if state.best.level == state.inner.level:
            return state
        other = self._estimate(state, state.inner)
        if other.error > found.error:
            return state
        return replace(state, best=state.inner, estimate=other)

    def _estimate(self, state: TargetedState, inner: Any) -> Estimate:
        assert state.held is not None
        assert state.known is not None
        assert state.dark is not None
        return error_of(self.inner.transport(inner), state.held, state.known, state.dark)

    def _following(self, state: TargetedState) -> Kind:
        """Go on down the tree, ask for what held-out pictures are missing, or end."""
        found, inner = state.estimate, state.inner
        assert found is not None
        noise = state.stalled and found.is_noise
        reached = found.error <= state.target_error
        if not (reached or noise) and inner.level < self.inner.n_levels(
            inner.camera, inner.projector
        ):
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
            "estimate": None if state.estimate is None else list(astuple(state.estimate)),
            "latest": state.latest if state.held else None,
            "stalled": state.stalled,
        }
        if last.kind == "inner":
            own = self.inner.pack(state.inner)
            arrays = {f"{_INNER}{name}": array for name, array in own.arrays.items()}
            return Pack(arrays, {**attributes, "inner": dict(own.attributes)})
        if last.kind == "done":
            return Pack({}, attributes)
        assert state.held is not None
        latest = {name: a[-last.patterns :] for name, a in arrays_of(state.held, _HELD).items()}
        masks = {"known": state.known, "dark": state.dark}
        return Pack(
            {**latest, **{name: a.astype(np.uint8) for name, a in masks.items()}}, attributes
        )

    def restore(self, start: TargetedState, packs: Sequence[Pack]) -> TargetedState:
        """Return the state after the last of `packs`, one a level from level 0 on."""
        if not packs:
            return start
        about = packs[-1].attributes
        own = [
            Pack(unprefixed(_INNER, pack.arrays), pack.attributes["inner"])
            for pack in packs
            if "inner" in pack.attributes
        ]
        inner = self.inner.restore(start.inner, own)
        best = about["best"]
        state = replace(
            start,
            inner=inner,
            best=inner if best == inner.level else self.inner.restore(start.inner, own[:best]),
            shown=tuple(Shown(*pack.attributes["shown"]) for pack in packs),
            following=about["following"],
            stalled=about["stalled"],
        )
        return _with_pictures(state, packs) if about["estimate"] else state


def _with_pictures(state: TargetedState, packs: Sequence[Pack]) -> TargetedState:
    """Return a state with the held-out pictures of packs, and what they told last."""
    arrays = [pack.arrays for pack in packs if "known" in pack.arrays]
    held = None
    for pictures in (unprefixed(_HELD, own) for own in arrays):
        held = appended(held, Held(pictures["lit"].astype(np.bool_), pictures["radiance"]))
    about = packs[-1].attributes
    return replace(
        state,
        held=held,
        known=arrays[0]["known"].astype(np.bool_),
        dark=arrays[0]["dark"].astype(np.bool_),
        estimate=Estimate(*about["estimate"]),
        latest=about["latest"],
    )
