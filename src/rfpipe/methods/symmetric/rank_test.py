"""What the pieces of a level say of the nodes above, and of the pairs themselves (thesis §5.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.methods.symmetric.nodes import (
    Double,
    Frontier,
    Grid,
    Nodes,
    Pairs,
    Pieces,
    Subdivided,
    as_leaves,
    compared_pixels,
    no_nodes,
    select,
)
from rfpipe.transport.hierarchical.leaves import LeafSet

# The mean of n squared normal deviates stays within 1 +- 3 sqrt(2 / n) of its expectation.
_SPREAD = 3.0
# Outcomes of the rank test, the better the higher.
DIFFERS, AGREES, CLOSE = range(3)


@dataclass(frozen=True)
class Limits:
    """What counts as light, and as agreement.

    Attributes
    ----------
    asked : float
        Mean squared difference that the user's tolerance allows in the image of one child, in
        squared radiance.
    significance : float
        Standard deviations that make one measured light count.
    tests : int
        How many of them are measured at this level.
    """

    asked: float
    significance: float
    tests: int

    @property
    def significant(self) -> float:
        """Squared standard deviations that make any of the level's measurements worth patterns.

        The tail of n normal deviates beyond t is about ``n exp(-t^2 / 2)``: with this t, that noise
        is taken for light anywhere in the level is as unlikely as it is for one measurement.
        """
        return self.significance**2 + 2.0 * math.log(max(self.tests, 1))

    def allowed(self, noise: Double, samples: Double, share: float = 1.0) -> Double:
        """Largest mean squared difference that still counts as agreement.

        Noise alone makes a mean squared difference of `noise`. What exceeds it may be as large as
        `share` of what the user asks for, or as the fluctuation of the noise's mean square over
        `samples` pixels.
        """
        fluctuation = noise * _SPREAD * np.sqrt(2.0 / samples)
        allowed: Double = noise + np.maximum(self.asked * share, fluctuation)
        return allowed


@dataclass(frozen=True)
class Found:
    """What became of the nodes of a level, and how many of each kind there are."""

    leaves: LeafSet
    frontier: Frontier
    counts: dict[str, int]


def rank_test(divided: Subdivided, limits: Limits) -> NDArray[np.int8]:
    """Tell how well each unknown node predicts its children's pieces (thesis §5.1), int8 (n,).

    A node passes only on evidence: where a single child on either side has nearly all the energy,
    its image is the node's own again, whatever lies underneath. So are the images that whole views
    light: they are as alike as can be where all views see the same spots, each of which is lit by
    few rays of any of them.

    `DIFFERS`: its children are unknown. `AGREES`: they are leaves, made of the images that are
    there now; the error of a rank-1 leaf falls with the sides of both its blocks, so that it is
    some four times less than the node's own. `CLOSE`: nothing is gained by that.
    """
    from rfpipe.methods.symmetric import kernels

    tree, level, nodes = divided.tree, divided.level, divided.nodes
    ssd = np.empty(nodes.energy.shape)
    noise = np.empty_like(ssd)
    squares = np.empty((len(ssd), 2, len(nodes)))
    kernels.rank_test(divided.arrays, ssd, noise, squares)
    samples = compared_pixels(tree, level, nodes)
    children = np.diff(tree.child_starts[level])
    # Two of four children with half the energy each are evidence enough, or three quarters and
    # one quarter where there are only two children.
    enough = 3.0 / (children[np.stack([nodes.block_b, nodes.block_a])] + 2.0)
    evident = (squares <= enough).any(axis=1)
    evident |= nodes.energy == 0
    verdict = np.full(len(nodes), DIFFERS, np.int8)
    for outcome, share in ((AGREES, 1.0), (CLOSE, 1.0 / 16)):
        allowed = limits.allowed(noise / samples, samples, share)
        verdict[(ssd / samples <= allowed).all(axis=0)] = outcome
    verdict[~evident.all(axis=0)] = DIFFERS
    if tree.splits_views(level):
        verdict[:] = DIFFERS
    return verdict


def classify(
    tree: BlockTree,
    level: int,
    pieces: Pieces,
    chosen: NDArray[np.int64],
    settled: NDArray[np.bool_],
    above: Frontier,
    node: NDArray[np.int64],
    limits: Limits,
) -> Found:
    """Sort chosen pairs that a level measured into empty ones, leaves and unknown ones.

    `settled` ones, (n,), are no longer unknown in any case; `node`, (n,), is the number of each
    pair's node among those of the level above, none at level 0.
    """
    from rfpipe.methods.symmetric import kernels

    energy = np.empty((len(pieces.values), len(chosen)))
    clear = np.empty(energy.shape, np.bool_)
    pairs = pieces.pairs
    kernels.weigh_pairs(
        pairs, pieces.sums, pieces.doubt, chosen,
        limits.significance**2, limits.significant, energy, clear,
    )  # fmt: skip
    # of faint pairs more patterns would tell nothing, but their light adds up
    settled = settled | ~clear.any(axis=0)
    full: NDArray[np.bool_] = np.any(energy, axis=0)
    empty = len(full) - int(np.count_nonzero(full))
    chosen, node, settled = chosen[full], node[full], settled[full]
    energy = np.ascontiguousarray(energy[:, full])
    block_a, block_b = pairs.a[chosen], pairs.b[chosen]
    channels = len(energy)
    if level == tree.n_levels - 1:
        leaves = LeafSet(level, block_a, block_b, energy.astype(np.float32))
        return Found(leaves, no_nodes(channels), {"empty": empty, "scalar": len(leaves)})
    starts = tree.starts[level]
    layout, n_values = Pairs.of(starts, block_a, block_b)
    sources = np.stack([pairs.at_a[chosen], pairs.at_b[chosen]])
    spread = np.empty((channels, 2, len(chosen)))
    kernels.sum_pieces(starts, Pairs(block_a, block_b, *sources), pieces.variances, spread)
    nodes = Nodes(layout, np.empty((channels, n_values), np.float32), energy, spread)
    worst = np.empty((channels, len(block_a)))
    lit = np.empty_like(worst)
    kernels.take_pieces(
        Grid.of(tree, level), nodes, sources, pieces.values, pieces.variances,
        _profiles(tree, level, layout, above, node), above.pieces, limits.significance, worst, lit,
    )  # fmt: skip
    sizes = np.diff(starts)
    pixels = np.where(block_a == block_b, sizes[block_a], sizes[block_a] + sizes[block_b])
    noise = np.where(block_a == block_b, spread[:, 0], spread.sum(axis=1)) / pixels
    # The images of the children can't differ from their prediction by more than `worst`: where
    # that is within bounds the rank test is passed already, and no pattern is spent on it. A node
    # over a single ray is of rank 1 whatever it holds.
    lit = np.maximum(lit, 1.0)
    certain = (worst / lit <= limits.allowed(noise, lit)).all(axis=0)
    certain |= (sizes[block_a] == 1) | (sizes[block_b] == 1) | settled
    entries = Frontier(block_a, block_b, *nodes[1:])
    leaves = as_leaves(tree, level, select(tree, level, entries, certain))
    frontier = select(tree, level, entries, ~certain)
    return Found(leaves, frontier, {"empty": empty, "rank1": len(leaves)})


def _profiles(
    tree: BlockTree, level: int, pairs: Pairs, above: Frontier, node: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Find the pictures of two blocks among the factors of the nodes above; -1 where none are."""
    if not len(above):
        return np.full((2, len(pairs.a)), -1, np.int64)
    starts, finer = tree.starts[level - 1], tree.starts[level]
    outer = above.nodes(tree, level - 1).pairs
    return np.stack(
        [
            outer.at_a[node] + finer[pairs.a] - starts[outer.a[node]],
            outer.at_b[node] + finer[pairs.b] - starts[outer.b[node]],
        ]
    )
