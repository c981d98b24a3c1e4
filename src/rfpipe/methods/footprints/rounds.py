"""The rounds of a footprint acquisition: what they show, what is made of it, and what follows."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import LevelImages
from rfpipe.methods.dual import Dual
from rfpipe.methods.footprints import handover
from rfpipe.methods.footprints.model import find
from rfpipe.methods.footprints.patterns import random_patterns
from rfpipe.methods.footprints.series import Series
from rfpipe.methods.footprints.state import ROUNDS, FootprintState, in_round
from rfpipe.methods.footprints.transport import arrays_of_model, nearness, spread_evenly
from rfpipe.methods.held_out.estimate import Estimate, error_of
from rfpipe.methods.held_out.patterns import HELD_OUT
from rfpipe.methods.images import read_planar
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.states import level_row
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints.transport import FootprintTransport
from rfpipe.transport.sum import SumTransport

__all__ = ["begin", "best", "decide", "judge", "patterns", "refine", "refine_hierarchy"]

# A projector of fewer rays than so many first rounds is lit block by block at once.
_SMALL = 4
# Random patterns of each of several views, at least.
_FEWEST = 4
# Pairs of a camera and a projector pixel beyond which footprints would be sought for an hour. At
# 128 x 128, 2^28, a first fit takes two minutes.
_MOST_PAIRS = 2**36
# Searches for footprints: when nothing is known, and in later rounds.
_FIRST_PASSES, _PASSES = 2, 1
# Errors should fall with this power of the patterns shown, noise alone with the root.
_STALLED = 0.25
# A model that has stalled, but for so much, at the target is not given up for dual photography,
# which begins with nothing: on fields of 9 x 12 x 16 rays, 680 more patterns gained nothing. The
# estimate is no surer.
_ABOUT = 1.2
# Errors after the first and the second round from which on the model is the wrong one: of diffuse
# scenes they are 4 and 2 %, of a bottle and its caustics 8 to 11 and 13 %.
_UNFIT = (0.07, 0.05)
# Under a pattern, a camera pixel with more than this part of its direct light is lit.
_LIT = 0.02

_log = logging.getLogger(__name__)


def patterns(state: FootprintState) -> Schedule:
    """Return a round's patterns: held-out ones, then random ones."""
    held, count = _asked(state)
    return state.round(held, random_patterns(state.projector.shape, state.level, count))


def begin(state: FootprintState, images: LevelImages) -> FootprintState:
    """Take the floodlit image."""
    pixels = state.camera.size
    radiance, variance = read_planar(images, state.channels, pixels, 1)
    nothing = np.zeros((0, state.channels, pixels), np.float32)
    lit = np.zeros((0, state.projector.size), np.bool_)
    pictures = Pictures(radiance[0], variance[0], lit, nothing, nothing)
    row = level_row(0, 1, scalar=pixels)
    unfit = not pictures.shine() or not _fits(state)
    return state.after(row, pictures=pictures, unfit=unfit)


def _fits(state: FootprintState) -> bool:
    """Tell whether a rig is neither too small nor too large for random patterns to pay."""
    pixels, rays, views = state.camera.size, state.projector.size, state.projector.views
    if pixels * rays > _MOST_PAIRS:
        _log.info("%d x %d pixels are too many to look for footprints", pixels, rays)
        return False
    limit = state.options.patterns
    if views > 1 and limit and limit <= 1 + HELD_OUT + (1 + _FEWEST) * views:
        _log.info("%d patterns are too few to light %d views one at a time", limit, views)
        return False
    return rays >= _SMALL * ROUNDS[0] * views


def refine(state: FootprintState, images: LevelImages) -> FootprintState:
    """Fit the model to a round's pictures and all before them."""
    assert state.pictures is not None
    count, first = images.schedule.count, len(_asked(state)[0])
    lit = images.schedule.batch(0, count).reshape(count, -1) > 0
    radiance, variance = read_planar(images, state.channels, state.camera.size, count)
    state = state.with_held(lit[:first], radiance[:first])
    row = level_row(state.level, count)
    if count == first:
        return state.after(row, new=0)
    assert state.pictures is not None
    pictures = state.pictures.extended(lit[first:], radiance[first:], variance[first:])
    unit = _unit(pictures)
    views = state.projector.views
    own = range(state.channels if state.channels > 1 else 0)
    channels = (_series(pictures.channel(index), unit, views) for index in own)
    grey = _series(pictures.grey() if own else pictures.channel(0), unit, views)
    passes = _PASSES if state.found else _FIRST_PASSES
    model = find(state.camera, state.projector, grey, channels, state.found, passes)
    arrays = arrays_of_model(model, state.camera, state.projector, unit)
    row["nodes"] = len(arrays["cores_columns"])
    row["scalar"] = len(arrays["footprints_columns"])
    return state.after(
        row,
        pictures=pictures,
        new=count - first,
        model=arrays,
        found=model.grey,
    )


def refine_hierarchy(
    state: FootprintState, images: LevelImages, memory_bytes: int
) -> FootprintState:
    """Let dual photography refine a level of its own."""
    assert state.dual is not None
    inner = handover.DUAL.refine(state.dual, images, memory_bytes)
    row = {**inner.rows[-1], "level": state.level}
    after = state.after(row, dual=inner, new=0, new_held=0)
    return judge(after) if images.schedule.count else after


def judge(state: FootprintState) -> FootprintState:
    """Estimate the error of what would be returned after the last level."""
    return state.judged(best(state)[1])


def decide(state: FootprintState) -> FootprintState:
    """Go on, go another way, or end."""
    found, limit, target = state.estimates[-1], state.options.patterns, state.options.target_error
    rounds, known = len(state.estimates), state.held is not None and len(state.held.lit) > HELD_OUT
    if (known and found.error <= target) or (limit and state.shown >= limit):
        return replace(state, following="done")
    if not state.unfit and rounds <= len(_UNFIT) and found.error > _UNFIT[rounds - 1]:
        state = replace(state, unfit=True)
    stalled = state.level > len(ROUNDS) or _slow(state)
    nearly = stalled and not state.unfit and found.error <= _ABOUT * target
    if not limit and known and (state.unfit or stalled) and not nearly:
        _log.info("the model of footprints leaves too much; going on with dual photography")
        assert state.pictures is not None
        return replace(state, following="hierarchy", dual=handover.begin(state, state.pictures))
    return replace(state, following="done") if stalled else state


def best(state: FootprintState) -> tuple[Transport, Estimate]:
    """Return what predicts the held-out pictures best, and how well."""
    return state.best(_candidates(state), partial(_estimate, state))


def model_of(state: FootprintState) -> FootprintTransport:
    """Return the model, or, before there is one, what the floodlit image says."""
    arrays = state.model
    if arrays is None:
        floodlit = np.zeros((state.channels, state.camera.size), np.float32)
        if state.pictures is not None:
            floodlit = state.pictures.floodlit
        arrays = spread_evenly(floodlit, state.projector.size)
    shapes = state.camera.shape, state.projector.shape
    return FootprintTransport(*shapes, state.channels, [], arrays)


def _candidates(state: FootprintState) -> Iterator[Transport]:
    """Yield the model, and the hierarchy if there is one."""
    rows = list(state.rows)
    yield SumTransport([model_of(state)], rows)
    if state.dual is not None:
        yield SumTransport([Dual().transport(state.dual)], rows)


def _estimate(state: FootprintState, transport: Transport) -> Estimate:
    """Compare a transport's pictures with the held-out ones, where pixels are known."""
    assert state.held is not None
    assert state.pictures is not None
    dark = ~_directly_lit(state, state.held.lit[0])
    return error_of(transport, state.held, state.pictures.known, dark)


def _directly_lit(state: FootprintState, lit: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which camera pixels have direct light under a pattern (N,), (pixels,)."""
    both = np.stack([lit, np.ones_like(lit)]).astype(np.float32)[:, None]
    light = np.broadcast_to(both, (2, state.channels, lit.size))
    found, full = model_of(state).direct().forward(light, range(state.channels)).sum(axis=1)
    return np.asarray(found > _LIT * full)


def _slow(state: FootprintState) -> bool:
    """Tell whether the last round cut the error too little for more to be worth it."""
    part = 1 - state.rows[-1]["patterns"] / state.shown
    return state.leaves(part**_STALLED)


def _asked(state: FootprintState) -> tuple[list[NDArray[np.bool_]], int]:
    """Return a round's held-out patterns, each as often as it is shown, and how many others."""
    reached = state.estimates and state.estimates[-1].error <= state.options.target_error
    # all that is left may be to see whether spots are as good
    views = state.projector.views
    count = 0 if state.unfit or reached else in_round(state.level - 1, views)
    return state.asked(count, lambda: nearness(model_of(state), state.camera, state.projector))


def _unit(pictures: Pictures) -> float:
    """Return the radiance about that of the floodlit image, a power of two: no digit is lost."""
    light = np.abs(pictures.floodlit[:, pictures.known]).astype(np.float64)
    mean = float(light.mean()) if light.size else 0.0
    return float(2.0 ** np.round(np.log2(mean))) if mean > 0 else 1.0


def _series(pictures: Pictures, unit: float, views: int) -> tuple[Series, ...]:
    """Return one channel's pictures pixel by pixel in a unit, for each view of the projector.

    The first picture of each is floodlit. Patterns of several views light one of them at a time,
    all of it at first.
    """
    known = np.isfinite(pictures.floodlit_variance).all(axis=0)
    known &= np.isfinite(pictures.variance[:, 0]).all(axis=0)
    series = []
    for view, lit in enumerate(np.split(pictures.lit, views, axis=1)):
        own = lit.any(axis=1)
        shown, seen, variance = lit[own], pictures.radiance[own, 0], pictures.variance[own, 0]
        if views == 1:
            shown = np.concatenate([np.ones((1, lit.shape[1]), np.bool_), shown])
            seen = np.concatenate([pictures.floodlit, seen])
            variance = np.concatenate([pictures.floodlit_variance, variance])
        assert shown[0].all(), f"view {view} was not lit whole at first"
        series.append(
            Series(
                np.ascontiguousarray(shown.T, np.float32),
                np.ascontiguousarray(np.where(known, seen / unit, 0).T, np.float32),
                np.ascontiguousarray(np.where(known, variance / unit / unit, np.inf).T, np.float32),
            )
        )
    return tuple(series)
