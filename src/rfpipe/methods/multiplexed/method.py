"""Multiplexed dual photography: dual photography whose patterns may overlap on the camera.

Like dual photography [thesis ch. 3] it goes down the projector's block tree, and subdivides for
each camera pixel the blocks that send it light. Dual photography lights two blocks in one pattern
only if no camera pixel receives light from both, so that one pixel with many bright blocks costs
many patterns. Here each pattern lights random blocks of a level, and regression finds the light of
each block (`rfpipe.methods.multiplexed.fit`), from the pictures of all levels together. The number
of patterns then depends on the number of blocks that light a typical pixel.

On the level of single rays, rounds of patterns follow until the fit to all earlier pictures
predicts the pictures of a round.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from pydantic import Field

from rfpipe.blocks import RayDomain
from rfpipe.config.base import Fraction
from rfpipe.methods.base import (
    MEMORY_BYTES,
    Forecast,
    LevelImages,
    Method,
    Options,
    StateArrays,
)
from rfpipe.methods.images import Pictures
from rfpipe.methods.multiplexed.blocks import BlockLevels, PixelBlocks, block_levels
from rfpipe.methods.multiplexed.fit import fit_blocks
from rfpipe.methods.multiplexed.patterns import first_patterns, further_patterns
from rfpipe.methods.states import MethodState, joined, level_row, with_prefix, without_prefix
from rfpipe.patterns import Schedule
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.responses import by_level
from rfpipe.transport.sum import SumTransport

# Patterns of the first two levels, of each further one, and of the first two rounds of single rays.
# Each later round has a third as many patterns as all rounds of single rays before it. With half as
# many patterns of the coarser levels, fits go astray (12 % in place of 1.7 % on `glass_and_ring`).
_COARSE, _FINE, _RAYS = 8, 12, 16
# Below this tolerance, coarser levels have more patterns, up to twice as many: dim blocks that they
# miss are found late (0.8 % after 167 patterns with 8 and 12, 125 with 16 and 24, on a mirror).
_COARSE_TOLERANCE = 0.004
# A block is subdivided for a pixel if its light exceeds this share of the floodlit pixel, later one
# over the number of patterns; where the pixel is darker than this fraction of the mean pixel, of
# that.
_SUBDIVIDED, _DARK = 0.005, 0.05


class MultiplexedOptions(Options):
    """The options of multiplexed dual photography."""

    tolerance: Fraction = Field(
        0.01,
        description="Error with which the pictures of a round are predicted before they are fitted "
        "at which to stop, beyond their noise, a fraction of their norm.",
    )


@dataclass(frozen=True)
class MultiplexedState(MethodState):
    """State before a level.

    Attributes
    ----------
    levels : BlockLevels
    pictures : tuple of Pictures
        All pictures so far; the first is floodlit.
    blocks : PixelBlocks, optional
        The fit to all pictures; None before the floodlit picture.
    is_complete : bool
        Whether the method is done.
    """

    options: MultiplexedOptions
    levels: BlockLevels = field(kw_only=True)
    pictures: tuple[Pictures, ...] = ()
    blocks: PixelBlocks | None = None
    is_complete: bool = False

    @property
    def index(self) -> int:
        """Index of the next round's level in `BlockLevels.levels`."""
        return min(self.level - 1, len(self.levels) - 1)

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the new pictures, and the fit."""
        added = self.pictures[len(previous.pictures) :]
        assert added
        assert self.blocks is not None
        arrays = {
            **with_prefix("pictures_", vars(joined(added, axis=0))),
            **with_prefix("blocks_", vars(self.blocks)),
        }
        return StateArrays(arrays, {"rows": list(self.rows), "is_complete": self.is_complete})

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state."""
        if not levels:
            return start
        last = levels[-1]
        return replace(
            start,
            rows=tuple(last.attributes["rows"]),
            is_complete=last.attributes["is_complete"],
            pictures=tuple(
                Pictures(**without_prefix("pictures_", level.arrays)) for level in levels
            ),
            blocks=PixelBlocks(**without_prefix("blocks_", last.arrays)),
        )


class Multiplexed(Method[MultiplexedState]):
    """Multiplexed dual photography as a `Method`."""

    name = "multiplexed"
    title = "Multiplexed dual photography"
    colour = "#8a6d1d"
    marker = "P"
    Options = MultiplexedOptions
    trades = "tolerance"
    trials = (0.03, 0.01, 0.003)

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: MultiplexedOptions
    ) -> MultiplexedState:
        """Return the state before the floodlit picture."""
        levels = block_levels(projector)
        return MultiplexedState(camera, projector, channels, options, levels=levels)

    def next_schedule(self, state: MultiplexedState) -> Schedule | None:
        """Light random blocks of a level, or of single rays once all levels had their round."""
        shape = state.projector.shape
        if state.level == 0:
            return Schedule.floodlit(shape)
        if state.is_complete:
            return None
        index = state.index
        count = pattern_count(state.level - 1, len(state.levels), state.options.tolerance)
        is_first = state.level <= len(state.levels)
        patterns = first_patterns if is_first else further_patterns
        lit = patterns(state.levels, index, state.level, count)
        return Schedule(state.level, shape, count, weights=state.levels.patterns(index, lit))

    def refine(
        self, state: MultiplexedState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> MultiplexedState:
        """Fit all pictures, and subdivide the bright blocks of each pixel."""
        count = images.schedule.count
        pictures = Pictures.read(images, state.channels, state.camera.size, 0, count)
        row = level_row(state.level, count)
        after = replace(state, rows=(*state.rows, row), pictures=(*state.pictures, pictures))
        floodlit = after.pictures[0].floodlit
        if state.blocks is None:
            is_lit = pictures.known & (floodlit.sum(axis=0) > 0)
            return replace(after, blocks=PixelBlocks.coarsest(state.levels, floodlit, is_lit))
        blocks = fit_blocks(state.levels, state.camera, state.blocks, after.pictures)
        is_repeated = state.level > len(state.levels)
        is_complete = is_repeated and self._is_predicted(state, pictures)
        shown = sum(row["patterns"] for row in after.rows)
        is_complete |= shown >= largest_pattern_count(state.projector)
        grey = floodlit.sum(axis=0)
        share = min(_SUBDIVIDED, 1 / sum(len(part.lit) for part in after.pictures))
        thresholds = share * np.maximum(grey, np.float32(_DARK) * grey.mean())
        finest = min(state.index + 1, len(state.levels) - 1)
        blocks = blocks.subdivided(state.levels, finest, thresholds)
        lit_blocks = int(np.count_nonzero(blocks.light.any(axis=0)))
        rows = (*state.rows, {**row, "nodes": len(blocks.block), "scalar": lit_blocks})
        return replace(after, rows=rows, blocks=blocks, is_complete=is_complete)

    def transport(self, state: MultiplexedState) -> SumTransport:
        """Return the transport of all levels; blocks that aren't subdivided yet light evenly.

        It is the only part of a sum, which is known after the last level alone: all pictures are
        fitted together.
        """
        responses = [] if state.blocks is None else state.blocks.responses(state.levels)
        shapes = state.camera.shape, state.projector.shape
        rows = list(state.rows)
        part = MultilevelTransport(*shapes, state.channels, rows, by_level(responses))
        return SumTransport([part], rows)

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> Forecast:
        """Forecast three rounds of single rays, and at most three patterns for two rays."""
        levels = block_levels(projector)
        of_rays = sum(ray_pattern_count(number) for number in range(3))
        patterns = 1 + coarse_pattern_count(levels, options.tolerance) + of_rays
        largest = largest_pattern_count(projector)
        return self.forecast_of(camera, channels, min(patterns, largest), largest)

    def _is_predicted(self, state: MultiplexedState, pictures: Pictures) -> bool:
        """Test whether a fit predicts pictures to within the tolerance and their noise."""
        shape = -1, *state.projector.shape
        predicted = self.transport(state).relight_batch(pictures.lit.reshape(shape))
        predicted = predicted.reshape(len(pictures.lit), -1, state.channels).swapaxes(1, 2)
        known = pictures.known[None]
        difference = np.where(known, predicted - pictures.radiance, 0)
        noise = float(np.where(known, pictures.variance, 0).sum(dtype=np.float64))
        error = float(np.square(difference, dtype=np.float64).sum()) - noise
        light = float(np.square(pictures.radiance, dtype=np.float64).sum())
        return error <= state.options.tolerance**2 * light


def pattern_count(number: int, levels: int, tolerance: float) -> int:
    """Return the number of patterns of a round after the floodlit picture, from 0.

    `levels` is the number of levels, each of which has a round; single rays have further ones.
    """
    if number >= levels - 1:
        return ray_pattern_count(number - (levels - 1))
    least = _COARSE if number < 2 else _FINE
    return round(least * min(max(math.sqrt(_COARSE_TOLERANCE / tolerance), 1), 2))


def coarse_pattern_count(levels: BlockLevels, tolerance: float) -> int:
    """Return the number of patterns above the level of single rays, without the floodlit one."""
    count = len(levels)
    return sum(pattern_count(number, count, tolerance) for number in range(count - 1))


def largest_pattern_count(projector: RayDomain) -> int:
    """Return the number of patterns after which no round follows, four for three rays.

    With one pattern a ray, light from all rays is determined too badly.
    """
    return -(-3 * projector.size // 2)


def ray_pattern_count(number: int) -> int:
    """Return the number of patterns of a round of single rays, from 0."""
    if number < 2:
        return _RAYS
    return sum(ray_pattern_count(earlier) for earlier in range(number)) // 3
