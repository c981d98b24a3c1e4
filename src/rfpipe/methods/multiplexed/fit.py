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

Colour channels share their blocks: variances are learned from the sum of the channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rfpipe.array_types import Double, Float
from rfpipe.methods.images import Pictures
from rfpipe.methods.multiplexed.blocks import BlockLevels, PixelBlocks
from rfpipe.ranges import ranges
from rfpipe.steps import step, steps

# More iterations find sparse light with fewer pictures, but lose diffuse light. For 1 %, 8 take 83
# patterns on a mirror and 10 take 97; on `glass_and_ring` 6 take 271 and 10 take 115.
_ITERATIONS = 8
# Assumed error of the model, relative to the floodlit image. A third and three times the value
# change errors by less than 2 %.
_MODEL_ERROR = 1e-3
# Camera pixels that are fitted at a time.
_PIXELS = 4096


def fit_blocks(
    levels: BlockLevels, blocks: PixelBlocks, pictures: Sequence[Pictures]
) -> PixelBlocks:
    """Fit the light of blocks to all pictures, the first of which is floodlit."""
    means = np.concatenate([levels.means(part.lit) for part in pictures])
    channels, pixels = pictures[0].radiance.shape[1:]
    light = np.zeros((channels, len(blocks.block)), np.float32)
    parts = ranges(pixels, _PIXELS)
    with steps("blocks", len(parts)):
        for first, last in parts:
            entries = slice(blocks.starts[first], blocks.starts[last])
            starts = blocks.starts[first : last + 1] - blocks.starts[first]
            light[:, entries] = _fit_part(
                means,
                PixelBlocks(
                    starts, blocks.block[entries], blocks.expected[entries], light[:, entries]
                ),
                [_of_pixels(part, slice(first, last)) for part in pictures],
            )
            step()
    return replace(blocks, light=light)


def _of_pixels(pictures: Pictures, pixels: slice) -> Pictures:
    return Pictures(pictures.lit, pictures.radiance[..., pixels], pictures.variance[..., pixels])


def _fit_part(means: Float, blocks: PixelBlocks, pictures: Sequence[Pictures]) -> Float:
    """Fit the light (C, n) of some camera pixels."""
    from rfpipe.methods.multiplexed.kernels import PixelPictures, fit_pixels

    radiance, variance = (
        np.concatenate([getattr(part, name) for part in pictures]).astype(np.float64)
        for name in ("radiance", "variance")
    )
    grey, grey_noise = radiance.sum(axis=1), variance.sum(axis=1)
    prior = np.square(blocks.expected, dtype=np.float64)
    fitted = np.zeros(len(prior))

    def fit(image: Double, noise: Double, prior: Double, iterations: int) -> Float:
        noise = noise + np.square(_MODEL_ERROR * image[0])
        by_pixel = np.ascontiguousarray(image.T), np.ascontiguousarray(noise.T)
        pixels = PixelPictures(means, *by_pixel)
        fit_pixels(pixels, blocks.starts, blocks.block, prior, iterations, fitted)
        return np.maximum(fitted, 0).astype(np.float32)

    light = fit(grey, grey_noise, prior, _ITERATIONS)
    channels = radiance.shape[1]
    if channels == 1:
        return light[None]
    single = []
    for channel in range(channels):
        image = radiance[:, channel]
        share = np.divide(image[0], grey[0], out=np.zeros_like(grey[0]), where=grey[0] > 0)
        scaled = prior * np.square(share[blocks.pixel])
        single.append(fit(image, variance[:, channel], scaled, 1))
    return np.stack(single)
