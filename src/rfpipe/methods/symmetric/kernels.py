"""Compiled kernels of symmetric photography (thesis §5.1, C.2).

A *piece* ``(k, b)`` is what block ``k`` of the camera received while block ``b`` was lit. Images
are planar and in tree order: a piece of an image is one run. See `rfpipe.methods.symmetric.nodes`.
"""

import numba
import numpy as np

from rfpipe.transport.hierarchical.kernels import dot, summed

_FAST = {"reassoc", "contract", "nsz", "arcp"}
# How much more uncertain than the other a sum is that is known from the other alone.
_NO_WEIGHT = 1e12


@numba.njit(cache=True, fastmath=_FAST)
def _squared_difference(measured, factor, scale):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(measured.shape[0]):
        difference = measured[k] - factor[k] * scale
        total += np.float64(difference * difference)
    return total


@numba.njit(cache=True)
def _unknown_difference(unknown, first, measured, factor, scale):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, parallel=True)
def collect_pieces(starts, pairs, pattern_of_block, first, residuals, spreads, values, variances):  # type: ignore[no-untyped-def]
    """Copy the pieces of some patterns' images to their pairs.

    `pattern_of_block` is -1 for none, `first` the pattern of the first of the images; residuals and
    spreads are the images and their variance, float32 (P, C, N).
    """
    block_a, block_b, offset_a, offset_b = pairs
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        for side in range(1 if a == b else 2):
            block, lit = (a, b) if side == 0 else (b, a)
            at = offset_a[n] if side == 0 else offset_b[n]
            pattern = pattern_of_block[lit] - first
            if pattern < 0 or pattern >= residuals.shape[0]:
                continue
            begin, end = starts[block], starts[block + 1]
            for c in range(values.shape[0]):
                values[c, at : at + end - begin] = residuals[pattern, c, begin:end]
                variances[c, at : at + end - begin] = spreads[pattern, c, begin:end]


@numba.njit(cache=True, parallel=True)
def sum_pieces(starts, pairs, values, sums):  # type: ignore[no-untyped-def]
    """Write the sums of each piece (a, b) and (b, a), float64 (C, 2, n); alike on the diagonal."""
    block_a, block_b, offset_a, offset_b = pairs
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        size_a, size_b = starts[a + 1] - starts[a], starts[b + 1] - starts[b]
        for c in range(values.shape[0]):
            sums[c, 0, n] = summed(values[c, offset_a[n] : offset_a[n] + size_a])
            sums[c, 1, n] = summed(values[c, offset_b[n] : offset_b[n] + size_b])


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
def complete_pieces(starts, pieces):  # type: ignore[no-untyped-def]
    """Fill in pixels that no image shows, as far as the pair's other piece knows their light.

    By symmetry both pieces of a pair have one sum. What one lacks is what its unknown pixels
    have, beside noise: they are taken to be like the other pixels of the piece, and then moved by
    how uncertain that is in proportion to all that is uncertain. Where a block has no other pixels
    they have all that its partner sends; on the diagonal, where there is no partner, the mean.
    Values, sums, spread and doubt change; values are 0 in unknown pixels before.
    """
    (block_a, block_b, offset_a, offset_b), values, _, sums, spread, doubt, unknown = pieces
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
def _shares(piece, energy, first_child, last_child, child_starts, shares):  # type: ignore[no-untyped-def]
    """Write the share of a node's energy in each child block of a side; return their squares."""
    squares = 0.0
    for child in range(first_child, last_child):
        begin = child_starts[child] - child_starts[first_child]
        end = child_starts[child + 1] - child_starts[first_child]
        share = summed(piece[begin:end]) / energy if energy > 0.0 else 0.0
        shares[child - first_child] = share
        squares += share * share
    return squares


@numba.njit(cache=True, parallel=True)
def rank_test(divided, ssd, noise, squares):  # type: ignore[no-untyped-def]
    """Predict the pieces of each node's children from its factors, and compare.

    Written are, float64 (C, n), summed squared differences and what noise alone would make of them;
    and `squares`, (C, 2, n): over the children of b, and over those of a, the sum of the squared
    shares that they have of the node's energy; 1 where a single child has all of it.
    """
    _, children, child_starts = divided.grid
    (block_a, block_b, offset_a, offset_b), pieces, energy, piece_variance = divided.nodes
    pair_a, pair_b, pair_offset_a, pair_offset_b = divided.pieces.pairs
    values, spread, unknown = divided.pieces.values, divided.pieces.spread, divided.pieces.unknown
    first_pair = divided.first_pair
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        start_a, start_b = child_starts[children[a]], child_starts[children[b]]
        size_a = child_starts[children[a + 1]] - start_a
        size_b = child_starts[children[b + 1]] - start_b
        shares_a = np.empty(children[a + 1] - children[a])
        shares_b = np.empty(children[b + 1] - children[b])
        for c in range(pieces.shape[0]):
            e = energy[c, n]
            factor_a = pieces[c, offset_a[n] : offset_a[n] + size_a]
            factor_b = pieces[c, offset_b[n] : offset_b[n] + size_b]
            square_a = _shares(factor_a, e, children[a], children[a + 1], child_starts, shares_a)
            square_b = _shares(factor_b, e, children[b], children[b + 1], child_starts, shares_b)
            squares[c, 0, n], squares[c, 1, n] = square_b, square_a
            total, expected = 0.0, square_b * piece_variance[c, 0, n]
            if a != b:
                expected += square_a * piece_variance[c, 1, n]
            for pair in range(first_pair[n], first_pair[n + 1]):
                i, j = pair_a[pair], pair_b[pair]
                begin, end = child_starts[i] - start_a, child_starts[i + 1] - start_a
                at = pair_offset_a[pair]
                measured, factor = values[c, at : at + end - begin], factor_a[begin:end]
                share = np.float32(shares_b[j - children[b]])
                total += _squared_difference(measured, factor, share)
                total -= _unknown_difference(unknown, child_starts[i], measured, factor, share)
                expected += spread[c, 0, pair]
                if i == j:
                    continue
                begin, end = child_starts[j] - start_b, child_starts[j + 1] - start_b
                at = pair_offset_b[pair]
                measured, factor = values[c, at : at + end - begin], factor_b[begin:end]
                share = np.float32(shares_a[i - children[a]])
                total += _squared_difference(measured, factor, share)
                total -= _unknown_difference(unknown, child_starts[j], measured, factor, share)
                expected += spread[c, 1, pair]
            ssd[c, n] = total
            noise[c, n] = expected


@numba.njit(cache=True)
def _reconcile_block(size, offsets, values, variances, whole, noise):  # type: ignore[no-untyped-def]
    """Distribute what the pieces of one block lack to their sum, by their variances."""
    for k in range(size):
        total, variance = np.float64(0.0), noise
        for at in offsets:
            total += values[at + k]
            variance += variances[at + k]
        if variance <= 0.0:
            continue
        lacking = np.float32((whole[k] - total) / variance)
        for at in offsets:
            part = variances[at + k]
            values[at + k] += lacking * part
            variances[at + k] = part * np.float32(1.0 - part / variance)


@numba.njit(cache=True, parallel=True)
def reconcile(divided):  # type: ignore[no-untyped-def]
    """Make the children's pieces agree with the node's own, which measured their sum before.

    Each pixel's light is then known from all levels' images together. The pieces' values and
    variances are changed in place.
    """
    _, children, child_starts = divided.grid
    (block_a, block_b, offset_a, offset_b), pieces, _, piece_variance = divided.nodes
    pair_a, pair_b, pair_offset_a, pair_offset_b = divided.pieces.pairs
    values, variances = divided.pieces.values, divided.pieces.variances
    first_pair = divided.first_pair
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        offsets = np.empty(2 * (first_pair[n + 1] - first_pair[n]), np.int64)
        for side in range(1 if a == b else 2):
            block, at = (a, offset_a[n]) if side == 0 else (b, offset_b[n])
            start = child_starts[children[block]]
            pixels = child_starts[children[block + 1]] - start
            for child in range(children[block], children[block + 1]):
                count = 0
                for pair in range(first_pair[n], first_pair[n + 1]):
                    if pair_a[pair] == child and (side == 0 or a == b):
                        offsets[count] = pair_offset_a[pair]
                        count += 1
                    elif pair_b[pair] == child and (side == 1 or a == b):
                        offsets[count] = pair_offset_b[pair]
                        count += 1
                begin, end = child_starts[child] - start, child_starts[child + 1] - start
                for c in range(values.shape[0]):
                    _reconcile_block(
                        end - begin, offsets[:count], values[c], variances[c],
                        pieces[c, at + begin : at + end], piece_variance[c, side, n] / pixels,
                    )  # fmt: skip


@numba.njit(cache=True, parallel=True)
def weigh_pairs(  # type: ignore[no-untyped-def]
    pairs, sums, spread, chosen, least, significant, energy, clear
):
    """Combine the two sums of chosen pairs by their variances, and tell light from noise.

    On the diagonal both are the same one. `energy`, float64 (C, n), is 0 where the sum is no more
    than `least` squared standard deviations; it is `clear`, bool (C, n), above `significant` ones.
    """
    pair_a, pair_b, _, _ = pairs
    for n in numba.prange(chosen.shape[0]):
        pair = chosen[n]
        for c in range(energy.shape[0]):
            first, second = spread[c, 0, pair], spread[c, 1, pair]
            share = second / (first + second) if first + second > 0.0 else 0.5
            if pair_a[pair] == pair_b[pair]:
                share, second = 1.0, 0.0
            light = share * sums[c, 0, pair] + (1.0 - share) * sums[c, 1, pair]
            variance = share * share * first + (1.0 - share) * (1.0 - share) * second
            square = light * light if light > 0.0 else 0.0
            energy[c, n] = light if square > least * variance else 0.0
            clear[c, n] = square > significant * variance


@numba.njit(cache=True)
def _take_piece(source, spread, profile, significance, energy, target):  # type: ignore[no-untyped-def]
    """Copy a piece with less noise, not negative, scaled to the node's energy.

    The surface under a block is that of the piece above, so that its picture is a good guess at
    this one's, and less noisy. As much of the difference is kept as exceeds what noise makes of
    it, over the piece as a whole or, where that is more, at the single pixel.
    """
    total, light = summed(source), summed(profile)
    if total > 0.0 and light > 0.0:
        scale = np.float32(total / light)
        different = _squared_difference(source, profile, scale)
        kept = max(0.0, 1.0 - summed(spread) / different) if different > 0.0 else 0.0
        for k in range(source.shape[0]):
            guess = profile[k] * scale
            difference = source[k] - guess
            square = difference * difference
            noise = significance * significance * spread[k]
            here = max(kept, 1.0 - noise / square) if square > noise else kept
            target[k] = max(guess + np.float32(here) * difference, np.float32(0))
    else:
        for k in range(source.shape[0]):
            target[k] = max(source[k], np.float32(0))
    positive = summed(target)
    scale = np.float32(energy / positive) if positive > 0.0 and energy > 0.0 else np.float32(0)
    for k in range(source.shape[0]):
        target[k] *= scale


@numba.njit(cache=True)
def _worst_share(piece, energy, first_child, last_child, child_starts, shares):  # type: ignore[no-untyped-def]
    """Largest sum of squares by which a split of one unit among the children can miss the shares.

    The piece predicts the share ``w_q`` of child ``q``; whatever the truth is, it splits one
    unit into non-negative parts, so the worst is all of it in the child of the smallest share.
    """
    squares = _shares(piece, energy, first_child, last_child, child_starts, shares)
    return 1.0 - 2.0 * shares.min() + squares


@numba.njit(cache=True, parallel=True)
def take_pieces(  # type: ignore[no-untyped-def]
    grid, nodes, sources, values, variances, above, profiles, significance, worst, lit
):
    """Make factors of nodes' pieces, and bound what the rank test can still find.

    The factors of `nodes` are written, scaled to their energy; 0 gives empty ones. `sources`, (2,
    n), is where the nodes' pieces begin in `values`, `above`, (2, n), where the pictures of their
    blocks begin in `profiles`, the factors of the nodes above; -1 for none.

    Written are, float64 (C, n): `worst`, than which no non-negative transport with these pieces can
    give the next level's rank test a larger sum of squared differences; and `lit`, how many pixels
    that sum is over in effect, by the participation number ``(sum x)^2 / sum x^2`` of each piece: a
    glint in a dark block counts as one pixel.
    """
    starts, children, child_starts = grid
    (block_a, block_b, offset_a, offset_b), pieces, energy, _ = nodes
    for n in numba.prange(block_a.shape[0]):
        a, b = block_a[n], block_b[n]
        shares_a = np.empty(children[a + 1] - children[a])
        shares_b = np.empty(children[b + 1] - children[b])
        size_a, size_b = starts[a + 1] - starts[a], starts[b + 1] - starts[b]
        for c in range(pieces.shape[0]):
            e = energy[c, n]
            piece_a = pieces[c, offset_a[n] : offset_a[n] + size_a]
            piece_b = pieces[c, offset_b[n] : offset_b[n] + size_b]
            for side in range(1 if a == b else 2):
                target = piece_a if side == 0 else piece_b
                source, profile, size = sources[side, n], above[side, n], len(target)
                _take_piece(
                    values[c, source : source + size], variances[c, source : source + size],
                    profiles[c, profile : profile + (size if profile >= 0 else 0)], significance,
                    e, target,
                )  # fmt: skip
            square = dot(piece_a, piece_a)
            worst[c, n] = square * _worst_share(
                piece_b, e, children[b], children[b + 1], child_starts, shares_b
            )
            lit[c, n] = e * e / square * len(shares_b) if square > 0.0 else 0.0
            if a != b:
                square = dot(piece_b, piece_b)
                worst[c, n] += square * _worst_share(
                    piece_a, e, children[a], children[a + 1], child_starts, shares_a
                )
                lit[c, n] += e * e / square * len(shares_a) if square > 0.0 else 0.0
