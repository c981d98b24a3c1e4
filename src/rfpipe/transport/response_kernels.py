"""Compiled products of sparse matrices of responses, (block, pixel) -> value, with many images.

Images are planar, one plane for each pattern and channel. Each plane is summed by one thread in the
order of the responses, so that results don't depend on the number of threads.
"""

from __future__ import annotations

import numba


@numba.njit(cache=True, parallel=True)
def scatter_to_pixels(block, pixel, values, weights, out):  # type: ignore[no-untyped-def]
    """Add the products of a level's matrix: ``out[pixel] += values weights[block]``.

    Parameters
    ----------
    block, pixel : int32 (n,)
    values : float32 (K, n)
    weights : float64 (P, K, n_blocks)
    out : float64 (P, K, pixels)
        Changed in place.
    """
    channels = values.shape[0]
    for plane in numba.prange(weights.shape[0] * channels):
        p, c = plane // channels, plane % channels
        source, target = weights[p, c], out[p, c]
        for n in range(block.shape[0]):
            target[pixel[n]] += values[c, n] * source[block[n]]


@numba.njit(cache=True, parallel=True)
def gather_to_blocks(block, pixel, values, images, out):  # type: ignore[no-untyped-def]
    """Add the products of the transpose: ``out[block] += values images[pixel]``.

    Responses are ordered by block, so that the sum of a block stays in a register. `images` are
    (P, K, pixels), `out` is float64 (P, K, n_blocks); other arguments as `scatter_to_pixels`.
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
