"""Compiled kernels of symmetric photography for pixels that no image shows."""

from __future__ import annotations

import numba
import numpy as np

# How much more uncertain than the other a sum is that is known from the other alone.
_NO_WEIGHT = 1e12


@numba.njit(cache=True)
def _guess(piece, unknown):  # type: ignore[no-untyped-def]
    """Return mean and variance of a piece's known pixels; `unknown` others are zero in it."""
    known = piece.shape[0] - unknown
    if known == 0:
        return 0.0, 0.0
    total, squares = 0.0, 0.0
    for k in range(piece.shape[0]):
        total += np.float64(piece[k])
        squares += np.float64(piece[k]) * np.float64(piece[k])
    mean = total / known
    return mean, max(squares / known - mean * mean, 0.0)


@numba.njit(cache=True, parallel=True)
def complete_pieces(  # type: ignore[no-untyped-def]
    starts, block_a, block_b, offset_a, offset_b, unknown, values, sums, spread, doubt
):
    """Fill in pixels that no image shows, as far as the pair's other piece knows their light.

    By symmetry both pieces of a pair have one sum. What one lacks is what its unknown pixels
    have, beside noise: they are taken to be like the other pixels of the piece, and then moved by
    how uncertain that is in proportion to all that is uncertain. Where a block has no other pixels
    they have all that its partner sends; on the diagonal, where there is no partner, the mean.

    Parameters
    ----------
    starts, block_a, block_b, offset_a, offset_b, values
        As in `kernels.collect_pieces`; zero in unknown pixels, and filled in there.
    unknown : int64 (k,)
        Their tree positions, ascending.
    sums, spread : float64 (C, 2, n)
        Of the pieces, and of their variances; changed with them.
    doubt : float64 (C, 2, n)
        The spread; what remains uncertain of unknown pixels is added.
    """
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        first_a, last_a = np.searchsorted(unknown, starts[a : a + 2])
        first_b, last_b = np.searchsorted(unknown, starts[b : b + 2])
        count_a, count_b = last_a - first_a, last_b - first_b
        if count_a + count_b == 0:
            continue
        size_a, size_b = starts[a + 1] - starts[a], starts[b + 1] - starts[b]
        for c in range(values.shape[0]):
            piece_a = values[c, offset_a[n] : offset_a[n] + size_a]
            piece_b = values[c, offset_b[n] : offset_b[n] + size_b]
            light_a, variance_a = _guess(piece_a, count_a)
            light_b, variance_b = _guess(piece_b, count_b)
            if a != b:
                lacking = sums[c, 1, n] + count_b * light_b - sums[c, 0, n] - count_a * light_a
                doubt[c, 0, n] += count_a * variance_a
                doubt[c, 1, n] += count_b * variance_b
                total = doubt[c, 0, n] + doubt[c, 1, n]
                if size_a == count_a:
                    light_a = lacking / count_a
                    spread[c, 0, n] = spread[c, 1, n]
                    doubt[c, 0, n] = _NO_WEIGHT * doubt[c, 1, n]
                elif size_b == count_b:
                    light_b = -lacking / count_b
                    spread[c, 1, n] = spread[c, 0, n]
                    doubt[c, 1, n] = _NO_WEIGHT * doubt[c, 0, n]
                elif total > 0.0:
                    light_a += variance_a * lacking / total
                    light_b -= variance_b * lacking / total
            light_a, light_b = max(light_a, 0.0), max(light_b, 0.0)
            for k in range(first_a, last_a):
                piece_a[unknown[k] - starts[a]] = light_a
            for k in range(first_b, last_b):
                piece_b[unknown[k] - starts[b]] = light_a if a == b else light_b
            sums[c, 0, n] += count_a * light_a
            sums[c, 1, n] += count_a * light_a if a == b else count_b * light_b


@numba.njit(cache=True)
def unknown_difference(unknown, first, measured, factor, scale):  # type: ignore[no-untyped-def]
    """Sum the squared differences of a piece's unknown pixels from a factor.

    `first` is the tree position of its first pixel.
    """
    total = 0.0
    last = first + measured.shape[0]
    for k in range(np.searchsorted(unknown, first), np.searchsorted(unknown, last)):
        at = unknown[k] - first
        difference = measured[at] - factor[at] * scale
        total += np.float64(difference * difference)
    return total
