"""Near/far acquisition: transport by range, from few pictures, with a live error estimate.

Direct light, near-range and far-range indirect light (S. K. Nayar et al., *Fast separation of
direct and global components*, SIGGRAPH 2006, for the first step) are found together from random
patterns. Where that model does not hold, symmetric photography takes over.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import MEMORY_BYTES, ErrorOptions, Float, LevelImages, Pack
from rfpipe.methods.images import planar_batches
from rfpipe.methods.near_far import handover
from rfpipe.methods.near_far.estimate import Estimate, Held, estimate
from rfpipe.methods.near_far.model import Model, fit
from rfpipe.methods.near_far.patterns import (
    held_out_strip_twice,
    held_out_twice,
    probe_patterns,
)
from rfpipe.methods.near_far.pictures import Pictures, completed
from rfpipe.methods.near_far.transport import as_transport, indirect, light_range
from rfpipe.methods.states import (
    MethodState,
    Packing,
    PackingMethod,
    arrays_of,
    joined,
    level_row,
    unprefixed,
)
from rfpipe.methods.symmetric.method import Symmetric, SymmetricOptions, SymmetricState
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport
from rfpipe.transport.multiscale.basis import MultiscaleBasis
from rfpipe.transport.sum import SumTransport

# Held-out pictures that come with a round's probes, by level.
HELD_OUT = {1: 2, 2: 2}
# Probes of each round, a level: a round should cut the error, and end soon where the target is met.
ROUNDS = (6, 10, 8, 12, 16, 24, 32)
MOST = 1 + sum(HELD_OUT.values()) + sum(ROUNDS)
"""Patterns of all rounds."""

# A round that leaves more than this of the error before it has shown that more won't help.
_STALLED = 0.85
# A model that leaves so much of the indirect light's norm unexplained is the wrong one: after the
# first round, whose probes are few, and later.
_UNEXPLAINED_AT_FIRST, _UNEXPLAINED = 0.5, 0.25

_log = logging.getLogger(__name__)


class NearFarOptions(ErrorOptions, SymmetricOptions):
    """What near/far acquisition, and symmetric photography if it takes over, may be told."""


@dataclass(frozen=True)
class NearFarState(MethodState):
    """The state of a near/far acquisition, beside what all states have.

    Level 0 is the floodlit image, then come the rounds, then the levels of symmetric photography
    from its level 1 on.

    Attributes
    ----------
    pictures : Pictures, optional
        All pictures to fit; None before the floodlit image.
    new : int
        How many of them the last level brought.
    held : Held, optional
        Pictures that no fit sees; None before the first round.
    model : Model, optional
    estimates : tuple of Estimate
        After each round.
    done : bool
        Whether no more probes are asked for.
    symmetric : SymmetricState, optional
        Where symmetric photography has taken over.
    of_hierarchy : tuple of float
        The hierarchy's error after each of its levels, by the same held-out pictures.
    """

    options: NearFarOptions
    pictures: Pictures | None = None
    new: int = 0
    held: Held | None = None
    model: Model | None = None
    estimates: tuple[Estimate, ...] = ()
    done: bool = False
    symmetric: SymmetricState | None = None
    of_hierarchy: tuple[float, ...] = ()

    @property
    def model_is_better(self) -> bool:
        """Whether the smooth model predicts the held-out pictures better than the hierarchy."""
        return not self.of_hierarchy or self.estimates[-1].error < self.of_hierarchy[-1]

    @property
    def shown(self) -> int:
        """Patterns shown so far."""
        return sum(row["patterns"] for row in self.rows)


class NearFar(PackingMethod[NearFarState]):
    """Near/far acquisition as a `Method`.

    Rounds of random patterns are fitted until the estimate of the error, from pictures that no fit
    sees, is at most ``target_error``. Where the light isn't smooth at any scale, symmetric
    photography begins, and the held-out pictures decide which of both is returned, whenever that is
    asked, and how good it is.
    """

    name = "near_far"
    title = "Near/far acquisition"
    colour = "#b3263a"
    marker = "D"
    needs_coaxial_rig = True
    estimates_error = True
    Options = NearFarOptions
    trades = "target_error"
    trials = (0.05, 0.01, 0.003)
    packing = Packing(("level", "new", "done", "rows", "of_hierarchy"))

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the floodlit level, the rounds, and the levels of symmetric photography."""
        self.check(camera, projector)
        return len(ROUNDS) + Symmetric().n_levels(camera, projector)

    def expected_patterns(
        self, camera: RayDomain, projector: RayDomain, options: NearFarOptions
    ) -> int:
        """Return the patterns of all rounds: they don't grow with the resolution."""
        return min(projector.size, options.patterns or MOST)

    def most_patterns(
        self, camera: RayDomain, projector: RayDomain, options: NearFarOptions
    ) -> int:
        """Return those of symmetric photography of a scene in which no block is of low rank."""
        return Symmetric().most_patterns(camera, projector, options)

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: NearFarOptions
    ) -> NearFarState:
        """Return the state before the floodlit image."""
        self.n_levels(camera, projector)
        return NearFarState(camera, projector, channels, options)

    def schedule(self, state: NearFarState) -> Schedule:
        """Show the floodlit pattern, then probes; the first of them with the held-out patterns."""
        shape, level = state.projector.shape, state.level
        if level == 0:
            return Schedule.floodlit(shape)
        if level > len(ROUNDS):
            return handover.schedule(state.projector, state.symmetric, level)
        count = self._probes(state)
        held, found = np.zeros((0, *shape), np.bool_), None
        if level == 1 and count:
            held = held_out_twice(shape)
        elif count:
            assert state.model is not None
            assert state.pictures is not None
            found = light_range(shape, state.model, state.pictures.floodlit)
            if level == 2:
                held = held_out_strip_twice(found)
        patterns = np.concatenate([held, probe_patterns(shape, level, count, found)])
        return Schedule(level, shape, len(patterns), weights=patterns.astype(np.float32))

    def refine(
        self, state: NearFarState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> NearFarState:
        """Fit the model to all pictures so far and estimate its error; or refine the hierarchy."""
        level, count = state.level, images.schedule.count
        if level > len(ROUNDS):
            return _refine_symmetric(state, images, memory_bytes)
        if level and not count:
            return _skipped(state)
        radiance, variance = _read(state, images)
        if level == 0:
            nothing = np.zeros((0, *radiance.shape[1:]), np.float32)
            dark = np.zeros((0, state.projector.size), np.bool_)
            floodlit = completed(state.projector.shape, radiance[0], variance[0])
            pictures = Pictures(floodlit, variance[0], dark, nothing, nothing)
            row = level_row(0, 1, rank_k=0, scalar=state.projector.size)
            return state.after(row, pictures=pictures)
        assert state.pictures is not None
        lit = images.schedule.batch(0, count).reshape(count, -1) > 0
        first = HELD_OUT.get(level, 0)
        taken = Held(lit[:first], radiance[:first])
        held = taken if state.held is None else joined([state.held, taken], axis=0)
        pictures = state.pictures.extended(lit[first:], radiance[first:], variance[first:])
        model = fit(state.projector.shape, pictures)
        found = _estimate(pictures, model, held)
        row = level_row(
            level, count, nodes=len(model.basis.first), rank_k=0, estimated_error=found.error
        )
        estimates = (*state.estimates, found)
        return self._decide(
            state.after(
                row,
                pictures=pictures,
                new=count - first,
                held=held,
                model=model,
                estimates=estimates,
            )
        )

    def transport(self, state: NearFarState) -> Transport:
        """Return direct, near-range and far-range light as parts of a sum; or the hierarchy."""
        rows = list(state.rows)
        if state.symmetric is not None and not state.model_is_better:
            hierarchy = Symmetric().transport(state.symmetric)
            return SumTransport([hierarchy], rows, [len(ROUNDS)])
        pictures = state.pictures
        if pictures is None:
            dark = np.zeros((state.channels, state.projector.size), np.float32)
            nothing = dark[None][:0]
            pictures = Pictures(dark, dark, nothing[:, 0] > 0, nothing, nothing)
        fitted = len(state.estimates)
        return as_transport(state.projector.shape, rows, state.model, pictures, fitted)

    def known(self, state: NearFarState) -> Transport:
        """Return the hierarchy once it is refined, however far off it still is."""
        if state.symmetric is None:
            return self.transport(state)
        return Symmetric().transport(state.symmetric)

    def pack(self, state: NearFarState) -> Pack:
        """Return the last level's pictures, the model, and what symmetric photography found."""
        assert state.pictures is not None
        own = super().pack(state)
        arrays = arrays_of(state.pictures.since(len(state.pictures.lit) - state.new))
        if state.level > 1:
            del arrays["floodlit"], arrays["floodlit_variance"]
        if state.held is not None and state.new and (count := HELD_OUT.get(state.level - 1)):
            held = Held(state.held.lit[-count:], state.held.radiance[-count:])
            arrays |= arrays_of(held, "held_")
        if state.model is not None and state.new:
            arrays |= {"functions": state.model.basis.functions, "cores": state.model.cores}
        estimates = [list(astuple(found)) for found in state.estimates]
        attributes = {**own.attributes, "estimates": estimates}
        if state.symmetric is not None:
            inner, attributes["symmetric"] = handover.packed(state.symmetric)
            arrays |= inner
        return Pack(arrays, attributes)

    def _restored(self, start: NearFarState, packs: Sequence[Pack]) -> NearFarState:
        own = [pack.arrays for pack in packs]
        model = None
        if fitted := [arrays for arrays in own if "cores" in arrays]:
            basis = MultiscaleBasis(start.projector.shape, fitted[-1]["functions"])
            model = Model(basis, fitted[-1]["cores"])
        held = [unprefixed("held_", arrays) for arrays in own if "held_lit" in arrays]
        return replace(
            super()._restored(start, packs),
            pictures=Pictures(
                own[0]["floodlit"],
                own[0]["floodlit_variance"],
                *_joined(own, "radiance", "variance"),
            ),
            held=Held(*_joined(held, "radiance")) if held else None,
            model=model,
            estimates=tuple(Estimate(*found) for found in packs[-1].attributes["estimates"]),
            symmetric=handover.restored(start.projector, start.channels, start.options, packs),
        )

    def _probes(self, state: NearFarState) -> int:
        """Return how many probes the next round shows."""
        # without held-out pictures from the first round there is no fit
        if state.done or (state.level > 1 and state.held is None):
            return 0
        count = ROUNDS[state.level - 1]
        if state.options.patterns:
            held = HELD_OUT.get(state.level, 0)
            count = min(count, max(state.options.patterns - state.shown - held, 0))
        return count

    def _decide(self, state: NearFarState) -> NearFarState:
        """Go on, end, or let symmetric photography take over."""
        found, first = state.estimates[-1], len(state.estimates) == 1
        limit, target = state.options.patterns, state.options.target_error
        # the first estimate knows no strip yet: it bounds the error only if nothing is indirect
        reached = (found.indirect if first else found.error) <= target
        if (reached and found.error <= target) or (limit and state.shown >= limit):
            return replace(state, done=True)
        comparable = len(state.estimates) > 2
        stalled = comparable and found.error > _STALLED * state.estimates[-2].error
        stalled = stalled or state.level > len(ROUNDS)
        if stalled and found.is_noise:
            return replace(state, done=True)
        share = _UNEXPLAINED_AT_FIRST if first else _UNEXPLAINED
        if limit or not (stalled or found.dark > share * found.indirect):
            return state
        _log.info("the light is not smooth enough; going on with symmetric photography")
        assert state.pictures is not None
        begun = handover.begin(state.projector, state.options, state.pictures)
        return replace(state, done=True, symmetric=begun)


def _joined(packs: Sequence[Mapping[str, NDArray[Any]]], *names: str) -> tuple[Any, ...]:
    """Return the patterns of all packs, and what else they hold of the pictures, by name."""
    lit, *others = (np.concatenate([arrays[name] for arrays in packs]) for name in ("lit", *names))
    return lit.astype(np.bool_), *others


def _read(state: NearFarState, images: LevelImages) -> tuple[Float, Float]:
    """Read all images of a level, radiance and variance (M, C, N)."""
    channels, rays = state.channels, state.projector.size
    shape = (images.schedule.count, channels, rays)
    radiance, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for part, seen, spread in planar_batches(images, channels, rays):
        radiance[part], variance[part] = np.moveaxis(seen, 0, 1), np.moveaxis(spread, 0, 1)
    return radiance, variance


def _estimate(pictures: Pictures, model: Model, held: Held) -> Estimate:
    light = np.concatenate([held.lit, np.ones_like(held.lit[:1])]).astype(np.float32)
    bounced = indirect(model, pictures.floodlit, light)
    predicted = light[:-1, None] * (pictures.floodlit - bounced[-1]) + bounced[:-1]
    known = pictures.known
    return estimate(predicted[..., known], held.at(known))


def _skipped(state: NearFarState) -> NearFarState:
    """Return the state after a level that shows nothing."""
    return state.after(level_row(state.level, 0, rank_k=0), new=0)


def _refine_symmetric(state: NearFarState, images: LevelImages, memory_bytes: int) -> NearFarState:
    """Let symmetric photography refine a level of its own, if it has taken over."""
    level = state.level
    if state.symmetric is None:
        return _skipped(state)
    inner = handover.refine(state.symmetric, images, memory_bytes)
    errors = (*state.of_hierarchy, _error_of(inner, state))
    of_model = state.estimates[-1].error
    own = state.rows[: len(ROUNDS) + 1]
    rows = [
        {**row, "level": row["level"] + len(ROUNDS), "estimated_error": min(error, of_model)}
        for row, error in zip(inner.rows[1:], errors, strict=True)
    ]
    return replace(
        state, level=level + 1, new=0, symmetric=inner, of_hierarchy=errors, rows=(*own, *rows)
    )


def _error_of(hierarchy: SymmetricState, state: NearFarState) -> float:
    """Estimate the hierarchy's error, nodes that are still open at their estimate."""
    assert state.held is not None
    assert state.pictures is not None
    known = state.pictures.known
    patterns = state.held.lit.reshape(-1, *state.projector.shape).astype(np.float32)
    relit = Symmetric().transport(hierarchy).relight_batch(patterns)
    planar = np.moveaxis(relit.reshape(len(patterns), -1, state.channels), -1, 1)
    return estimate(planar[..., known], state.held.at(known)).error
