"""Dual photography (thesis ch. 3, C.1).

Blocks of projector rays that share no camera pixel are lit in one pattern. A response is the light
that a camera pixel receives from a block; large responses are subdivided on the next level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.array_types import Blocks, Float, Index
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.config.base import Fraction
from rfpipe.conflicts import colour_columns
from rfpipe.methods.base import (
    MEMORY_BYTES,
    TOLERANCES,
    LevelImages,
    Options,
    StateArrays,
)
from rfpipe.methods.descent import BlockTreeMethod
from rfpipe.methods.images import batches, rounding
from rfpipe.methods.states import MethodState, level_row, with_prefix, without_prefix
from rfpipe.patterns import Schedule
from rfpipe.transport.hierarchical.leaves import ragged_ranges
from rfpipe.transport.lazy import LazySequence
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.responses import Responses, by_level, fold, looks_symmetric, no_responses

# Limit of the responses stored for one pixel, added in quadrature (root sum of squares), in
# tolerances of the floodlit image's root mean square. A stored response is exact for its whole
# block; only its distribution over the rays of the block is unknown, which causes an error of at
# most about a tenth of the response in relit pictures.
_SUM_OF_ERRORS = 28.0

# Outcomes of a response: below noise, stored for its block, or to be subdivided.
_DROPPED, _STORED, _OPEN = 0, 1, 2


class DualOptions(Options):
    """The options of dual photography."""

    tolerance: Fraction = Field(
        1e-3,
        description="Radiance from one block to a camera pixel below which the block isn't "
        "subdivided for this pixel, a fraction of the floodlit maximum.",
    )


@dataclass(frozen=True)
class DualState(MethodState):
    """State of dual photography before a level.

    Attributes
    ----------
    tree : BlockTree
        Blocks of the projector's rays.
    stored : sequence of Responses
        Responses stored so far, one set per level.
    frontier : Responses
        Responses of level ``level - 1`` to be subdivided: the sets B_k of the thesis.
    floodlit_maximum, floodlit_rms : float
        Maximum and root mean square of the floodlit image, the units of the tolerance.
    complete : bool
        Whether all rays outside the frontier's blocks send no significant light to the camera.
    """

    options: DualOptions
    tree: BlockTree = field(kw_only=True)
    frontier: Responses = field(kw_only=True)
    stored: Sequence[Responses] = ()
    floodlit_maximum: float = 0.0
    floodlit_rms: float = 0.0
    complete: bool = True

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the last level's stored responses, and the frontier."""
        arrays = {
            **with_prefix("stored_", _pair_arrays(self.stored[-1])),
            **with_prefix("frontier_", _pair_arrays(self.frontier)),
        }
        attributes = {
            "rows": list(self.rows),
            "floodlit_maximum": self.floodlit_maximum,
            "floodlit_rms": self.floodlit_rms,
            "complete": self.complete,
        }
        return StateArrays(arrays, attributes)

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state; stored responses are read when first used."""
        if not levels:
            return start

        def stored(level: int) -> Responses:
            return Responses(level, **without_prefix("stored_", levels[level].arrays))

        last = levels[-1]
        attributes = dict(last.attributes)
        return replace(
            start,
            rows=tuple(attributes.pop("rows")),
            frontier=Responses(len(levels) - 1, **without_prefix("frontier_", last.arrays)),
            stored=LazySequence(range(len(levels)), stored, keep=True),
            **attributes,
        )


def _pair_arrays(pairs: Responses) -> dict[str, NDArray[Any]]:
    return {"block": pairs.block, "pixel": pairs.pixel, "values": pairs.values}


class Dual(BlockTreeMethod[DualState]):
    """Dual photography as a `Method`.

    Responses stored for a block still contribute to the images of finer levels. Their light is
    subtracted from these images, since energy is to be stored once [§3.2]; the pseudocode [C.1]
    counts it again where the pixel reads such an image for another of its blocks.
    """

    name = "dual"
    title = "Dual photography"
    colour = "#c4611a"
    marker = "s"
    bytes_per_ray = 20_000
    level_patterns, power = 18.5, 0.45
    Options = DualOptions
    trials = TOLERANCES[:-1]  # at smaller tolerances the default camera measures noise

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: DualOptions
    ) -> DualState:
        """Return the state before the floodlit image."""
        frontier = no_responses(0, channels)
        tree = BlockTree(projector)
        return DualState(camera, projector, channels, options, tree=tree, frontier=frontier)

    def next_schedule(self, state: DualState) -> Schedule | None:
        """Colour the conflict graph of the blocks to be subdivided; light their children in turn.

        Two blocks conflict when both send light to one camera pixel. Their children inherit the
        conflict, and the children of one block conflict with each other.
        """
        if state.level == 0:
            return Schedule.floodlit(state.projector.shape)
        if not len(state.frontier):
            return None
        tree, level = state.tree, state.level
        parents, colours = coloured_blocks(state.frontier, state.camera.size)
        counts = np.diff(tree.child_starts[level - 1])[parents]
        patterns_of_colour = np.zeros(int(colours.max()) + 1, np.int64)
        np.maximum.at(patterns_of_colour, colours, counts)
        first_pattern = np.cumsum(patterns_of_colour) - patterns_of_colour
        children = ragged_ranges(tree.child_starts[level - 1][parents], counts)
        pattern_of_block = np.full(tree.n_blocks(level), -1, np.int32)
        pattern_of_block[children] = ragged_ranges(first_pattern[colours], counts)
        return Schedule.of_blocks(tree, level, pattern_of_block, state.complete)

    def refine(
        self, state: DualState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> DualState:
        """Drop, store or subdivide each response that the level measured (ProcessResults, C.1)."""
        level = state.level
        block, pixel = _measured_pairs(state)
        if level == 0:
            radiance, _ = images.read(0, 1)
            maximum = float(radiance.max())
            rms = float(np.sqrt(np.mean(np.square(radiance, dtype=np.float64))))
            state = replace(state, floodlit_maximum=maximum, floodlit_rms=rms)
        values, outcome = _judged_responses(state, block, pixel, images)
        stored, frontier = (
            Responses(level, block[chosen], pixel[chosen], values[:, chosen])
            for chosen in (outcome == _STORED, outcome == _OPEN)
        )
        finished_blocks = np.setdiff1d(stored.block, frontier.block)  # unlit in all finer levels
        kind = "scalar" if level == state.tree.n_levels - 1 else "rank1"
        counts = {"empty": len(block) - len(stored) - len(frontier), kind: len(stored)}
        row = level_row(
            level, images.schedule.count, nodes=len(block), **counts, subdivided=len(frontier)
        )
        return replace(
            state,
            rows=(*state.rows, row),
            stored=(*state.stored, stored),
            frontier=frontier,
            complete=state.complete and not len(finished_blocks),
        )

    def transport(self, state: DualState) -> MultilevelTransport:
        """Return the multilevel transport; responses to be subdivided have their block's value.

        Where the measured single rays show that it is symmetric, the share of each ray in its
        block's response is taken from the transpose.
        """
        level_responses = list(state.stored)
        if len(state.frontier):
            last_level = [state.stored[-1], state.frontier]
            level_responses[-1] = fold(
                state.tree, state.level - 1, last_level, state.channels, state.camera.size
            )
        symmetric = looks_symmetric(state.tree, state.camera, level_responses)
        return _transport(state, level_responses, symmetric)


def _judged_responses(
    state: DualState, block: Blocks, pixel: Blocks, images: LevelImages
) -> tuple[Float, NDArray[np.uint8]]:
    """Measure the responses of pairs of blocks and pixels, and decide on each of them.

    Returns responses, float32 (C, n), at least 0, and outcomes, uint8 (n,).
    """
    schedule, planar = images.schedule, (-1, state.camera.size, state.channels)
    pattern = schedule.pattern_of_block(state.tree, state.level)[block]
    children = _child_counts(state.tree, state.level)[block]
    stored = _transport(state, state.stored)
    threshold = _threshold(state, len(block))
    values = np.empty((state.channels, len(block)), np.float32)
    outcome = np.empty(len(block), np.uint8)
    for first, last in batches(schedule.count, state.camera.size * state.channels):
        radiance, variance = (part.reshape(planar) for part in images.read(first, last))
        in_batch = np.flatnonzero((pattern >= first) & (pattern < last))
        measured = pattern[in_batch] - first, pixel[in_batch]
        response = radiance[measured]
        # a masked pixel has no response; its infinite noise must stay a number, times 0, too
        largest = np.finfo(np.float32).max
        noise = np.sqrt(np.minimum(variance[measured] + rounding(response, least=0.0), largest))
        predicted = stored.relight_batch(schedule.batch(first, last))
        response -= predicted.reshape(planar)[measured]
        values[:, in_batch] = np.maximum(response, 0.0).T
        outcome[in_batch] = _judge(
            response, state.options.noise_significance * noise, threshold, children[in_batch]
        )
    return values, outcome


def _threshold(state: DualState, responses: int) -> float:
    """Radiance below which a response is stored rather than subdivided.

    The errors of a pixel's responses are independent and add in quadrature. With `responses` over
    the camera pixels responses per pixel on average, a limit of their root sum of squares to
    `_SUM_OF_ERRORS` tolerances of the floodlit image's root mean square bounds each of them.
    """
    limit = _SUM_OF_ERRORS * np.sqrt(state.camera.size / max(responses, 1))
    return float(state.options.tolerance * min(state.floodlit_maximum, limit * state.floodlit_rms))


def _transport(
    state: DualState, level_responses: Sequence[Responses], symmetric: bool = False
) -> MultilevelTransport:
    """Return the transport of sets of responses."""
    shapes, rows = (state.camera.shape, state.projector.shape), list(state.rows)
    sets = by_level(level_responses)
    return MultilevelTransport(*shapes, state.channels, rows, sets, symmetric=symmetric)


def _measured_pairs(state: DualState) -> tuple[Blocks, Blocks]:
    """Return the blocks and pixels of the pairs that a level measures, (n,) each, by block.

    Level 0 measures the root at all pixels, each other level the children of the frontier's blocks
    at the frontier's pixels.
    """
    tree, level, frontier = state.tree, state.level, state.frontier
    if level == 0:
        pixel = np.arange(state.camera.size, dtype=np.int32)
        return np.zeros_like(pixel), pixel
    parents, first, count = np.unique(frontier.block, return_index=True, return_counts=True)
    begin = tree.child_starts[level - 1][parents]
    children = tree.child_starts[level - 1][parents + 1] - begin
    pixels = np.repeat(count, children)
    block = np.repeat(ragged_ranges(begin, children), pixels).astype(np.int32)
    return block, frontier.pixel[ragged_ranges(np.repeat(first, children), pixels)]


def _child_counts(tree: BlockTree, level: int) -> Index:
    """Count the children of each block of a level; 0 for a single ray."""
    sizes = np.diff(tree.starts[level])
    if level == tree.n_levels - 1:
        return np.zeros_like(sizes)
    return np.where(sizes > 1, np.diff(tree.child_starts[level]), 0)


def _judge(
    response: Float, noise_limit: NDArray[np.floating[Any]], threshold: float, children: Index
) -> NDArray[np.uint8]:
    """Decide on the outcome of responses (n, C), one for all channels.

    Above the radiance `noise_limit`, `noise_significance` standard deviations, a response is
    significant. A response is stored rather than subdivided where it is below `threshold`, or where
    an average child would be below `noise_limit`. `children` is 0 for blocks that can't be
    subdivided.
    """
    significant = (response > noise_limit).any(axis=1)
    limit = np.maximum(threshold, children[:, None] * noise_limit)
    large = (response >= limit).any(axis=1) & (children > 0)
    outcome = np.where(large, _OPEN, _STORED)
    return np.where(significant, outcome, _DROPPED).astype(np.uint8)


def coloured_blocks(frontier: Responses, pixels: int) -> tuple[Index, NDArray[np.int32]]:
    """Colour blocks so that no camera pixel receives light from two blocks of one colour.

    `ConstructConflictFreeLists` of the thesis.

    Returns the frontier's blocks, ascending, and their colours.
    """
    from scipy.sparse import coo_array

    blocks, column = np.unique(frontier.block, return_inverse=True)
    sees = coo_array(
        (np.ones(len(column), np.bool_), (frontier.pixel, column)), shape=(pixels, len(blocks))
    ).tocsr()
    return blocks.astype(np.int64), colour_columns(sees)
