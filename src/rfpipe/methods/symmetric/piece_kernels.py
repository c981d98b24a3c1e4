"""Compiled kernels that measure the pieces of blocks (thesis §5.1, C.2).

Formulas use the symbols of `rfpipe.methods.symmetric`. Arguments are the named tuples of `nodes`
and `pieces`, with planar images and pieces in tree order: a piece is one run of values.

A parallel loop of numba takes no nested tuples, and loses what its own body writes to arrays of a
named tuple. Loops therefore write to arrays of their own, or by functions that they call.
"""

import numba
import numpy as np

from rfpipe.transport.hierarchical.kernels import summed

# Variance of a sum that is known from the pair's other sum alone, over that sum's variance.
_DEPENDENT_VARIANCE = 1e12


@numba.njit(cache=True, parallel=True)
def collect_pieces(starts, pairs, pattern_of_block, batch, values, variances):  # type: ignore[no-untyped-def]
    """Copy the pieces of a batch of residual images E to their pairs.

    ::

        x_ab = E[pattern of b] over a,    x_ba = E[pattern of a] over b

    Parameters
    ----------
    starts : int64 (n_blocks + 1,)
        First tree position of each block.
    pairs : Pairs
    pattern_of_block : int32 (n_blocks,)
        Pattern that lights each block, -1 for none.
    batch : ImageBatch
    values, variances : float32 (C, n_values)
        Written where a pattern of the batch lights the block.
    """
    for n in numba.prange(len(pairs.block_a)):
        a, b = pairs.block_a[n], pairs.block_b[n]
        _copy_piece(starts, a, pattern_of_block[b], batch, pairs.offset_a[n], values, variances)
        if a != b:
            _copy_piece(starts, b, pattern_of_block[a], batch, pairs.offset_b[n], values, variances)


@numba.njit(cache=True)
def _copy_piece(starts, block, pattern, batch, offset, values, variances):  # type: ignore[no-untyped-def]
    """Copy the part of a pattern's image over a block, if the pattern is in the batch."""
    image = pattern - batch.first
    if image < 0 or image >= len(batch.residuals):
        return
    start, end = starts[block], starts[block + 1]
    for c in range(len(values)):
        values[c, offset : offset + end - start] = batch.residuals[image, c, start:end]
        variances[c, offset : offset + end - start] = batch.variances[image, c, start:end]


@numba.njit(cache=True, parallel=True)
def piece_sums(starts, pairs, values):  # type: ignore[no-untyped-def]
    """Return ``sum(x_ab)`` and ``sum(x_ba)`` of each pair, float64 (C, 2, n)."""
    sums = np.empty((len(values), 2, len(pairs.block_a)))
    for n in numba.prange(len(pairs.block_a)):
        a, b = pairs.block_a[n], pairs.block_b[n]
        offset_a, offset_b = pairs.offset_a[n], pairs.offset_b[n]
        for c in range(len(values)):
            sums[c, 0, n] = summed(values[c, offset_a : offset_a + starts[a + 1] - starts[a]])
            sums[c, 1, n] = summed(values[c, offset_b : offset_b + starts[b + 1] - starts[b]])
    return sums


@numba.njit(cache=True, parallel=True)
def complete_pieces(starts, pieces):  # type: ignore[no-untyped-def]
    """Estimate the masked pixels of pieces from their known pixels and from symmetry.

    The k_a masked pixels of piece x_ab get one value h_a. It starts as the mean of the piece's
    known pixels, and their variance v_a is its variance. By symmetry both pieces have the same sum;
    weighted least squares distributes the difference delta of the sums over h_a and h_b::

        delta = sum(x_ba) + k_b h_b - sum(x_ab) - k_a h_a
        S     = V_a + k_a v_a + V_b + k_b v_b
        h_a += v_a delta / S,    h_b -= v_b delta / S

    V_a and V_b are the variances of the sums over known pixels. A piece without known pixels gets
    the sum of the pair's other piece; on the diagonal, where the two pieces are one, h_a stays the
    mean. Values are 0 in masked pixels on entry; values, sums and variances of sums are changed in
    place.
    """
    for n in numba.prange(len(pieces.block_a)):
        _complete_pair(starts, pieces, n)


@numba.njit(cache=True)
def _complete_pair(starts, pieces, n):  # type: ignore[no-untyped-def]
    """Estimate the masked pixels of the two pieces of one pair; see `complete_pieces`."""
    a, b, masked = pieces.block_a[n], pieces.block_b[n], pieces.masked
    first_a, last_a = np.searchsorted(masked, starts[a : a + 2])
    first_b, last_b = np.searchsorted(masked, starts[b : b + 2])
    counts = last_a - first_a, last_b - first_b
    if counts[0] + counts[1] == 0:
        return
    sizes = starts[a + 1] - starts[a], starts[b + 1] - starts[b]
    for c in range(len(pieces.values)):
        h_a, h_b = _masked_values(pieces, c, n, sizes, counts)
        for pixel in masked[first_a:last_a]:
            pieces.values[c, pieces.offset_a[n] + pixel - starts[a]] = h_a
        for pixel in masked[first_b:last_b]:
            pieces.values[c, pieces.offset_b[n] + pixel - starts[b]] = h_b
        pieces.sums[c, 0, n] += counts[0] * h_a
        pieces.sums[c, 1, n] += counts[1] * h_b


@numba.njit(cache=True)
def _masked_values(pieces, c, n, sizes, counts):  # type: ignore[no-untyped-def]
    """Return ``h_a`` and ``h_b`` of a pair, 0 or more; see `complete_pieces`."""
    values = pieces.values
    offset_a, offset_b = pieces.offset_a[n], pieces.offset_b[n]
    h_a, v_a = _known_moments(values[c, offset_a : offset_a + sizes[0]], counts[0])
    if pieces.block_a[n] == pieces.block_b[n]:
        return max(h_a, 0.0), max(h_a, 0.0)
    h_b, v_b = _known_moments(values[c, offset_b : offset_b + sizes[1]], counts[1])
    sums, noise, variance = pieces.sums[c], pieces.noise_variance[c], pieces.variance[c]
    difference = sums[1, n] + counts[1] * h_b - sums[0, n] - counts[0] * h_a
    variance[0, n] += counts[0] * v_a
    variance[1, n] += counts[1] * v_b
    total = variance[0, n] + variance[1, n]
    if sizes[0] == counts[0]:
        h_a = difference / counts[0]
        noise[0, n] = noise[1, n]
        variance[0, n] = _DEPENDENT_VARIANCE * variance[1, n]
    elif sizes[1] == counts[1]:
        h_b = -difference / counts[1]
        noise[1, n] = noise[0, n]
        variance[1, n] = _DEPENDENT_VARIANCE * variance[0, n]
    elif total > 0.0:
        h_a += v_a * difference / total
        h_b -= v_b * difference / total
    return max(h_a, 0.0), max(h_b, 0.0)


@numba.njit(cache=True)
def _known_moments(piece, n_masked):  # type: ignore[no-untyped-def]
    """Return mean and variance of a piece's known pixels; its masked pixels are 0."""
    known = piece.shape[0] - n_masked
    if known == 0:
        return 0.0, 0.0
    total, squares = 0.0, 0.0
    for k in range(piece.shape[0]):
        total += np.float64(piece[k])
        squares += np.float64(piece[k]) * np.float64(piece[k])
    mean = total / known
    return mean, max(squares / known - mean * mean, 0.0)
