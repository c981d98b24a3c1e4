"""Compiled kernels of symmetric photography (thesis §5.1, C.2).

Formulas use the symbols of `rfpipe.methods.symmetric`: ``x_ab`` is piece (a, b), the light that
block a receives while block b is lit. Images and pieces are planar and in tree order, so that a
piece is one run of values. Arguments are the named tuples of `nodes` and `pieces`.

A parallel loop of numba takes no nested tuples, and loses what its own body writes to arrays of a
named tuple. The loops below therefore write to arrays of their own, or by functions that they call.
"""

import numba
import numpy as np

from rfpipe.transport.hierarchical.kernels import dot, summed

_FAST = {"reassoc", "contract", "nsz", "arcp"}
# Variance of a sum that is known from the pair's other sum alone, over that sum's variance.
_DEPENDENT_VARIANCE = 1e12


@numba.njit(cache=True, fastmath=_FAST)
def _squared_difference(measured, piece, scale):  # type: ignore[no-untyped-def]
    """Return ``|measured - scale piece|^2``."""
    total = 0.0
    for k in range(measured.shape[0]):
        difference = measured[k] - piece[k] * scale
        total += np.float64(difference * difference)
    return total


@numba.njit(cache=True)
def _masked_difference(masked, start, measured, piece, scale):  # type: ignore[no-untyped-def]
    """Return `_squared_difference` of the masked pixels of a piece that begins at `start`."""
    total = 0.0
    end = start + measured.shape[0]
    for k in range(np.searchsorted(masked, start), np.searchsorted(masked, end)):
        pixel = masked[k] - start
        difference = measured[pixel] - piece[pixel] * scale
        total += np.float64(difference * difference)
    return total


# Pieces of images


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


# Masked pixels


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


# Rank test


@numba.njit(cache=True)
def _energy_shares(piece, energy, block, blocks):  # type: ignore[no-untyped-def]
    """Return the energy shares ``w_i = sum(x[i]) / m`` of a block's children, and ``sum w_i^2``."""
    first, last = blocks.first_child[block], blocks.first_child[block + 1]
    shares, squares = np.empty(last - first), 0.0
    for child in range(first, last):
        begin = blocks.child_starts[child] - blocks.child_starts[first]
        end = blocks.child_starts[child + 1] - blocks.child_starts[first]
        share = summed(piece[begin:end]) / energy if energy > 0.0 else 0.0
        shares[child - first] = share
        squares += share * share
    return shares, squares


@numba.njit(cache=True, parallel=True)
def compare_children(blocks, nodes, first_pair, pieces):  # type: ignore[no-untyped-def]
    """Compare the pieces of each node's children with their prediction by the node's pieces.

    For node (a, b) with children (i, j)::

        x_ij ~ w_j x_ab[i],    w_j = sum(x_ba[j]) / m
        x_ji ~ w_i x_ba[j],    w_i = sum(x_ab[i]) / m
        ssd   = sum_ij |x_ij - w_j x_ab[i]|^2 + |x_ji - w_i x_ba[j]|^2
        noise = sum_ij var(x_ij) + var(x_ji) + sum_j w_j^2 var(x_ab) + sum_i w_i^2 var(x_ba)

    The arguments are the parts of `Subdivision`.

    Returns
    -------
    ssd, noise : float64 (C, n)
        Sum of squared differences, and its expectation if noise is the only difference.
    squares : float64 (C, 2, n)
        ``sum_j w_j^2`` and ``sum_i w_i^2``: 1 where one child has all the energy.
    """
    ssd = np.empty(nodes.energy.shape)
    noise = np.empty(nodes.energy.shape)
    squares = np.empty(nodes.variance.shape)
    for n in numba.prange(len(nodes.block_a)):
        for c in range(len(nodes.pieces)):
            ssd[c, n], noise[c, n], squares[c, 0, n], squares[c, 1, n] = _test_node(
                blocks, nodes, first_pair, pieces, c, n
            )
    return ssd, noise, squares


@numba.njit(cache=True)
def _test_node(blocks, nodes, first_pair, pieces, c, n):  # type: ignore[no-untyped-def]
    """Return ssd, noise and the two sums of squared shares of one node; see `compare_children`."""
    a, b = nodes.block_a[n], nodes.block_b[n]
    child_a, child_b = blocks.first_child[a], blocks.first_child[b]
    start_a, start_b = blocks.starts[a], blocks.starts[b]
    offset_a, offset_b = nodes.offset_a[n], nodes.offset_b[n]
    piece_a = nodes.pieces[c, offset_a : offset_a + blocks.starts[a + 1] - start_a]
    piece_b = nodes.pieces[c, offset_b : offset_b + blocks.starts[b + 1] - start_b]
    shares_a, squares_a = _energy_shares(piece_a, nodes.energy[c, n], a, blocks)
    shares_b, squares_b = _energy_shares(piece_b, nodes.energy[c, n], b, blocks)
    ssd, noise = 0.0, squares_b * nodes.variance[c, 0, n]
    if a != b:
        noise += squares_a * nodes.variance[c, 1, n]
    for pair in range(first_pair[n], first_pair[n + 1]):
        i, j = pieces.block_a[pair], pieces.block_b[pair]
        begin, end = blocks.child_starts[i] - start_a, blocks.child_starts[i + 1] - start_a
        offset = pieces.offset_a[pair]
        ssd = _add_difference(
            ssd, pieces.values[c, offset : offset + end - begin], piece_a[begin:end],
            np.float32(shares_b[j - child_b]), pieces.masked, blocks.child_starts[i],
        )  # fmt: skip
        noise += pieces.noise_variance[c, 0, pair]
        if i == j:
            continue
        begin, end = blocks.child_starts[j] - start_b, blocks.child_starts[j + 1] - start_b
        offset = pieces.offset_b[pair]
        ssd = _add_difference(
            ssd, pieces.values[c, offset : offset + end - begin], piece_b[begin:end],
            np.float32(shares_a[i - child_a]), pieces.masked, blocks.child_starts[j],
        )  # fmt: skip
        noise += pieces.noise_variance[c, 1, pair]
    return ssd, noise, squares_b, squares_a


@numba.njit(cache=True)
def _add_difference(total, measured, piece, share, masked, start):  # type: ignore[no-untyped-def]
    """Add ``|measured - share piece|^2`` over the known pixels of a piece to a total."""
    total += _squared_difference(measured, piece, share)
    total -= _masked_difference(masked, start, measured, piece, share)
    return total


# Children of nodes that don't become leaves


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
    squares = _squared_difference(piece, profile, scale)
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
    shares, squares = _energy_shares(partner, energy, block, blocks)
    pixels = energy * energy / square * len(shares) if square > 0.0 else 0.0
    return square * (1.0 - 2.0 * shares.min() + squares), pixels
