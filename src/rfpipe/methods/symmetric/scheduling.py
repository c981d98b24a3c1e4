"""Patterns of a level by colouring the square of the graph of unknown transport (thesis §5.1).

Blocks i and j can be lit together if and only if for every block k the light between i and k or
that between j and k is known (Lemma 1, Block Scheduling Lemma). They can't be lit together if both
are unknown for some k (Lemma 2). Let ``G`` be the graph with an edge between each two blocks whose
light is unknown. The light from a block onto itself always counts as unknown, so that k may be i
or j. Therefore two blocks that are at most two edges apart can't be lit together. Such pairs are
the edges of the square ``G^2``. A colouring of ``G^2`` gives the patterns, one per colour.
"""

from __future__ import annotations

import numpy as np

from rfpipe.array_types import Bools
from rfpipe.blocks import BlockTree
from rfpipe.conflicts import colour_square, conflict_graph
from rfpipe.methods.symmetric.nodes import EstimatedNodes, child_blocks
from rfpipe.patterns import Schedule


def schedule_children(
    tree: BlockTree, level: int, nodes: EstimatedNodes, unseen: Bools
) -> Schedule:
    """Return the patterns of `level`, which measure the children of unknown nodes.

    Parameters
    ----------
    tree : BlockTree
    level : int
        At least 1.
    nodes : EstimatedNodes
        Unknown nodes of the level above, at least one.
    unseen : ndarray of bool, shape (N,)
        Rays, in tree order, without light in the floodlit image.
    """
    block_a, block_b = child_blocks(tree, level - 1, nodes)
    scheduled = np.zeros(tree.n_blocks(level), np.bool_)
    scheduled[block_a] = scheduled[block_b] = True
    number = np.cumsum(scheduled, dtype=np.int32) - 1
    graph = conflict_graph(int(number[-1]) + 1, number[block_a], number[block_b])
    del block_a, block_b
    pattern_of_block = np.full(tree.n_blocks(level), -1, np.int32)
    pattern_of_block[scheduled] = colour_square(graph)
    lit = pattern_of_block[tree.block_of_position(level)] >= 0
    return Schedule.of_blocks(tree, level, pattern_of_block, bool((lit | unseen).all()))
