"""Compiled kernels of the multilevel transport: sparse (block, pixel) values, many images at once.

Images are planar, one plane a pattern and channel. Each plane is summed by one thread in the
order of the pairs, so that results are the same on every machine.
"""

from __future__ import annotations

import numba


@numba.njit(cache=True, parallel=True)
def scatter_to_pixels(block, pixel, values, weights, out):  # type: ignore[no-untyped-def]
    """Add ``values * weights[block]`` to the pixels.

    Parameters
    ----------
    block, pixel : int32 (n,)
    values : float32 (K, n)
    weights : float64 (P, K, n_blocks)
    out : float64 (P, K, pixels)
        Added to in place.
    """
    channels = values.shape[0]
    for plane in numba.prange(weights.shape[0] * channels):
        p, c = plane // channels, plane % channels
        source, target = weights[p, c], out[p, c]
        for n in range(block.shape[0]):
            target[pixel[n]] += values[c, n] * source[block[n]]


@numba.njit(cache=True, parallel=True)
def gather_to_blocks(block, pixel, values, images, out):  # type: ignore[no-untyped-def]
    """Add ``values * images[pixel]`` to the blocks: the transpose of `scatter_to_pixels`.

    Parameters
    ----------
    block, pixel : int32 (n,)
        Ordered by block, so that a block's sum stays in a register.
    values : float32 (K, n)
    images : float32 (P, K, pixels)
    out : float64 (P, K, n_blocks)
        Added to in place.
    """
    channels = values.shape[0]
    for plane in numba.prange(images.shape[0] * channels):
        p, c = plane // channels, plane % channels
        source, target = images[p, c], out[p, c]
        n = 0
        while n < block.shape[0]:
            current = block[n]
            total = 0.0
            while n < block.shape[0] and block[n] == current:
                total += values[c, n] * source[pixel[n]]
                n += 1
            target[current] += total
