"""Compiled kernels for the children of nodes that don't become leaves (thesis §5.1, C.2).

Formulas use the symbols of `rfpipe.methods.symmetric`. Arguments are the named tuples of `nodes`
and `pieces`, with planar images and pieces in tree order: a piece is one run of values.

A parallel loop of numba takes no nested tuples, and loses what its own body writes to arrays of a
named tuple. Loops therefore write to arrays of their own, or by functions that they call.
"""

import numba
import numpy as np

from rfpipe.methods.symmetric.rank_test_kernels import energy_shares, squared_difference
from rfpipe.transport.hierarchical.kernels import dot, summed


@numba.njit(cache=True, parallel=True)
def reconcile(blocks, nodes, first_pair, pieces):  # type: ignore[no-untyped-def]
    """Adjust the children's pieces so that they add up to the pieces of their node.

    The node's piece is an earlier measurement of the sum of its children's pieces. Weighted least
    squares joins both, at each pixel of child i; N_a is the number of rays of block a::

        s_ij = var(x_ij),    S = sum(var(x_ab)) / N_a + sum_j s_ij
        x_ij += s_ij / S (x_ab[i] - sum_j x_ij),    var(x_ij) = s_ij (1 - s_ij / S)

    Values and variances of the pieces are changed in place. The arguments are the parts of
    `Subdivision`.
    """
    for n in numba.prange(len(nodes.block_a)):
        _reconcile_side(blocks, nodes, first_pair, pieces, n, 0)
        if nodes.block_a[n] != nodes.block_b[n]:
            _reconcile_side(blocks, nodes, first_pair, pieces, n, 1)


@numba.njit(cache=True)
def _reconcile_side(blocks, nodes, first_pair, pieces, n, side):  # type: ignore[no-untyped-def]
    """Reconcile the pieces over the children of block a (side 0) or b (side 1) of node n."""
    block = nodes.block_a[n] if side == 0 else nodes.block_b[n]
    offset = nodes.offset_a[n] if side == 0 else nodes.offset_b[n]
    start, pixels = blocks.starts[block], blocks.starts[block + 1] - blocks.starts[block]
    offsets = np.empty(2 * (first_pair[n + 1] - first_pair[n]), np.int64)
    for child in range(blocks.first_child[block], blocks.first_child[block + 1]):
        count = _list_pieces(nodes, first_pair, pieces, n, side, child, offsets)
        begin, end = blocks.child_starts[child] - start, blocks.child_starts[child + 1] - start
        for c in range(len(pieces.values)):
            _reconcile_block(
                pieces.values[c], pieces.variances[c], offsets[:count],
                nodes.pieces[c, offset + begin : offset + end],
                nodes.variance[c, side, n] / pixels,
            )  # fmt: skip


@numba.njit(cache=True)
def _list_pieces(nodes, first_pair, pieces, n, side, child, offsets):  # type: ignore[no-untyped-def]
    """Write the offsets of the pieces over a child of node n's side 0 (a) or 1 (b); count them."""
    diagonal = nodes.block_a[n] == nodes.block_b[n]
    count = 0
    for pair in range(first_pair[n], first_pair[n + 1]):
        if pieces.block_a[pair] == child and (side == 0 or diagonal):
            offsets[count] = pieces.offset_a[pair]
            count += 1
        elif pieces.block_b[pair] == child and (side == 1 or diagonal):
            offsets[count] = pieces.offset_b[pair]
            count += 1
    return count


@numba.njit(cache=True)
def _reconcile_block(values, variances, offsets, target, noise):  # type: ignore[no-untyped-def]
    """Adjust pieces at `offsets` so that they add up to `target`, whose variance is `noise`."""
    for k in range(len(target)):
        total, variance = np.float64(0.0), noise
        for offset in offsets:
            total += values[offset + k]
            variance += variances[offset + k]
        if variance <= 0.0:
            continue
        correction = np.float32((target[k] - total) / variance)
        for offset in offsets:
            part = variances[offset + k]
            values[offset + k] += correction * part
            variances[offset + k] = part * np.float32(1.0 - part / variance)


@numba.njit(cache=True, parallel=True)
def pair_energies(pieces, chosen, least, significant):  # type: ignore[no-untyped-def]
    """Estimate ``m`` of chosen pairs from both sums, and test it against its noise.

    ::

        m = beta sum(x_ab) + (1 - beta) sum(x_ba),    beta = V_b / (V_a + V_b)
        var(m) = beta^2 V_a + (1 - beta)^2 V_b

    V_a and V_b are the variances of the two sums. On the diagonal both sums are the same.

    Parameters
    ----------
    pieces : Pieces
    chosen : int64 (n,)
        Numbers of pairs.
    least, significant : float
        Thresholds of ``m^2 / var(m)``.

    Returns
    -------
    energy : float64 (C, n)
        ``m``; 0 where it is negative or at most `least`.
    is_significant : bool (C, n)
        Whether ``m`` exceeds `significant`.
    """
    shape = len(pieces.values), len(chosen)
    energy, is_significant = np.empty(shape), np.empty(shape, np.bool_)
    for n in numba.prange(len(chosen)):
        pair = chosen[n]
        diagonal = pieces.block_a[pair] == pieces.block_b[pair]
        for c in range(len(pieces.values)):
            v_a, v_b = pieces.variance[c, 0, pair], pieces.variance[c, 1, pair]
            beta = v_b / (v_a + v_b) if v_a + v_b > 0.0 else 0.5
            if diagonal:
                beta, v_b = 1.0, 0.0
            m = beta * pieces.sums[c, 0, pair] + (1.0 - beta) * pieces.sums[c, 1, pair]
            variance = beta * beta * v_a + (1.0 - beta) * (1.0 - beta) * v_b
            square = m * m if m > 0.0 else 0.0
            energy[c, n] = m if square > least * variance else 0.0
            is_significant[c, n] = square > significant * variance
    return energy, is_significant


@numba.njit(cache=True, parallel=True)
def estimate_pieces(blocks, nodes, measured, profiles, significance):  # type: ignore[no-untyped-def]
    """Estimate the pieces of nodes from their measured pieces, and bound their rank test.

    The estimates are shrunk towards the pieces of the nodes above (`_denoise`), not negative, and
    scaled to the energy m; 0 where m is 0. A non-negative transport with these pieces splits each
    of them among the children of the other block in some way. The ssd of `compare_children` is
    largest if all light comes from the child with the smallest energy share::

        bound = |x_ab|^2 (1 - 2 min_j w_j + sum_j w_j^2) + |x_ba|^2 (1 - 2 min_i w_i + sum_i w_i^2)

    Parameters
    ----------
    blocks : LevelBlocks
    nodes : NodeArrays
        Their pieces are written.
    measured : MeasuredPieces
    profiles : Profiles
    significance : float
        Standard deviations above which a single pixel's difference is light.

    Returns
    -------
    bound : float64 (C, n)
    pixels : float64 (C, n)
        Effective number of pixels that the sum is over: the participation number ``m^2 / |x|^2`` of
        each piece, times the children of the other block. One bright pixel in a dark block counts
        as one pixel.
    """
    starts = blocks.starts
    bound, pixels = np.empty(nodes.energy.shape), np.empty(nodes.energy.shape)
    for n in numba.prange(len(nodes.block_a)):
        a, b = nodes.block_a[n], nodes.block_b[n]
        offset_a, offset_b = nodes.offset_a[n], nodes.offset_b[n]
        for c in range(len(nodes.pieces)):
            m = nodes.energy[c, n]
            piece_a = nodes.pieces[c, offset_a : offset_a + starts[a + 1] - starts[a]]
            piece_b = nodes.pieces[c, offset_b : offset_b + starts[b + 1] - starts[b]]
            _denoise(measured, profiles, c, 0, n, significance, piece_a)
            _scale(piece_a, m)
            if a != b:
                _denoise(measured, profiles, c, 1, n, significance, piece_b)
                _scale(piece_b, m)
            bound[c, n], pixels[c, n] = _bound(piece_a, piece_b, m, b, blocks)
            if a != b:
                more, more_pixels = _bound(piece_b, piece_a, m, a, blocks)
                bound[c, n] += more
                pixels[c, n] += more_pixels
    return bound, pixels


@numba.njit(cache=True)
def _denoise(measured, profiles, c, side, n, significance, target):  # type: ignore[no-untyped-def]
    """Write a node's piece x (side 0: x_ab, 1: x_ba), shrunk towards the piece of the node above.

    Both pieces are light that one surface receives, and the piece q of the node above has less
    noise. Positive-part James-Stein shrinkage of x towards g, which is q scaled to the sum of x::

        g = q sum(x) / sum(q),    e = x - g
        alpha_y = max(1 - sum(var(x)) / |e|^2, 1 - t^2 var(x_y) / e_y^2, 0)
        result_y = max(g_y + alpha_y e_y, 0)

    The first term of alpha is the James-Stein weight of the whole piece. The second, of a single
    pixel y, keeps most of a difference far beyond t = `significance` standard deviations, such as a
    highlight.
    Without a node above the result is ``max(x, 0)``.
    """
    start, size = measured.offsets[side, n], len(target)
    piece, variance = measured.values[c, start : start + size], measured.variances[c]
    first = profiles.offsets[side, n]
    profile = profiles.pieces[c, first : first + (size if first >= 0 else 0)]
    light, profile_light = summed(piece), summed(profile)
    if light <= 0.0 or profile_light <= 0.0:
        for k in range(size):
            target[k] = max(piece[k], np.float32(0))
        return
    scale = np.float32(light / profile_light)
    squares = squared_difference(piece, profile, scale)
    noise = summed(variance[start : start + size])
    weight = max(0.0, 1.0 - noise / squares) if squares > 0.0 else 0.0
    for k in range(size):
        scaled = profile[k] * scale
        difference = piece[k] - scaled
        square = difference * difference
        threshold = significance * significance * variance[start + k]
        alpha = max(weight, 1.0 - threshold / square) if square > threshold else weight
        target[k] = max(scaled + np.float32(alpha) * difference, np.float32(0))


@numba.njit(cache=True)
def _scale(piece, energy):  # type: ignore[no-untyped-def]
    """Scale a piece so that its sum is the energy; 0 where either of them is."""
    total = summed(piece)
    scale = np.float32(energy / total) if total > 0.0 and energy > 0.0 else np.float32(0)
    for k in range(piece.shape[0]):
        piece[k] *= scale


@numba.njit(cache=True)
def _bound(piece, partner, energy, block, blocks):  # type: ignore[no-untyped-def]
    """Return a piece's term of the bound of `estimate_pieces`, and its effective number of pixels.

    `partner` is the node's other piece, over `block`, and gives the energy shares.
    """
    square = dot(piece, piece)
    shares, squares = energy_shares(partner, energy, block, blocks)
    pixels = energy * energy / square * len(shares) if square > 0.0 else 0.0
    return square * (1.0 - 2.0 * shares.min() + squares), pixels
