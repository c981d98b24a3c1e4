"""Dual photography: light together what no camera pixel sees together (thesis ch. 3, C.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.config.base import Fraction
from rfpipe.conflicts import colour_columns
from rfpipe.methods.base import MEMORY_BYTES, TOLERANCES, Float, LevelImages, Options
from rfpipe.methods.descent import Descent
from rfpipe.methods.images import batches
from rfpipe.methods.states import MethodState, grown, kept, level_row
from rfpipe.patterns import Schedule
from rfpipe.transport.hierarchical.leaves import ragged_ranges
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.responses import Responses, by_level, fold, looks_symmetric, no_responses

Index = NDArray[np.int64]
Blocks = NDArray[np.int32]

# Responses stored for one pixel, added up like noise, come to as many tolerances of the floodlit
# image's root mean square at most. A tenth of that or less is wrong by how they are spread.
_TOGETHER = 28.0

# What becomes of a response.
_DROPPED, _STORED, _OPEN = 0, 1, 2


class DualOptions(Options):
    """The options of dual photography."""

    tolerance: Fraction = Field(
        1e-3,
        description="Response below which a block isn't subdivided, a fraction of the floodlit "
        "maximum, between 0 and 1.",
    )


@dataclass(frozen=True)
class DualState(MethodState):
    """The state of dual photography before a level.

    Attributes
    ----------
    tree : BlockTree
        Of the projector's rays.
    stored : sequence of Responses
        Responses stored so far, one set a level.
    frontier : Responses
        Responses of level ``level - 1`` that are to be subdivided: the sets B_k of the thesis.
    floodlit_maximum, floodlit_rms : float
        Maximum and root mean square of the floodlit image, the units of the tolerance.
    complete : bool
        Whether all rays outside the frontier's blocks send no significant light to the camera.
    """

    options: DualOptions
    tree: BlockTree = field(kw_only=True)
    stored: Sequence[Responses] = grown(Responses)
    frontier: Responses = kept(Responses)
    floodlit_maximum: float = 0.0
    floodlit_rms: float = 0.0
    complete: bool = True


class Dual(Descent[DualState]):
    """Dual photography as a `Method`.

    The light that reaches a pixel from a block stored for it is still in the images of finer
    levels. It is taken off them, since energy is to be stored once [§3.2]; in the pseudocode [C.1]
    it counts again where the pixel reads such an image for another of its blocks.
    """

    name = "dual"
    title = "Dual photography"
    colour = "#c4611a"
    marker = "s"
    bytes_per_ray = 20_000
    thesis_patterns = 7_382  # of scene IV
    Options = DualOptions
    trials = TOLERANCES[:-1]  # beyond, responses are noise at the default camera

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: DualOptions
    ) -> DualState:
        """Return the state before the floodlit image."""
        nothing = no_responses(0, channels)
        return DualState(
            camera, projector, channels, options, tree=BlockTree(projector), frontier=nothing
        )

    def schedule(self, state: DualState) -> Schedule:
        """Colour the conflict graph of the blocks to be subdivided; light their children in turn.

        Two blocks conflict when a camera pixel sees both. Their children inherit the conflict,
        and those of one block conflict with each other.
        """
        if state.level == 0:
            return Schedule.floodlit(state.projector.shape)
        tree, level = state.tree, state.level
        pattern_of_block = np.full(tree.n_blocks(level), -1, np.int32)
        if len(state.frontier):
            parents, colours = coloured_blocks(state.frontier, state.camera.size)
            counts = np.diff(tree.child_starts[level - 1])[parents]
            patterns_of_colour = np.zeros(int(colours.max()) + 1, np.int64)
            np.maximum.at(patterns_of_colour, colours, counts)
            first_pattern = np.cumsum(patterns_of_colour) - patterns_of_colour
            children = ragged_ranges(tree.child_starts[level - 1][parents], counts)
            pattern_of_block[children] = ragged_ranges(first_pattern[colours], counts)
        return Schedule.of_blocks(tree, level, pattern_of_block, state.complete)

    def refine(
        self, state: DualState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> DualState:
        """Drop, store or subdivide each response that the level measured (ProcessResults, C.1)."""
        tree, level, schedule = state.tree, state.level, images.schedule
        block, pixel = _asked(state)
        total, planar = len(block), (-1, state.camera.size, state.channels)
        pattern = schedule.pattern_of_block(tree)[block]
        divisible = _divisible_into(tree, level)[block]
        values = np.empty((state.channels, total), np.float32)
        outcome = np.empty(total, np.uint8)
        maximum, rms = state.floodlit_maximum, state.floodlit_rms
        together = _TOGETHER * np.sqrt(state.camera.size / max(total, 1))
        known = _transport(state, state.stored)
        for first, last in batches(schedule.count, state.camera.size * state.channels):
            radiance, variance = (part.reshape(planar) for part in images.read(first, last))
            if level == 0:
                maximum = float(radiance.max())
                rms = float(np.sqrt(np.mean(np.square(radiance, dtype=np.float64))))
            here = np.flatnonzero((pattern >= first) & (pattern < last))
            measured = pattern[here] - first, pixel[here]
            response = radiance[measured]
            rounding = np.finfo(np.float32).eps * response
            # an unknown pixel has no response; its infinite noise must stay a number, times 0, too
            largest = np.finfo(np.float32).max
            noise = np.sqrt(np.minimum(variance[measured] + rounding * rounding, largest))
            predicted = known.relight_batch(schedule.batch(first, last))
            response -= predicted.reshape(planar)[measured]
            values[:, here] = np.maximum(response, 0.0).T
            outcome[here] = _judge(
                response,
                state.options.noise_significance * noise,
                state.options.tolerance * min(maximum, together * rms),
                divisible[here],
            )
        stored, frontier = (
            Responses(level, block[chosen], pixel[chosen], values[:, chosen])
            for chosen in (outcome == _STORED, outcome == _OPEN)
        )
        unlit_from_now_on = np.setdiff1d(stored.block, frontier.block)
        kind = "scalar" if level == tree.n_levels - 1 else "rank1"
        counts = {"empty": total - len(stored) - len(frontier), kind: len(stored)}
        return state.after(
            level_row(level, schedule.count, nodes=total, **counts, subdivided=len(frontier)),
            stored=(stored,),
            frontier=frontier,
            floodlit_maximum=maximum,
            floodlit_rms=rms,
            complete=state.complete and not len(unlit_from_now_on),
        )

    def transport(self, state: DualState) -> MultilevelTransport:
        """Return the multilevel transport; responses still to be subdivided as they are.

        Where the single rays measured show that it is symmetric, responses are spread over their
        blocks as the transpose is.
        """
        level_responses = list(state.stored)
        if len(state.frontier):
            together = [state.stored[-1], state.frontier]
            level_responses[-1] = fold(
                state.tree, state.level - 1, together, state.channels, state.camera.size
            )
        symmetric = looks_symmetric(state.tree, state.camera, level_responses)
        return _transport(state, level_responses, symmetric)


def _transport(
    state: DualState, level_responses: Sequence[Responses], symmetric: bool = False
) -> MultilevelTransport:
    """Return the transport of some of the responses."""
    shapes, rows = (state.camera.shape, state.projector.shape), list(state.rows)
    sets = by_level(level_responses)
    return MultilevelTransport(*shapes, state.channels, rows, sets, symmetric=symmetric)


def _asked(state: DualState) -> tuple[Blocks, Blocks]:
    """Return the blocks and pixels of the pairs that a level measures, (n,) each, by block.

    All pixels and the root; later, the frontier's pixels and their blocks' children.
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


def _divisible_into(tree: BlockTree, level: int) -> Index:
    """Return the number of children of each block of a level; 0 for a single ray."""
    sizes = np.diff(tree.starts[level])
    if level == tree.n_levels - 1:
        return np.zeros_like(sizes)
    return np.where(sizes > 1, np.diff(tree.child_starts[level]), 0)


def _judge(
    response: Float, noise: NDArray[np.floating[Any]], threshold: float, children: Index
) -> NDArray[np.uint8]:
    """Decide what becomes of responses (n, C), all channels together.

    A response is subdivided only where its children can be told from noise too: an average child
    has to be significant. Above the radiance `noise` a response is significant, below `threshold`
    it is stored rather than subdivided; `children` is 0 for blocks that can't be subdivided.
    """
    significant = (response > noise).any(axis=1)
    limit = np.maximum(threshold, children[:, None] * noise)
    large = (response >= limit).any(axis=1) & (children > 0)
    outcome = np.where(large, _OPEN, _STORED)
    return np.where(significant, outcome, _DROPPED).astype(np.uint8)


def coloured_blocks(frontier: Responses, pixels: int) -> tuple[Index, NDArray[np.int32]]:
    """Colour blocks so that no camera pixel sees two of one colour (ConstructConflictFreeLists).

    Returns the frontier's blocks, ascending, and their colours.
    """
    from scipy.sparse import coo_array

    blocks, column = np.unique(frontier.block, return_inverse=True)
    sees = coo_array(
        (np.ones(len(column), np.bool_), (frontier.pixel, column)), shape=(pixels, len(blocks))
    ).tocsr()
    return blocks.astype(np.int64), colour_columns(sees)
