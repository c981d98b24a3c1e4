"""Fit of the light of blocks to all pictures: sparse Bayesian regression for each camera pixel.

A pixel's radiance in picture p is a sum over the blocks k that may light it,

    c_p = sum_k A_pk t_k + noise

where A_pk is the mean of pattern p over block k, and t_k the radiance when the whole block is lit.
The light of a block is a normal variable with mean 0 and its own variance V_k, which is learned
from the pictures by expectation maximisation: the variances of blocks that explain no picture
vanish, so that few pictures determine the few blocks that light a pixel. Negative light counts as 0
[Tipping, *Sparse Bayesian learning and the relevance vector machine*, JMLR 2001].

Patterns of coarser levels divide no block of a finer level. A pattern of another method that
divides blocks tells less of them: where their light is within them is not known. Its picture has
that variance besides its noise.

Neighbouring camera pixels receive light from much the same blocks, by more than noise lets each
pixel tell: once learned, the variances of a pixel are replaced by their mean over the pixel and its
eight neighbours, from which they are learned further.

Colour channels share their blocks: variances are learned from the sum of the channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rfpipe.array_types import Blocks, Double, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.images import Pictures
from rfpipe.methods.multiplexed.blocks import BlockLevels, PixelBlocks
from rfpipe.ranges import ranges
from rfpipe.steps import step, steps

# Iterations before and after the mean over neighbours. Without it and with 8 iterations, errors are
# 14 to 21 % larger on `glass_and_ring` with 78 and 102 pictures, and 8 to 9 % on `bottle` with 106
# and 162. With more iterations sparse light takes fewer pictures and diffuse light more: 8 and 4
# change errors by -5 and +1 %, 4 and 4 by +15 % and 0.
_FIRST, _LAST = 6, 4
# Assumed error of the model, relative to the floodlit image. A third and three times the value
# change errors by less than 2 %.
_MODEL_ERROR = 1e-3
# Camera pixels that are fitted at a time.
_PIXELS = 4096


def fit_blocks(
    levels: BlockLevels, camera: RayDomain, blocks: PixelBlocks, pictures: Sequence[Pictures]
) -> PixelBlocks:
    """Fit the light of blocks to all pictures, the first of which is floodlit."""
    means = np.concatenate([levels.means(part.lit) for part in pictures])
    prior = np.square(blocks.expected, dtype=np.float64)
    light = np.zeros((pictures[0].radiance.shape[1], len(blocks.block)), np.float32)
    parts = ranges(camera.size, _PIXELS)
    with steps("blocks", 2 * len(parts)):
        for first, last in parts:
            part = _Part.of(blocks, means, pictures, first, last)
            part.fit(*part.grey, prior[part.entries], _FIRST)
            step()
        prior = mean_over_neighbours(levels, camera, blocks, prior)
        for first, last in parts:
            part = _Part.of(blocks, means, pictures, first, last)
            light[:, part.entries] = _fit_channels(part, prior[part.entries])
            step()
    return replace(blocks, light=light)


@dataclass(frozen=True)
class _Part:
    """Some camera pixels, with their blocks and pictures.

    Attributes
    ----------
    entries : slice
        Entries of the pixels in `PixelBlocks`.
    starts : ndarray of int64, shape (m + 1,)
        First of these entries of each of the m pixels, and their number.
    block : ndarray of int32, shape (n,)
    means : ndarray of float32, shape (P, blocks)
        A for all blocks.
    radiance, noise : ndarray of float64, shape (P, C, m)
        The pictures and the variance of their noise.
    """

    entries: slice
    starts: Index
    block: Blocks
    means: Float
    radiance: Double
    noise: Double

    @classmethod
    def of(
        cls, blocks: PixelBlocks, means: Float, pictures: Sequence[Pictures], first: int, last: int
    ) -> _Part:
        """Select the camera pixels ``first:last``."""
        entries = slice(blocks.starts[first], blocks.starts[last])
        radiance, noise = (
            np.concatenate([getattr(part, name)[..., first:last] for part in pictures])
            for name in ("radiance", "variance")
        )
        return cls(
            entries,
            blocks.starts[first : last + 1] - blocks.starts[first],
            blocks.block[entries],
            means,
            radiance.astype(np.float64),
            noise.astype(np.float64),
        )

    @property
    def grey(self) -> tuple[Double, Double]:
        """Sum of the channels' pictures and of their noise, (P, m) each."""
        return self.radiance.sum(axis=1), self.noise.sum(axis=1)

    def fit(self, image: Double, noise: Double, prior: Double, iterations: int) -> Float:
        """Fit the light (n,) to the pictures (P, m) of a channel; learn the variances `prior`."""
        from rfpipe.methods.multiplexed.kernels import PixelPictures, fit_pixels

        noise = noise + np.square(_MODEL_ERROR * image[0])
        pixels = PixelPictures(
            self.means, np.ascontiguousarray(image.T), np.ascontiguousarray(noise.T)
        )
        light = np.zeros(len(prior))
        fit_pixels(pixels, self.starts, self.block, prior, iterations, light)
        return np.maximum(light, 0).astype(np.float32)


def _fit_channels(part: _Part, prior: Double) -> Float:
    """Fit the light (C, n) of each channel, with the variances of the channels' sum."""
    grey, noise = part.grey
    light = part.fit(grey, noise, prior, _LAST)
    channels = part.radiance.shape[1]
    if channels == 1:
        return light[None]
    pixel, single = np.repeat(np.arange(grey.shape[1]), np.diff(part.starts)), []
    for channel in range(channels):
        image = part.radiance[:, channel]
        share = np.divide(image[0], grey[0], out=np.zeros_like(grey[0]), where=grey[0] > 0)
        single.append(part.fit(image, part.noise[:, channel], prior * share[pixel] ** 2, 1))
    return np.stack(single)


def mean_over_neighbours(
    levels: BlockLevels, camera: RayDomain, blocks: PixelBlocks, variance: Double
) -> Double:
    """Average variances (n,) over each camera pixel and its eight neighbours in the same view.

    The variance of a larger block of a neighbour is spread evenly over its rays.
    """
    from rfpipe.methods.multiplexed.kernels import BlockRanges, average_variances

    starts = [levels.tree.starts[level] for level in levels.levels]
    first, end = (
        np.concatenate([of_level[part] for of_level in starts])[blocks.block]
        for part in (slice(None, -1), slice(1, None))
    )
    return average_variances(BlockRanges(blocks.starts, first, end), variance, camera.stack_shape)
