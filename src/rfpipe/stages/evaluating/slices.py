"""One line of the transport matrix, and where in the hierarchy it is held [thesis Fig. 2.1]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.transport import Transport
from rfpipe.transport.hierarchical.transport import HierarchicalTransport
from rfpipe.transport.multilevel.transport import MultilevelTransport

__all__ = ["NO_LEAF", "leaf_levels", "line_patterns"]

NO_LEAF = -1
"""Level of an entry that no leaf holds: it was measured as empty."""


def line_patterns(shape: tuple[int, ...], row: int, columns: Sequence[int]) -> NDArray[np.float32]:
    """Return a single-pixel pattern for each of some pixels of an image's row, ``(P, H, W)``."""
    patterns = np.zeros((len(columns), *shape), np.float32)
    patterns[np.arange(len(columns)), row, columns] = 1
    return patterns


def leaf_levels(
    transport: Transport, camera_row: int, projector_row: int
) -> NDArray[np.int16] | None:
    """Tell the level of the leaf that holds each entry between the rays of two image rows.

    Parameters
    ----------
    transport : Transport
        Over images (H, W).
    camera_row, projector_row : int
        Rows of the camera's and the projector's image, from 0; one row in a hierarchy of leaves,
        whose rig is coaxial.

    Returns
    -------
    ndarray of int16, shape (W, W'), or None
        Camera rays down, projector rays across; `NO_LEAF` where the entry is empty. None for a
        transport without leaves.
    """
    shape = tuple(
        RayDomain(rays).image_shape[1]
        for rays in (transport.camera_shape, transport.projector_shape)
    )
    levels = np.full(shape, NO_LEAF, np.int16)
    if isinstance(transport, HierarchicalTransport):
        for leaves in transport.leaf_sets:
            number, of_ray = _blocks_of_line(transport.tree, leaves.level, projector_row)
            first, second = number[leaves.block_a], number[leaves.block_b]
            inside = (first >= 0) & (second >= 0)
            held = np.zeros(shape, np.bool_)
            held[first[inside], second[inside]] = held[second[inside], first[inside]] = True
            levels[held[np.ix_(of_ray, of_ray)]] = leaves.level
        return levels
    if isinstance(transport, MultilevelTransport):
        for pairs in transport.pair_sets:
            number, of_ray = _blocks_of_line(transport.tree, pairs.level, projector_row)
            block, pixel = number[pairs.block], pairs.pixel - camera_row * shape[0]
            inside = (block >= 0) & (pixel >= 0) & (pixel < shape[0])
            held = np.zeros(shape, np.bool_)
            held[pixel[inside], block[inside]] = True
            levels[held[:, of_ray]] = pairs.level
        return levels
    return None


def _blocks_of_line(
    tree: BlockTree, level: int, row: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number a level's blocks along an image row from 0.

    Returns the number of each block, -1 for those elsewhere, and that of each of the row's rays.
    """
    blocks = tree.labels(level)[row]
    present, of_ray = np.unique(blocks, return_inverse=True)
    number = np.full(tree.n_blocks(level), -1, np.int64)
    number[present] = np.arange(len(present))
    return number, of_ray
