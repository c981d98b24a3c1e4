"""Symmetric photography: local rank-1 factors from both sides of a coaxial rig (thesis ch. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.conflicts import colour, conflict_graph, square
from rfpipe.errors import InputError
from rfpipe.methods.base import LevelImages, Pack, Settings
from rfpipe.methods.nodes import (
    Blocks,
    Double,
    Frontier,
    as_leaves,
    child_pairs,
    compared_pixels,
    no_nodes,
    select,
)
from rfpipe.methods.residuals import Measured, measure
from rfpipe.patterns import Schedule
from rfpipe.transport.hierarchical import (
    LEAF_PARTS,
    HierarchicalTransport,
    LeafSet,
    factor_offsets,
)

# The mean of n squared normal deviates stays within 1 +- 3 sqrt(2 / n) of its expectation.
_SPREAD = 3.0
# Outcomes of the rank test, the better the higher.
_DIFFERS, _AGREES, _CLOSE = range(3)


@dataclass(frozen=True)
class SymmetricState:
    """The state of symmetric photography before a level.

    Attributes
    ----------
    tree : BlockTree
    channels : int
    settings : Settings
    level : int
        Level to be scheduled next.
    known : tuple of LeafSet
        Leaves found so far.
    added : tuple of LeafSet
        Those of them that the last refinement found.
    frontier : Frontier
        Unknown nodes of level ``level - 1``.
    floodlit_maximum : float
        Maximum of the floodlit image, the unit of the tolerance.
    dark : ndarray of bool, shape (N,)
        Rays (in tree order) from which no light comes back under floodlight.
    rows : tuple of dict
        The table of levels so far.
    """

    tree: BlockTree
    channels: int
    settings: Settings
    level: int
    known: tuple[LeafSet, ...]
    added: tuple[LeafSet, ...]
    frontier: Frontier
    floodlit_maximum: float
    dark: NDArray[np.bool_]
    rows: tuple[dict[str, int], ...] = field(default=())


class Symmetric:
    """Symmetric photography as a `Method`."""

    name = "symmetric"

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the depth of the block tree; camera and projector must share their rays."""
        if camera.shape != projector.shape:
            raise InputError(
                f"symmetric photography needs a coaxial rig, one ray domain for camera and "
                f"projector; got a camera of {camera.shape} and a projector of {projector.shape}. "
                "Resample the camera onto the projector's grid, or use dual photography"
            )
        return BlockTree(projector).n_levels

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, settings: Settings
    ) -> SymmetricState:
        """Return the state before the floodlit image."""
        self.n_levels(camera, projector)
        tree = BlockTree(projector)
        dark = np.zeros(projector.size, np.bool_)
        nothing = no_nodes(channels)
        return SymmetricState(tree, channels, settings, 0, (), (), nothing, 0.0, dark)

    def schedule(self, state: SymmetricState) -> Schedule:
        """Colour the square of the graph of unknown transport (Lemmas 1 and 2)."""
        if state.level == 0:
            return Schedule.floodlit(state.tree.domain.shape)
        tree, level = state.tree, state.level
        _, first, second = child_pairs(tree, level - 1, state.frontier)
        blocks, index = np.unique(np.concatenate([first, second]), return_inverse=True)
        pattern_of_block = np.full(tree.n_blocks(level), -1, np.int32)
        if len(blocks):
            graph = conflict_graph(len(blocks), index[: len(first)], index[len(first) :])
            pattern_of_block[blocks] = colour(square(graph))
        lit = pattern_of_block[tree.block_of_position(level)] >= 0
        return Schedule.of_blocks(tree, level, pattern_of_block, bool((lit | state.dark).all()))

    def refine(self, state: SymmetricState, images: LevelImages) -> SymmetricState:
        """Test the unknown nodes against the level's images; keep, or subdivide."""
        measured = measure(state.tree, state.known, state.channels, images)
        if state.level == 0:
            return self._begin(state, measured)
        tree, level = state.tree, state.level
        if not images.schedule.count:
            row = _row(level, patterns=0)
            return replace(state, level=level + 1, added=(), rows=(*state.rows, row))
        verdict = _rank_test(state, measured)
        kept = as_leaves(
            tree, level - 1, select(tree, level - 1, state.frontier, verdict == _CLOSE)
        )
        divided = select(tree, level - 1, state.frontier, verdict < _CLOSE)
        node, first, second = child_pairs(tree, level - 1, divided)
        before = state.rows[-1]
        outcome = {"rank1": before["rank1"] + len(kept), "subdivided": len(divided)}
        settled = verdict[verdict < _CLOSE][node] == _AGREES
        found = _classify(state, first, second, measured, settled)
        row = _row(level, patterns=images.schedule.count, nodes=len(first), **found.counts)
        return replace(
            state,
            level=level + 1,
            known=(*state.known, kept, found.leaves),
            added=(kept, found.leaves),
            frontier=found.frontier,
            rows=(*state.rows[:-1], {**before, **outcome}, row),
        )

    def _begin(self, state: SymmetricState, measured: Measured) -> SymmetricState:
        """Make the root node from the floodlit image."""
        floodlit, variance = measured.residuals[0], measured.variances[0]
        significant = floodlit > state.settings.noise_significance * np.sqrt(variance)
        state = replace(
            state,
            floodlit_maximum=float(floodlit.max(initial=0.0)),
            dark=~significant.any(axis=0),
        )
        root = np.zeros(1, np.int32)
        found = _classify(state, root, root, measured, np.zeros(1, np.bool_))
        return replace(
            state,
            level=1,
            known=(found.leaves,),
            added=(found.leaves,),
            frontier=found.frontier,
            rows=(_row(0, patterns=1, nodes=1, **found.counts),),
        )

    def transport(self, state: SymmetricState) -> HierarchicalTransport:
        """Return the hierarchical tensor; nodes still unknown at their rank-1 estimate."""
        estimate = as_leaves(state.tree, state.level - 1, state.frontier)
        return HierarchicalTransport.from_leaf_sets(
            state.tree, state.channels, list(state.rows), [*state.known, estimate]
        )

    def pack(self, state: SymmetricState) -> Pack:
        """Return the leaves that the last refinement added, and the frontier."""
        arrays: dict[str, NDArray[Any]] = {"dark": state.dark.astype(np.uint8)}
        for leaves in state.added:
            prefix = f"leaves_{leaves.level:02d}"
            arrays |= {f"{prefix}_{part}": getattr(leaves, part) for part in LEAF_PARTS}
        for name in _FRONTIER:
            arrays[f"frontier_{name}"] = getattr(state.frontier, name)
        attributes = {
            "level": state.level,
            "leaf_levels": [leaves.level for leaves in state.added],
            "floodlit_maximum": state.floodlit_maximum,
            "rows": list(state.rows),
        }
        return Pack(arrays, attributes)

    def restore(self, start: SymmetricState, packs: Sequence[Pack]) -> SymmetricState:
        """Return the state after the last of `packs`, one a level from level 0 on."""
        if not packs:
            return start
        known: list[LeafSet] = []
        added: list[LeafSet] = []
        for pack in packs:
            added = [
                LeafSet(level, *(pack.arrays[f"leaves_{level:02d}_{part}"] for part in LEAF_PARTS))
                for level in pack.attributes["leaf_levels"]
            ]
            known += added
        last = packs[-1]
        return replace(
            start,
            level=last.attributes["level"],
            known=tuple(known),
            added=tuple(added),
            frontier=Frontier(*(last.arrays[f"frontier_{name}"] for name in _FRONTIER)),
            floodlit_maximum=last.attributes["floodlit_maximum"],
            dark=last.arrays["dark"].astype(np.bool_),
            rows=tuple(last.attributes["rows"]),
        )


_FRONTIER = ("block_a", "block_b", "pieces", "energy", "variance")


@dataclass(frozen=True)
class _Found:
    """What became of the nodes of a level, and how many of each kind there are."""

    leaves: LeafSet
    frontier: Frontier
    counts: dict[str, int]


def _row(
    level: int, *, patterns: int, nodes: int = 0, empty: int = 0, rank1: int = 0, scalar: int = 0
) -> dict[str, int]:
    """Return a row of the table of levels; what the rank test decides is known a level later."""
    return {
        "level": level,
        "patterns": patterns,
        "nodes": nodes,
        "empty": empty,
        "rank1": rank1,
        "scalar": scalar,
        "subdivided": 0,
    }


def _allowed(asked: float, noise: Double, samples: Double) -> Double:
    """Largest mean squared difference that still counts as agreement.

    Noise alone makes a mean squared difference of `noise`. What exceeds it may be as large as
    what the user asks for, or as the fluctuation of the noise's mean square over `samples` pixels.
    """
    allowed: Double = noise + np.maximum(asked, noise * _SPREAD * np.sqrt(2.0 / samples))
    return allowed


def _rank_test(state: SymmetricState, measured: Measured) -> NDArray[np.int8]:
    """Tell how well each unknown node predicts its children's images (thesis §5.1).

    A node passes only on evidence: where a single child on either side has nearly all the energy,
    its image is the node's own again, whatever lies underneath.

    Returns
    -------
    ndarray of int8, shape (n,)
        `_DIFFERS`: its children are unknown. `_AGREES`: they are leaves, made of the images that
        are there now; the error of a rank-1 leaf falls with the sides of both its blocks, so that
        it is some four times less than the node's own. `_CLOSE`: nothing is gained by that.
    """
    from rfpipe.methods import kernels

    tree, level, nodes = state.tree, state.level - 1, state.frontier
    starts = tree.starts[level]
    offset_a, offset_b, _ = factor_offsets(starts, nodes.block_a, nodes.block_b)
    ssd = np.empty((state.channels, len(nodes)))
    noise = np.empty_like(ssd)
    shares = np.empty((state.channels, 2, len(nodes)))
    kernels.rank_test(
        starts, tree.child_starts[level], tree.starts[level + 1], nodes.block_a, nodes.block_b,
        offset_a, offset_b, nodes.pieces, nodes.energy, nodes.variance, measured.pattern_of_block,
        measured.residuals, measured.variances, ssd, noise, shares,
    )  # fmt: skip
    samples = compared_pixels(tree, level, nodes)
    children = np.diff(tree.child_starts[level])
    # Two of four children with half the energy each are evidence enough, or three quarters and
    # one quarter where there are only two children.
    enough = 3.0 / (children[np.stack([nodes.block_b, nodes.block_a])] + 2.0)
    evident = (shares <= enough).any(axis=1)
    evident |= nodes.energy == 0
    verdict = np.full(len(nodes), _DIFFERS, np.int8)
    for outcome, share in ((_AGREES, 1.0), (_CLOSE, 1.0 / 16)):
        allowed = _allowed(_asked(state) * share, noise / samples, samples)
        verdict[((ssd / samples <= allowed) & evident).all(axis=0)] = outcome
    return verdict


def _asked(state: SymmetricState) -> float:
    """Mean squared difference that the user's tolerance allows in the image of one child.

    A pattern that lights half of a block adds up the errors of two of its four children.
    """
    return (state.settings.tolerance * state.floodlit_maximum) ** 2 / 2


def _classify(
    state: SymmetricState,
    block_a: Blocks,
    block_b: Blocks,
    measured: Measured,
    settled: NDArray[np.bool_],
) -> _Found:
    """Sort the nodes that a level measured into empty ones, leaves and unknown ones.

    The `settled` ones are no longer unknown in any case.
    """
    from rfpipe.methods import kernels

    tree, channels, level = state.tree, state.channels, state.level
    starts = tree.starts[level]
    sums = np.empty((channels, 2, len(block_a)))
    spread = np.empty_like(sums)
    kernels.measure_pieces(
        starts,
        block_a,
        block_b,
        measured.pattern_of_block,
        measured.residuals,
        measured.variances,
        sums,
        spread,
    )
    energy, variance = _combine(sums, spread, block_a == block_b)
    significant = energy > state.settings.noise_significance * np.sqrt(variance)
    energy = np.where(significant, energy, 0.0)
    full = np.any(significant, axis=0)
    block_a, block_b = block_a[full], block_b[full]
    energy, spread = np.ascontiguousarray(energy[:, full]), spread[..., full]
    empty = len(full) - len(block_a)
    if level == tree.n_levels - 1:
        leaves = LeafSet(level, block_a, block_b, energy.astype(np.float32))
        return _Found(leaves, no_nodes(channels), {"empty": empty, "scalar": len(leaves)})
    offset_a, offset_b, n_values = factor_offsets(starts, block_a, block_b)
    pieces = np.empty((channels, n_values), np.float32)
    worst = np.empty((channels, len(block_a)))
    lit = np.empty_like(worst)
    kernels.gather_pieces(
        starts, tree.child_starts[level], tree.starts[level + 1], block_a, block_b, offset_a,
        offset_b, energy, measured.pattern_of_block, measured.residuals, pieces, worst, lit,
    )  # fmt: skip
    nodes = Frontier(block_a, block_b, pieces, energy, np.ascontiguousarray(spread))
    sizes = np.diff(starts)
    pixels = np.where(block_a == block_b, sizes[block_a], sizes[block_a] + sizes[block_b])
    noise = np.where(block_a == block_b, spread[:, 0], spread.sum(axis=1)) / pixels
    # The images of the children can't differ from their prediction by more than `worst`: where
    # that is within bounds the rank test is passed already, and no pattern is spent on it. A node
    # over a single ray is of rank 1 whatever it holds.
    mean_worst = worst / np.maximum(lit, 1.0)
    certain = (mean_worst <= _allowed(_asked(state), noise, np.maximum(lit, 1.0))).all(axis=0)
    certain |= (sizes[block_a] == 1) | (sizes[block_b] == 1) | settled[full]
    leaves = as_leaves(tree, level, select(tree, level, nodes, certain))
    frontier = select(tree, level, nodes, ~certain)
    return _Found(leaves, frontier, {"empty": empty, "rank1": len(leaves)})


def _combine(sums: Double, spread: Double, diagonal: NDArray[np.bool_]) -> tuple[Double, Double]:
    """Combine the two measurements of a node's energy by their variances.

    On the diagonal both are the same one.
    """
    weight = np.where(spread.sum(axis=1, keepdims=True) > 0, spread[:, ::-1], 1.0)
    weight = weight / weight.sum(axis=1, keepdims=True)
    energy = (weight * sums).sum(axis=1)
    variance = (weight * weight * spread).sum(axis=1)
    return np.where(diagonal, sums[:, 0], energy), np.where(diagonal, spread[:, 0], variance)
