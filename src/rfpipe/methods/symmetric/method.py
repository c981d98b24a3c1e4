"""Symmetric photography: local rank-1 factors from both sides of a coaxial rig (thesis ch. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.config.base import Fraction
from rfpipe.conflicts import colour_apart, conflict_graph
from rfpipe.methods.base import MEMORY_BYTES, TOLERANCES, LevelImages, Options
from rfpipe.methods.descent import Descent
from rfpipe.methods.states import MethodState, grown, joined, kept, level_row
from rfpipe.methods.symmetric.nodes import (
    Frontier,
    Subdivided,
    affordable,
    as_leaves,
    child_blocks,
    child_counts,
    child_pairs,
    collect,
    compared_pixels,
    no_nodes,
    select,
)
from rfpipe.methods.symmetric.rank_test import (
    AGREES,
    CLOSE,
    Found,
    Limits,
    classify,
    rank_test,
)
from rfpipe.patterns import Schedule
from rfpipe.transport.hierarchical.leaves import LeafSet
from rfpipe.transport.hierarchical.transport import HierarchicalTransport

# Error of a half-lit picture, in tolerances of its norm, if all nodes of a level are as far off as
# they may be.
_TOGETHER = 3.5


class SymmetricOptions(Options):
    """The options of symmetric photography."""

    tolerance: Fraction = Field(
        1e-3,
        description="Error allowed in a stored block, a fraction of the floodlit maximum, "
        "between 0 and 1.",
    )


@dataclass(frozen=True)
class SymmetricState(MethodState):
    """The state of symmetric photography before a level, beside what all states have.

    Attributes
    ----------
    tree : BlockTree
    known : sequence of LeafSet
        Leaves found so far.
    frontier : Frontier
        Unknown nodes of level ``level - 1``.
    floodlit_maximum, floodlit_rms : float
        Maximum and root mean square of the floodlit image, the units of the tolerance.
    dark : ndarray of bool, shape (N,)
        Rays (in tree order) from which no light comes back under floodlight.
    """

    options: SymmetricOptions
    tree: BlockTree = field(kw_only=True)
    frontier: Frontier = kept(Frontier)
    dark: NDArray[np.bool_] = field(kw_only=True)
    known: Sequence[LeafSet] = grown(LeafSet)
    floodlit_maximum: float = 0.0
    floodlit_rms: float = 0.0


class Symmetric(Descent[SymmetricState]):
    """Symmetric photography as a `Method`."""

    name = "symmetric"
    title = "Symmetric photography"
    colour = "#1f5a9e"
    needs_coaxial_rig = True
    bytes_per_ray = 20_000
    thesis_patterns = 1_085  # of scene II
    Options = SymmetricOptions
    trials = TOLERANCES

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: SymmetricOptions
    ) -> SymmetricState:
        """Return the state before the floodlit image."""
        self.n_levels(camera, projector)
        tree, nothing = BlockTree(projector), no_nodes(channels)
        dark = np.zeros(projector.size, np.bool_)
        return SymmetricState(
            camera, projector, channels, options, tree=tree, frontier=nothing, dark=dark
        )

    def schedule(self, state: SymmetricState) -> Schedule:
        """Colour the square of the graph of unknown transport (Lemmas 1 and 2)."""
        if state.level == 0:
            return Schedule.floodlit(state.tree.domain.shape)
        tree, level = state.tree, state.level
        first, second = child_blocks(tree, level - 1, state.frontier)
        mask = np.zeros(tree.n_blocks(level), np.bool_)
        mask[first] = mask[second] = True
        pattern_of_block = np.full(tree.n_blocks(level), -1, np.int32)
        if mask.any():
            number = np.cumsum(mask, dtype=np.int32) - 1
            graph = conflict_graph(int(number[-1]) + 1, number[first], number[second])
            del first, second
            pattern_of_block[mask] = colour_apart(graph)
        lit = pattern_of_block[tree.block_of_position(level)] >= 0
        return Schedule.of_blocks(tree, level, pattern_of_block, bool((lit | state.dark).all()))

    def refine(
        self, state: SymmetricState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> SymmetricState:
        """Test the unknown nodes by the level's images; keep them as leaves, or subdivide them."""
        if state.level == 0:
            return self._begin(state, images)
        tree, level, nodes = state.tree, state.level, state.frontier
        if not images.schedule.count:
            return state.after(level_row(level, 0))
        limits = _limits(state, tests=int(child_counts(tree, level - 1, nodes).sum()))
        leaves, parts, counts, above = zip(
            *(
                _refine_nodes(
                    state, select(tree, level - 1, nodes, run), images, limits, memory_bytes
                )
                for run in affordable(tree, level - 1, nodes, memory_bytes)
            ),
            strict=True,
        )
        before = state.rows[-1]
        outcome = _total(above)
        outcome["rank1"] += before["rank1"]
        row = level_row(level, images.schedule.count, **_total(counts))
        return replace(state, rows=(*state.rows[:-1], {**before, **outcome})).after(
            row,
            known=(joined(leaves), joined([part.leaves for part in parts])),
            frontier=joined([part.frontier for part in parts]),
        )

    def _begin(self, state: SymmetricState, images: LevelImages) -> SymmetricState:
        """Make the root node from the floodlit image."""
        root, channels = np.zeros(1, np.int32), state.channels
        pieces = collect(state.tree, root, root, (), channels, images, MEMORY_BYTES)
        significant = pieces.values > state.options.noise_significance * np.sqrt(pieces.variances)
        maximum = float(pieces.values.max(initial=0.0))
        rms = float(np.sqrt(np.mean(np.square(pieces.values, dtype=np.float64))))
        dark = np.logical_not(significant.any(axis=0))
        state = replace(state, floodlit_maximum=maximum, floodlit_rms=rms)
        first, nothing, unsettled = np.zeros(1, np.int64), no_nodes(channels), np.zeros(1, np.bool_)
        limits = _limits(state, tests=1)
        outcome = classify(state.tree, 0, pieces, first, unsettled, nothing, first, limits)
        row = level_row(0, 1, nodes=1, **outcome.counts)
        return state.after(
            row,
            known=(outcome.leaves,),
            frontier=outcome.frontier,
            floodlit_maximum=maximum,
            floodlit_rms=rms,
            dark=dark,
        )

    def transport(self, state: SymmetricState) -> HierarchicalTransport:
        """Return the hierarchical tensor; nodes still unknown at their rank-1 estimate."""
        estimate = as_leaves(state.tree, state.level - 1, state.frontier)
        return HierarchicalTransport.from_leaf_sets(
            state.tree, state.channels, list(state.rows), [*state.known, estimate]
        )


def _limits(state: SymmetricState, tests: int) -> Limits:
    """Return what the tolerance allows in the images of the frontier's children.

    A pattern that lights half of a block adds up the errors of two of its four children, so that
    one node may be off by half of the squared tolerance. The errors of many nodes add up like
    noise: half of all children lit, their squares sum to half of those of all. Were all nodes at
    the limit, they would come to `_TOGETHER` tolerances of such a picture's norm.
    """
    options, tree, level = state.options, state.tree, state.level
    of_one = (options.tolerance * state.floodlit_maximum) ** 2 / 2
    if not len(state.frontier):
        return Limits(of_one, options.noise_significance, tests)
    compared = float(compared_pixels(tree, level - 1, state.frontier).sum())
    of_all = 2 * (_TOGETHER * options.tolerance * state.floodlit_rms) ** 2
    bound = min(of_one, of_all * tree.domain.size / compared)
    return Limits(bound, options.noise_significance, tests)


def _total(parts: Sequence[dict[str, int]]) -> dict[str, int]:
    """Add up counts of the same names."""
    return {name: sum(part[name] for part in parts) for name in parts[0]}


def _refine_nodes(
    state: SymmetricState,
    nodes: Frontier,
    images: LevelImages,
    limits: Limits,
    memory_bytes: int,
) -> tuple[LeafSet, Found, dict[str, int], dict[str, int]]:
    """Test nodes of the level above the images'; keep them as leaves or sort their children.

    Returns the nodes' own leaves, what became of their children, and the counts of children and of
    nodes.
    """
    from rfpipe.methods.symmetric import kernels

    tree, level = state.tree, state.level
    node, first, second = child_pairs(tree, level - 1, nodes)
    pieces = collect(tree, first, second, state.known, state.channels, images, memory_bytes)
    first_pair = np.searchsorted(node, np.arange(len(nodes) + 1))
    divided = Subdivided(tree, level - 1, nodes, first_pair, pieces)
    verdict = rank_test(divided, limits)
    leaves = as_leaves(tree, level - 1, select(tree, level - 1, nodes, verdict == CLOSE))
    chosen = np.flatnonzero(verdict[node] < CLOSE)
    above = node[chosen]
    kernels.reconcile(divided.arrays)
    outcome = classify(tree, level, pieces, chosen, verdict[above] == AGREES, nodes, above, limits)
    counts = {"rank1": len(leaves), "subdivided": len(nodes) - len(leaves)}
    return leaves, outcome, {"nodes": len(chosen), **outcome.counts}, counts
