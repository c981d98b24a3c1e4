"""The method of symmetric photography, and its state (thesis ch. 5, C.2).

See `rfpipe.methods.symmetric` for the equation and the steps of a level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.config.base import Fraction
from rfpipe.methods.base import (
    MEMORY_BYTES,
    TOLERANCES,
    LevelImages,
    Options,
    StateArrays,
    check_rays,
)
from rfpipe.methods.descent import BlockTreeMethod
from rfpipe.methods.states import MethodState, joined, level_row, with_prefix, without_prefix
from rfpipe.methods.symmetric.classification import Classification, NodeCandidates, classify
from rfpipe.methods.symmetric.nodes import (
    EstimatedNodes,
    as_leaves,
    child_pairs,
    compared_pixels,
    counts_of_children,
    no_nodes,
    select,
)
from rfpipe.methods.symmetric.pieces import Subdivision, node_batches, residual_pieces
from rfpipe.methods.symmetric.rank_test import RankTestResult, Thresholds, rank_test_results
from rfpipe.methods.symmetric.scheduling import schedule_children
from rfpipe.patterns import Schedule
from rfpipe.transport.hierarchical.leaves import LeafSet
from rfpipe.transport.hierarchical.transport import HierarchicalTransport
from rfpipe.transport.lazy import LazySequence

# Error of a picture with half of the rays lit, in tolerances of its norm, if all nodes of a level
# are at the limit of their rank test.
_MOST_ERROR = 3.5


class SymmetricOptions(Options):
    """Options of symmetric photography."""

    tolerance: Fraction = Field(
        1e-3,
        description="Root mean square error allowed in the light from half of a block to another "
        "block, over the pixels of the latter, a fraction of the floodlit maximum.",
    )


@dataclass(frozen=True)
class SymmetricState(MethodState):
    """State of symmetric photography before a level; see `MethodState` for common fields.

    Attributes
    ----------
    tree : BlockTree
    known : sequence of LeafSet
        Leaves of all levels so far, which `residual_pieces` subtracts from images.
    frontier : EstimatedNodes
        Unknown nodes of level ``level - 1``.
    floodlit_maximum, floodlit_rms : float
        Maximum and root mean square of the floodlit image; the tolerance is relative to them.
    unseen : ndarray of bool, shape (N,)
        Rays, in tree order, without significant light in the floodlit image.
    """

    options: SymmetricOptions
    tree: BlockTree = field(kw_only=True)
    frontier: EstimatedNodes = field(kw_only=True)
    unseen: NDArray[np.bool_] = field(kw_only=True)
    known: Sequence[LeafSet] = ()
    floodlit_maximum: float = 0.0
    floodlit_rms: float = 0.0

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the leaves that the last level added, and the frontier.

        Level 0 adds one set of leaves. Each further level adds two: nodes of the previous level
        that passed the rank test clearly, and leaves of the last level.
        """
        arrays = {
            "unseen": self.unseen,
            **with_prefix("leaves_", _leaf_arrays(self.known[-1])),
            **with_prefix("frontier_", _node_arrays(self.frontier)),
        }
        if len(self.rows) > 1:
            arrays |= with_prefix("parents_", _leaf_arrays(self.known[-2]))
        attributes = {
            "rows": list(self.rows),
            "floodlit_maximum": self.floodlit_maximum,
            "floodlit_rms": self.floodlit_rms,
        }
        return StateArrays(arrays, attributes)

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state; leaves are read when first used."""
        if not levels:
            return start

        def leaves(key: tuple[str, int, int]) -> LeafSet:
            prefix, leaf_level, level = key
            return LeafSet(leaf_level, **without_prefix(prefix, levels[level].arrays))

        keys = [("leaves_", 0, 0)]
        for level in range(1, len(levels)):
            keys += [("parents_", level - 1, level), ("leaves_", level, level)]
        last = levels[-1]
        return replace(
            start,
            rows=tuple(last.attributes["rows"]),
            known=LazySequence(keys, leaves, keep=True),
            frontier=EstimatedNodes(**without_prefix("frontier_", last.arrays)),
            unseen=last.arrays["unseen"],
            floodlit_maximum=last.attributes["floodlit_maximum"],
            floodlit_rms=last.attributes["floodlit_rms"],
        )


def _leaf_arrays(leaves: LeafSet) -> dict[str, NDArray[Any]]:
    return {"block_a": leaves.block_a, "block_b": leaves.block_b, "values": leaves.values}


def _node_arrays(nodes: EstimatedNodes) -> dict[str, NDArray[Any]]:
    return {
        "block_a": nodes.block_a,
        "block_b": nodes.block_b,
        "pieces": nodes.pieces,
        "energy": nodes.energy,
        "variance": nodes.variance,
    }


class Symmetric(BlockTreeMethod[SymmetricState]):
    """Symmetric photography as a `Method`."""

    name = "symmetric"
    title = "Symmetric photography"
    colour = "#1f5a9e"
    needs_coaxial_rig = True
    bytes_per_ray = 20_000
    level_patterns, power = 11.5, 0.7
    Options = SymmetricOptions
    trials = TOLERANCES

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: SymmetricOptions
    ) -> SymmetricState:
        """Return the state before the floodlit image."""
        check_rays(self, camera, projector)
        tree, frontier = BlockTree(projector), no_nodes(channels)
        unseen = np.zeros(projector.size, np.bool_)
        return SymmetricState(
            camera, projector, channels, options, tree=tree, frontier=frontier, unseen=unseen
        )

    def next_schedule(self, state: SymmetricState) -> Schedule | None:
        """Return the floodlit pattern, or the patterns of the unknown nodes' children."""
        if state.level == 0:
            return Schedule.floodlit(state.tree.domain.shape)
        if not len(state.frontier):
            return None
        return schedule_children(state.tree, state.level, state.frontier, state.unseen)

    def refine(
        self, state: SymmetricState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> SymmetricState:
        """Test the unknown nodes on the level's images; they become leaves or are subdivided."""
        if state.level == 0:
            return self._begin(state, images)
        tree, level, nodes = state.tree, state.level, state.frontier
        limits = _limits(state, tests=int(counts_of_children(tree, level - 1, nodes).sum()))
        batches = [
            _refine_nodes(
                state, select(tree, level - 1, nodes, batch), images, limits, memory_bytes
            )
            for batch in node_batches(tree, level - 1, nodes, memory_bytes)
        ]
        row = level_row(
            level, images.schedule.count, **_total([it.counts_of_children for it in batches])
        )
        counts = _total([it.counts for it in batches])
        previous = state.rows[-1]
        # this level decides on the previous level's unknown nodes and so completes that level's row
        counts["rank1"] += previous["rank1"]
        return replace(
            state,
            rows=(*state.rows[:-1], {**previous, **counts}, row),
            known=(
                *state.known,
                joined([batch.leaves for batch in batches]),
                joined([batch.children.leaves for batch in batches]),
            ),
            frontier=joined([batch.children.unknown for batch in batches]),
        )

    def _begin(self, state: SymmetricState, images: LevelImages) -> SymmetricState:
        """Estimate the root node from the floodlit image."""
        root, first = np.zeros(1, np.int32), np.zeros(1, np.int64)
        pieces = residual_pieces(
            state.tree, 0, (root, root), (), state.channels, images, MEMORY_BYTES
        )
        significant = pieces.values > state.options.noise_significance * np.sqrt(pieces.variances)
        maximum = float(pieces.values.max(initial=0.0))
        rms = float(np.sqrt(np.mean(np.square(pieces.values, dtype=np.float64))))
        state = replace(state, floodlit_maximum=maximum, floodlit_rms=rms)
        candidates = NodeCandidates(first, np.zeros(1, np.bool_), no_nodes(state.channels), first)
        root_node = classify(state.tree, 0, pieces, candidates, _limits(state, tests=1))
        return replace(
            state,
            rows=(level_row(0, 1, nodes=1, **root_node.counts),),
            known=(root_node.leaves,),
            frontier=root_node.unknown,
            unseen=np.logical_not(significant.any(axis=0)),
        )

    def transport(self, state: SymmetricState) -> HierarchicalTransport:
        """Return the hierarchical tensor, with the rank-1 estimates of nodes that are unknown."""
        estimate = as_leaves(state.tree, state.level - 1, state.frontier)
        return HierarchicalTransport.from_leaf_sets(
            state.tree, state.channels, list(state.rows), [*state.known, estimate]
        )


def _limits(state: SymmetricState, tests: int) -> Thresholds:
    """Return the thresholds of the rank test of the frontier's nodes.

    A pattern that lights half of block b adds up the errors of two of its four children in the
    image over block a. The node limit, half of the squared tolerance for each child, keeps their
    mean square within the squared tolerance. The errors of different nodes are independent, so that
    their squares add up: a picture with half of all children lit has half of all squared errors.
    The limit is lower where many nodes at the node limit would cause an error above `_MOST_ERROR`
    tolerances of the norm of such a picture.
    """
    options, tree, level = state.options, state.tree, state.level
    node_limit = (options.tolerance * state.floodlit_maximum) ** 2 / 2
    if not len(state.frontier):
        return Thresholds(node_limit, options.noise_significance, tests)
    compared = float(compared_pixels(tree, level - 1, state.frontier).sum())
    total_limit = 2 * (_MOST_ERROR * options.tolerance * state.floodlit_rms) ** 2
    limit = min(node_limit, total_limit * tree.domain.size / compared)
    return Thresholds(limit, options.noise_significance, tests)


def _total(parts: Sequence[dict[str, int]]) -> dict[str, int]:
    """Add up counts of the same names."""
    return {name: sum(part[name] for part in parts) for name in parts[0]}


@dataclass(frozen=True)
class _Refined:
    """Refinement of some nodes of a level.

    Attributes
    ----------
    leaves : LeafSet
        Nodes that are leaves.
    children : Classification
        Of the subdivided nodes.
    counts, counts_of_children : dict
        Numbers of nodes and of children by kind, as in the table of levels.
    """

    leaves: LeafSet
    children: Classification
    counts: dict[str, int]
    counts_of_children: dict[str, int]


def _refine_nodes(
    state: SymmetricState,
    nodes: EstimatedNodes,
    images: LevelImages,
    limits: Thresholds,
    memory_bytes: int,
) -> _Refined:
    """Test nodes of the previous level, and classify the children of those without a leaf."""
    from rfpipe.methods.symmetric import classification_kernels

    tree, level = state.tree, state.level
    parent, a, b = child_pairs(tree, level - 1, nodes)
    pieces = residual_pieces(tree, level, (a, b), state.known, state.channels, images, memory_bytes)
    subdivision = Subdivision.of(tree, level - 1, nodes, parent, pieces)
    outcome = rank_test_results(tree, level - 1, nodes, subdivision, limits)
    is_leaf = outcome == RankTestResult.PASSED_CLEARLY
    leaves = as_leaves(tree, level - 1, select(tree, level - 1, nodes, is_leaf))
    classification_kernels.reconcile(*subdivision)
    pair = np.flatnonzero(~is_leaf[parent])
    is_final = outcome[parent[pair]] == RankTestResult.PASSED
    candidates = NodeCandidates(pair, is_final, nodes, parent[pair])
    children = classify(tree, level, pieces, candidates, limits)
    counts = {"rank1": len(leaves), "subdivided": len(nodes) - len(leaves)}
    return _Refined(leaves, children, counts, {"nodes": len(pair), **children.counts})
