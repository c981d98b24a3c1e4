"""What leaves make of patterns that share out the blocks of a level among them.

Each ray is lit in one pattern at most, so that a leaf's factor is read once for many patterns, and
nothing is added where a pattern leaves a block dark.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.base import Float
from rfpipe.transport.leaves import LeafSet, factor_offsets

__all__ = ["predict"]


def predict(
    tree: BlockTree,
    leaf_sets: Sequence[LeafSet],
    level: int,
    pattern_of_block: NDArray[np.int32],
    first: int,
    last: int,
    channels: int,
) -> Float:
    """Return the images of some patterns of a level's schedule, by the leaves alone.

    Parameters
    ----------
    tree : BlockTree
    leaf_sets : sequence of LeafSet
        Of any levels.
    level : int
        Whose blocks the patterns are made of.
    pattern_of_block : ndarray of int32
        Pattern that lights each of them, -1 for none.
    first, last : int
        The patterns wanted, from `first` to before `last`.
    channels : int

    Returns
    -------
    ndarray of float32, shape (last - first, channels, N)
        In tree order. The images don't depend on which of them are asked for together.
    """
    from rfpipe.transport import partition_kernels as kernels

    images = np.zeros((last - first, channels, tree.domain.size), np.float32)
    pattern_of_part = pattern_of_block - np.int32(first)
    pattern_of_part[pattern_of_block < 0] = -1
    part_starts = tree.starts[level]
    for leaves in leaf_sets:
        if not len(leaves):
            continue
        if leaves.level == tree.n_levels - 1:
            pattern_of_ray = np.repeat(pattern_of_part, np.diff(part_starts))
            kernels.scalars_to_partition(
                leaves.block_a, leaves.block_b, leaves.values, pattern_of_ray, images
            )
            continue
        starts = tree.starts[leaves.level]
        parts = np.stack(
            [
                np.searchsorted(part_starts, starts[:-1], side="right") - 1,
                np.searchsorted(part_starts, starts[1:], side="left"),
            ],
            axis=1,
        )
        offset_a, offset_b, _ = factor_offsets(starts, leaves.block_a, leaves.block_b)
        kernels.apply_to_partition(
            starts, leaves.block_a, leaves.block_b, offset_a, offset_b, leaves.values, parts,
            part_starts, pattern_of_part, images,
        )  # fmt: skip
    return images
