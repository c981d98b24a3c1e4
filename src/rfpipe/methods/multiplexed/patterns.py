"""Random patterns of multiplexed dual photography.

The fewer blocks a pattern lights, the less noise the light of all others adds to its picture, but
the fewer pictures there are of each block.
"""

from __future__ import annotations

import numpy as np

from rfpipe.array_types import Bools
from rfpipe.methods.multiplexed.blocks import BlockLevels
from rfpipe.provenance import generator

_SEED = 2005

# Patterns of the first round of a level that light a block, on average. A half of them light each
# single ray: on 17 of 20 random mirrors, 16 patterns of random quarters tell all rays apart, and on
# all 20 those of random halves.
_TIMES_LIT = 4
# Of so many draws, the patterns that tell the blocks of a level best apart are shown, up to this
# number of blocks. One draw of 8 patterns lights two of 16 blocks alike in every second case.
_DRAWS, _MOST_BLOCKS = 20, 256
# Share of the rays that every second pattern of a further round lights, as many as the others do.
# With an eighth errors are the same; with a half of the rays in all patterns of all levels, as once
# was, `glass_and_ring` took 299 pictures for 0.5 % in place of 178.
_FEW_RAYS = 1 / 4


def first_patterns(levels: BlockLevels, index: int, key: int, count: int) -> Bools:
    """Draw the patterns of the first round of a level.

    Parameters
    ----------
    levels : BlockLevels
    index : int
        Of the level in ``levels.levels``.
    key : int
        Number of the round, from which the random numbers are drawn.
    count : int

    Returns
    -------
    ndarray of bool, shape (count, blocks of the level)
        The blocks that each pattern lights.
    """
    random, is_of_rays = generator(_SEED, key), index == len(levels) - 1
    blocks = levels.tree.n_blocks(levels.levels[index])
    share = 0.5 if is_of_rays else min(_TIMES_LIT / count, 0.5)
    if blocks > _MOST_BLOCKS:
        return random.random((count, blocks)) < share
    draws = (random.random((count, blocks)) < share for _ in range(_DRAWS))
    return max(draws, key=_least_distance)


def _least_distance(lit: Bools) -> float:
    """Count the patterns that light only one of two blocks, for the two that are most alike."""
    weights = lit.astype(np.float64)
    times_lit = weights.sum(axis=0)
    distance = times_lit[:, None] + times_lit - 2 * weights.T @ weights
    np.fill_diagonal(distance, np.inf)
    return float(distance.min())


def further_patterns(levels: BlockLevels, index: int, key: int, count: int) -> Bools:
    """Draw the patterns of a further round of single rays; see `first_patterns`.

    In turn a pattern lights a quarter of all rays, and a half of the rays within a half of the
    blocks of a coarser level: the former determine the light of single rays, the latter diffuse
    light.
    """
    random, tree = generator(_SEED, key), levels.tree
    lit = random.random((count, tree.n_blocks(levels.levels[index]))) < _FEW_RAYS
    for number, pattern in enumerate(range(1, count, 2)):
        lit[pattern] = random.random(lit.shape[1]) < 0.5
        if index:
            coarser = levels.levels[index - 1 - number % index]
            is_lit = random.random(tree.n_blocks(coarser)) < 0.5
            lit[pattern] &= is_lit[tree.block_of_position(coarser)]
    return lit
