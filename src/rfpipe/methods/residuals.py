"""What a level's images hold beside the light that is known already (thesis §5.1, C.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rfpipe.blocks import BlockTree
from rfpipe.methods.base import LevelImages
from rfpipe.methods.nodes import Blocks, Float
from rfpipe.transport.hierarchical import LeafSet, apply_leaf_sets

# Images predicted and subtracted at a time.
_BATCH = 16


@dataclass(frozen=True)
class Measured:
    """What a level measured: images with the known light taken out, in tree order.

    Attributes
    ----------
    residuals, variances : ndarray of float32, shape (P, C, N)
        The variance includes the rounding of the images to float32.
    pattern_of_block : ndarray of int32
        Pattern that lit each block of the level, -1 for none.
    """

    residuals: Float
    variances: Float
    pattern_of_block: Blocks


def measure(
    tree: BlockTree, known: Sequence[LeafSet], channels: int, images: LevelImages
) -> Measured:
    """Subtract the known leaves' prediction from a level's images.

    Parameters
    ----------
    tree : BlockTree
    known : sequence of LeafSet
        Leaves found so far.
    channels : int
    images : LevelImages
        Of a schedule that is a partition of the rays.
    """
    schedule = images.schedule
    shape = (schedule.count, channels, tree.domain.size)
    residuals, variances = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for first in range(0, schedule.count, _BATCH):
        last = min(first + _BATCH, schedule.count)
        radiance, variance = (_planar(part, tree, channels) for part in images.read(first, last))
        lit = schedule.batch(first, last).reshape(last - first, 1, -1)[..., tree.order]
        patterns = np.broadcast_to(lit, radiance.shape)
        predicted = apply_leaf_sets(tree, known, patterns, range(channels))
        residuals[first:last] = radiance - predicted
        rounding = np.finfo(np.float32).eps * radiance
        variances[first:last] = variance + rounding * rounding
    return Measured(residuals, variances, schedule.pattern_of_block(tree))


def _planar(image: Float, tree: BlockTree, channels: int) -> Float:
    rays = image.reshape(len(image), tree.domain.size, channels)[:, tree.order]
    return np.ascontiguousarray(np.moveaxis(rays, 2, 1))
