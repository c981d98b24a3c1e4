"""The rounds of a near/far acquisition: what they show, what is made of it, and what follows."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float, LevelImages
from rfpipe.methods.held_out.estimate import Estimate, error_of
from rfpipe.methods.held_out.patterns import HELD_OUT
from rfpipe.methods.images import read_planar
from rfpipe.methods.near_far import handover
from rfpipe.methods.near_far.beyond import MOST_CELLS, all_pictures, canvas_of, cells_of, taken
from rfpipe.methods.near_far.model import fit
from rfpipe.methods.near_far.patterns import block_patterns, probe_patterns
from rfpipe.methods.near_far.pictures import Pictures, completed
from rfpipe.methods.near_far.state import BLOCKS, ROUNDS, NearFarState, kind_of
from rfpipe.methods.near_far.transport import LightRange, as_transport, light_range
from rfpipe.methods.residual.estimate import Residual
from rfpipe.methods.residual.estimate import estimate as estimate_residual
from rfpipe.methods.residual.pictures import Canvas
from rfpipe.methods.states import appended, level_row
from rfpipe.methods.symmetric.method import Symmetric
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport
from rfpipe.transport.sum import SumTransport

__all__ = ["begin", "best", "beyond", "decide", "judge", "patterns", "refine_hierarchy", "smooth"]

# A round that leaves more than this of the error before it has shown that more won't help. Rounds
# of blocks vary in size: there the error should fall with this power of the patterns shown.
_STALLED, _STALLED_BLOCKS = 0.85, 0.2
# Patterns a level by which symmetric photography has an error of a hundredth on the open scenes of
# the benchmark (13 to 41), and the power of the error by which they grow.
_OF_HIERARCHY, _HUNDREDTH, _GROWS = 27, 0.01, 0.57
# A model that leaves so much of the indirect light's norm unexplained is the wrong one: after the
# first round, whose probes are few, and later.
_UNEXPLAINED_AT_FIRST, _UNEXPLAINED = 0.5, 0.25
# What smooth light leaves is first looked at in so many cells, and then only if the error is less
# than this part of what it is without.
_ROUGHLY, _HELPS = 1024, 0.95
_BEFORE_HIERARCHY = len(ROUNDS) + len(BLOCKS)

_log = logging.getLogger(__name__)


def patterns(state: NearFarState) -> Schedule:
    """Return a round's patterns: held-out ones, then probes or blocks."""
    shape, level = state.projector.shape, state.level
    held, count = _asked(state)
    if state.kind == "residual":
        shown = block_patterns(cells_of(shape), level, count)
    else:
        found = _range(state) if level > 1 and count else None
        shown = probe_patterns(shape, level, count, found)
    return state.round(held, shown)


def begin(state: NearFarState, images: LevelImages) -> NearFarState:
    """Take the floodlit image."""
    radiance, variance = _read(state, images, 1)
    rays = state.projector.size
    nothing = np.zeros((0, state.channels, rays), np.float32)
    floodlit = completed(state.projector.shape, radiance[0], variance[0])
    pictures = Pictures(floodlit, variance[0], np.zeros((0, rays), np.bool_), nothing, nothing)
    return state.after(level_row(0, 1, rank_k=0, scalar=rays), pictures=pictures)


def smooth(state: NearFarState, images: LevelImages) -> NearFarState:
    """Fit smooth light to a round's pictures and all before them; and what it leaves of them."""
    assert state.pictures is not None
    count, first = images.schedule.count, len(_asked(state)[0])
    lit = images.schedule.batch(0, count).reshape(count, -1) > 0
    radiance, variance = _read(state, images, count)
    pictures = state.pictures.extended(lit[first:], radiance[first:], variance[first:])
    domain = state.projector.shape
    model = fit(domain, pictures)
    row = level_row(state.level, count, nodes=len(model.basis.first), rank_k=0)
    held = state.with_held(lit[:first], radiance[:first])
    fitted = held.after(row, pictures=pictures, new=count - first, model=model, residual=None)
    [(_, base)] = _bases(fitted)
    return fitted if state.level == 1 else replace(fitted, residual=_if_it_helps(fitted, base))


def _if_it_helps(state: NearFarState, base: Transport) -> Residual | None:
    """Find what smooth light leaves where the target isn't met and a rough look says it helps."""
    assert state.pictures is not None
    shape, error = state.projector.shape, _estimate(state, base).error
    if error <= state.options.target_error:
        return None
    roughly, canvas = (canvas_of(shape, state.pictures, most) for most in (_ROUGHLY, MOST_CELLS))
    left = _left_by(state, base, roughly)
    both = _with_rest(state, left.transport(roughly), of_hierarchy=False)
    if _estimate(state, both).error >= _HELPS * error:
        return None
    # of small pictures, the rough look is the close one
    same = roughly.cells.side == canvas.cells.side
    return left if same else _left_by(state, base, canvas)


def beyond(state: NearFarState, images: LevelImages) -> NearFarState:
    """Find what the better model leaves, from all pictures."""
    assert state.pictures is not None
    pictures, count, first = state.pictures, images.schedule.count, len(_asked(state)[0])
    lit = images.schedule.batch(0, first).reshape(first, state.projector.size) > 0
    state = state.with_held(lit, _read(state, images, first)[0])
    row = level_row(state.level, count, rank_k=0)
    if count == first:
        return state.after(row, new=0)
    more = taken(canvas_of(state.projector.shape, pictures), images, first)
    state = replace(state, taken=appended(state.taken, more))
    of_hierarchy, base = min(_bases(state), key=lambda each: _estimate(state, each[1]).error)
    left = _left_by(state, base, canvas_of(state.projector.shape, pictures))
    row["nodes"] = left.pairs.shape[1]
    return state.after(row, new=count - first, residual=left, of_hierarchy=of_hierarchy)


def _left_by(state: NearFarState, base: Transport, canvas: Canvas) -> Residual:
    """Find what a model leaves of all pictures."""
    assert state.pictures is not None
    return estimate_residual(canvas, all_pictures(canvas, state.pictures, state.taken), base)


def refine_hierarchy(state: NearFarState, images: LevelImages, memory_bytes: int) -> NearFarState:
    """Let symmetric photography refine a level of its own; its pictures serve later rounds, too."""
    assert state.symmetric is not None
    assert state.pictures is not None
    inner = handover.SYMMETRIC.refine(state.symmetric, images, memory_bytes)
    shared, count = state.rows[: _BEFORE_HIERARCHY + 1], images.schedule.count
    errors = [row.get("estimated_error") for row in state.rows[len(shared) :]]
    own = [
        {**row, "level": row["level"] + _BEFORE_HIERARCHY}
        | ({} if error is None else {"estimated_error": error})
        for row, error in zip(inner.rows[1:], [*errors, None], strict=True)
    ]
    more = state.taken
    if count:
        more = appended(more, taken(canvas_of(state.projector.shape, state.pictures), images))
    ended = state.level == _BEFORE_HIERARCHY + state.hierarchy - 1
    after = replace(
        state,
        level=state.level + 1,
        rows=(*shared, *own),
        symmetric=inner,
        taken=more,
        new=count,
        new_held=0,
        following="residual" if ended else "hierarchy",
    )
    return judge(after) if count else after


def judge(state: NearFarState) -> NearFarState:
    """Estimate the error of what would be returned after the last level."""
    return state.judged(best(state)[1])


def decide(state: NearFarState) -> NearFarState:
    """Go on, go another way, or end."""
    found, limit, target = state.estimates[-1], state.options.patterns, state.options.target_error
    just, first = kind_of(state.level - 1, state.hierarchy), len(state.estimates) == 1
    # the first estimate knows neither strip nor spots: it bounds the error if nothing is indirect
    known = len(state.held.lit) > HELD_OUT if state.held else False
    reached = found.error <= target and (known or found.indirect <= target)
    ended, slow, costly = state.kind != just, _slow(state), _costly(state)
    stalled = ended or costly or (slow and not _nearly(state))
    share = _UNEXPLAINED_AT_FIRST if first else _UNEXPLAINED
    lost = just == "smooth" and found.dark > share * found.indirect
    if reached or (limit and state.shown >= limit) or ((stalled or slow) and found.is_noise):
        return replace(state, following="done")
    if not limit and state.symmetric is None and (lost or (stalled and just == "residual")):
        _log.info("light goes to single places; going on with symmetric photography")
        assert state.pictures is not None
        begun = handover.begin(state.projector, state.options, state.pictures)
        return replace(state, following="hierarchy", symmetric=begun)
    # of the same patterns, blocks tell more of what smooth light leaves than probes do
    if just == "smooth" and (stalled or state.residual is not None):
        _log.info("smooth light is not all there is; going on with random blocks")
        return replace(state, following="residual")
    return replace(state, following="done") if stalled else state


def best(state: NearFarState) -> tuple[Transport, Estimate]:
    """Return what predicts the held-out pictures best, and how well."""
    return state.best(_candidates(state), partial(_estimate, state))


def _candidates(state: NearFarState) -> Iterator[Transport]:
    """Yield the models there are, and what is returned with what one of them leaves."""
    for of_hierarchy, base in _bases(state):
        yield base
        if state.residual is not None and state.of_hierarchy is of_hierarchy:
            assert state.pictures is not None
            rest = state.residual.transport(canvas_of(state.projector.shape, state.pictures))
            yield _with_rest(state, rest, of_hierarchy)


def _with_rest(state: NearFarState, rest: Transport, of_hierarchy: bool) -> Transport:
    """Return smooth light, or the hierarchy, and what it leaves."""
    assert state.pictures is not None
    parts = [rest]
    if of_hierarchy:
        assert state.symmetric is not None
        parts.insert(0, Symmetric().transport(state.symmetric))
    return as_transport(
        state.projector.shape,
        list(state.rows),
        None if of_hierarchy else state.model,
        state.pictures,
        parts,
    )


def _bases(state: NearFarState) -> Iterator[tuple[bool, Transport]]:
    """Yield smooth light, and the hierarchy if there is one, and whether it is that."""
    rows, pictures = list(state.rows), state.pictures
    if pictures is None:
        dark = np.zeros((state.channels, state.projector.size), np.float32)
        nothing = dark[None][:0]
        pictures = Pictures(dark, dark, nothing[:, 0] > 0, nothing, nothing)
    yield False, as_transport(state.projector.shape, rows, state.model, pictures)
    if state.symmetric is not None:
        yield True, SumTransport([Symmetric().transport(state.symmetric)], rows)


def _estimate(state: NearFarState, transport: Transport) -> Estimate:
    """Compare a transport's pictures with the held-out ones, where pixels are known."""
    assert state.held is not None
    assert state.pictures is not None
    return error_of(transport, state.held, state.pictures.known, ~state.held.lit[0])


def _slow(state: NearFarState) -> bool:
    """Tell whether the last round cut the error too little for more of its kind to be worth it."""
    share = _STALLED
    if kind_of(state.level - 1, state.hierarchy) == "residual":
        share = (1 - state.rows[-1]["patterns"] / state.shown) ** _STALLED_BLOCKS
    return state.leaves(share)


def _costly(state: NearFarState) -> bool:
    """Tell whether the target would take more blocks than a hierarchy, as errors fall so far."""
    found, shown = state.estimates[-3:], state.shown
    # the first estimate is of other held-out pictures
    if not _before_hierarchy(state) or len(state.estimates) < 4:
        return False
    asked = [row["patterns"] for row in state.rows if row["patterns"]]
    before = shown - sum(asked[-2:])
    power = _STALLED_BLOCKS
    if found[0].error > found[-1].error > 0:
        power = max(power, np.log(found[0].error / found[-1].error) / np.log(shown / before))
    return not _cheaper(state, power)


def _nearly(state: NearFarState) -> bool:
    """Tell whether blocks that hardly help still reach the target before a hierarchy would."""
    return _before_hierarchy(state) and _cheaper(state, _STALLED_BLOCKS)


def _before_hierarchy(state: NearFarState) -> bool:
    of_blocks = kind_of(state.level - 1, state.hierarchy) == "residual"
    return of_blocks and state.symmetric is None


def _cheaper(state: NearFarState, power: float) -> bool:
    """Tell whether blocks take fewer patterns than a hierarchy, with errors falling so."""
    target, found = state.options.target_error, state.estimates[-1]
    more = state.shown * ((found.error / target) ** (1 / power) - 1)
    of_hierarchy = _OF_HIERARCHY * state.hierarchy * (_HUNDREDTH / target) ** _GROWS
    return bool(more <= of_hierarchy)


def _asked(state: NearFarState) -> tuple[list[NDArray[np.bool_]], int]:
    """Return a round's held-out patterns, each as often as it is shown, and how many others."""
    if state.kind == "smooth":
        count = ROUNDS[state.level - 1]
    elif state.estimates[-1].error <= state.options.target_error:
        count = 0  # all that is left is to see whether spots are as good
    else:
        before = _BEFORE_HIERARCHY + state.hierarchy if state.symmetric else len(ROUNDS) + 1
        count = BLOCKS[state.level - before]
    return state.asked(count, lambda: _range(state).nearness)


def _range(state: NearFarState) -> LightRange:
    """Find where indirect light comes from."""
    assert state.model is not None
    assert state.pictures is not None
    return light_range(state.projector.shape, state.model, state.pictures.floodlit)


def _read(state: NearFarState, images: LevelImages, count: int) -> tuple[Float, Float]:
    """Read the first images of a level, radiance and variance (count, C, N)."""
    return read_planar(images, state.channels, state.projector.size, count)
