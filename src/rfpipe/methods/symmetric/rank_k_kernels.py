"""Compiled kernels of rank-k leaves by the generalised Nystroem method.

A node (a, b) has ``Y``, the pieces over a under the children of b, a column each; ``Z``, the pieces
over b under the children of a; and ``W``, the energies of all pairs of children. Nodes are off the
diagonal, so that the pair of children (i, j) is number ``i * children of b + j`` of its node.
"""

import math

import numba
import numpy as np

from rfpipe.transport.hierarchical.kernels import dot

# Jacobi rotations converge quadratically: a matrix of four columns takes some five sweeps.
_SWEEPS = 30
_ORTHOGONAL = 1e-14


@numba.njit(cache=True)
def _decompose(matrix, vectors):  # type: ignore[no-untyped-def]
    """Rotate a small matrix's columns until they are orthogonal: ``matrix @ vectors``, in place.

    One-sided Jacobi rotations [Hestenes 1958]: the columns become left singular vectors times
    singular values, `vectors` the right singular vectors.
    """
    rows, columns = matrix.shape
    vectors[:] = 0.0
    for k in range(columns):
        vectors[k, k] = 1.0
    for _ in range(_SWEEPS):
        rotated = False
        for p in range(columns - 1):
            for q in range(p + 1, columns):
                pp, qq, pq = 0.0, 0.0, 0.0
                for k in range(rows):
                    pp += matrix[k, p] * matrix[k, p]
                    qq += matrix[k, q] * matrix[k, q]
                    pq += matrix[k, p] * matrix[k, q]
                if abs(pq) <= _ORTHOGONAL * math.sqrt(pp) * math.sqrt(qq):
                    continue
                rotated = True
                zeta = (qq - pp) / (2.0 * pq)
                tangent = math.copysign(1.0, zeta) / (abs(zeta) + math.hypot(1.0, zeta))
                cosine = 1.0 / math.hypot(1.0, tangent)
                sine = cosine * tangent
                for array in (matrix, vectors):
                    for k in range(array.shape[0]):
                        at_p, at_q = array[k, p], array[k, q]
                        array[k, p] = cosine * at_p - sine * at_q
                        array[k, q] = sine * at_p + cosine * at_q
        if not rotated:
            break


@numba.njit(cache=True)
def _carried(rotated, vectors, limit, amplified, of_columns, of_rows, carried):  # type: ignore[no-untyped-def]
    """Tell which terms of a decomposed core its sums are evidence of.

    A term with singular value s and singular vectors u and v adds ``Y v (Z u)^T / s`` to the
    entries, of norm ``|Y v| |Z u| / s``, and the sums show s of it. The quotient of both is much
    the same for all terms of smooth light. It is large where the images hold what isn't smooth and
    nearly cancels in the sums: such light is multiplied by itself and divided by next to nothing.

    Parameters
    ----------
    rotated, vectors : float64 (rows, columns), (columns, columns)
        As `_decompose` leaves them.
    limit : float
        Singular values up to here are noise.
    amplified : float
        How many times the leading term's quotient another one's may be.
    of_columns, of_rows : float64 (columns, columns), (rows, rows)
        Inner products of the images that the core's columns and rows are the sums of.
    carried : bool (columns,)
        Written.
    """
    rows, columns = rotated.shape
    square, quotient = np.zeros(columns), np.zeros(columns)
    for r in range(columns):
        images_a, images_b = 0.0, 0.0
        for k in range(rows):
            square[r] += rotated[k, r] * rotated[k, r]
            for other in range(rows):
                images_b += rotated[k, r] * rotated[other, r] * of_rows[k, other]
        for k in range(columns):
            for other in range(columns):
                images_a += vectors[k, r] * vectors[other, r] * of_columns[k, other]
        carried[r] = square[r] > limit * limit
        if carried[r]:
            # squared, and what is rotated is s u
            quotient[r] = max(images_a, 0.0) / square[r] * (max(images_b, 0.0) / square[r] ** 2)
    largest = amplified * amplified * quotient[np.argmax(square)]
    for r in range(columns):
        carried[r] &= quotient[r] <= largest


@numba.njit(cache=True)
def _weights_without(core, left_out, limit, amplified, of_columns, of_rows, weights):  # type: ignore[no-untyped-def]
    """Write the weights of columns that add up to what one column differs from the others.

    The column counts 1, the others minus what the truncated pseudo-inverse predicts it by.
    """
    rows, columns = core.shape
    others = np.empty((rows, columns - 1))
    vectors = np.empty((columns - 1, columns - 1))
    products = np.empty((columns - 1, columns - 1))
    carried = np.empty(columns - 1, np.bool_)
    for k in range(columns - 1):
        for j in range(rows):  # to copy a slice takes longer to compile
            others[j, k] = core[j, k + (k >= left_out)]
        for j in range(columns - 1):
            products[j, k] = of_columns[j + (j >= left_out), k + (k >= left_out)]
    _decompose(others, vectors)
    _carried(others, vectors, limit, amplified, products, of_rows, carried)
    weights[:] = 0.0
    weights[left_out] = 1.0
    for r in range(columns - 1):
        if not carried[r]:
            continue
        square, shared = 0.0, 0.0
        for k in range(rows):
            square += others[k, r] * others[k, r]
            shared += others[k, r] * core[k, left_out]
        for k in range(columns - 1):
            weights[k + (k >= left_out)] -= vectors[k, r] * shared / square


@numba.njit(cache=True)
def _residual(core, limit, amplified, products, of_rows, noise):  # type: ignore[no-untyped-def]
    """Predict each column of images from the others; return squared errors and their noise.

    `core` are the energies of the images' blocks, (rows, columns), `products` the images' inner
    products, `of_rows` those of the rows' images over the block of each column, `noise` each
    column's variance.
    """
    columns = core.shape[1]
    weights = np.empty(columns)
    error, expected = 0.0, 0.0
    whole = of_rows.sum(axis=0)
    for column in range(columns):
        _weights_without(core, column, limit, amplified, products, whole - of_rows[column], weights)
        square = 0.0
        for k in range(columns):
            expected += weights[k] * weights[k] * noise[k]
            for other in range(columns):
                square += weights[k] * weights[other] * products[k, other]
        error += max(square, 0.0)
    return error, expected


@numba.njit(cache=True)
def _inner_products(values, pair, offsets, starts, step, stride, products):  # type: ignore[no-untyped-def]
    """Write the inner products of a node's images on one side, child by child of that side.

    `products` are float64 (blocks, images, images). From the node's first pair of children, `step`
    pairs lead to the next child of this side, `stride` to that of the other.
    """
    for block in range(products.shape[0]):
        size = starts[block + 1] - starts[block]
        for j in range(products.shape[1]):
            at = offsets[pair + block * step + j * stride]
            for k in range(j + 1):
                other = offsets[pair + block * step + k * stride]
                product = dot(values[at : at + size], values[other : other + size])
                products[block, j, k] = products[block, k, j] = product


@numba.njit(cache=True)
def _starts_within(children, child_starts, block):  # type: ignore[no-untyped-def]
    """Return the first tree positions of a block's children, and the end of the last one."""
    return child_starts[children[block] : children[block + 1] + 1]


@numba.njit(cache=True)
def _over_both_sides(values, pair, offset_a, offset_b, starts_a, starts_b):  # type: ignore[no-untyped-def]
    """Return the inner products of a node's images over a and over b, see `_inner_products`.

    float64 (children of a, children of b, children of b), and the other way round.
    """
    rows, columns = starts_a.shape[0] - 1, starts_b.shape[0] - 1
    over_a, over_b = np.empty((rows, columns, columns)), np.empty((columns, rows, rows))
    _inner_products(values, pair, offset_a, starts_a, columns, 1, over_a)
    _inner_products(values, pair, offset_b, starts_b, 1, columns, over_b)
    return over_a, over_b


@numba.njit(cache=True)
def _core(pair, sums, spread, core):  # type: ignore[no-untyped-def]
    """Write the energies of a node's pairs of children; return up to where its spectrum is noise.

    Each has been measured twice. The largest singular value of a k x l matrix of noise is about
    its standard deviation times ``sqrt(k) + sqrt(l)``. That deviation is what the cameras' variance
    says, or what the two measurements differ by where that is more.
    """
    rows, columns = core.shape
    variance, difference = 0.0, 0.0
    for i in range(rows):
        for j in range(columns):
            n = pair + i * columns + j
            first, second = spread[0, n], spread[1, n]
            share = second / (first + second) if first + second > 0.0 else 0.5
            core[i, j] = share * sums[0, n] + (1.0 - share) * sums[1, n]
            variance += share * first
            difference += (sums[0, n] - sums[1, n]) ** 2 / 4.0
    deviation = math.sqrt(max(variance, difference) / (rows * columns))
    return deviation * (math.sqrt(rows) + math.sqrt(columns))


@numba.njit(cache=True, parallel=True)
def leave_one_out(divided, chosen, amplified, ssd, noise):  # type: ignore[no-untyped-def]
    """Predict the images under each child of chosen nodes from those under the other children.

    Written are the summed squared differences and what noise alone would make of them, (C, n).
    """
    _, children, child_starts = divided.grid
    block_a, block_b, _, _ = divided.nodes.pairs
    first_pair = divided.first_pair
    _, _, offset_a, offset_b = divided.pieces.pairs
    values, sums, spread = divided.pieces.values, divided.pieces.sums, divided.pieces.spread
    for n in numba.prange(chosen.shape[0]):
        starts_a = _starts_within(children, child_starts, block_a[chosen[n]])
        starts_b = _starts_within(children, child_starts, block_b[chosen[n]])
        rows, columns = starts_a.shape[0] - 1, starts_b.shape[0] - 1
        core = np.empty((rows, columns))
        for c in range(values.shape[0]):
            limit = _core(first_pair[chosen[n]], sums[c], spread[c], core)
            noise_a, noise_b = np.zeros(columns), np.zeros(rows)
            for i in range(rows):
                for j in range(columns):
                    noise_a[j] += spread[c, 0, first_pair[chosen[n]] + i * columns + j]
                    noise_b[i] += spread[c, 1, first_pair[chosen[n]] + i * columns + j]
            over_a, over_b = _over_both_sides(
                values[c], first_pair[chosen[n]], offset_a, offset_b, starts_a, starts_b
            )
            error_a, expected_a = _residual(
                core, limit, amplified, over_a.sum(axis=0), over_b, noise_a
            )
            error_b, expected_b = _residual(
                core.T.copy(), limit, amplified, over_b.sum(axis=0), over_a, noise_b
            )
            ssd[c, n] = error_a + error_b
            noise[c, n] = expected_a + expected_b


@numba.njit(cache=True, parallel=True)
def invert_cores(divided, chosen, amplified, sums, left, right, rank):  # type: ignore[no-untyped-def]
    """Split the truncated pseudo-inverse of each node's core: ``W^+ = right @ left.T``.

    `sums` are those of the pieces as they are; `divided` has them as they were measured. Written
    are `left` (C, n, rows, terms), `right` (C, n, columns, terms), and `rank` (C, n), the number of
    terms.
    """
    _, children, child_starts = divided.grid
    block_a, block_b, _, _ = divided.nodes.pairs
    first_pair = divided.first_pair
    _, _, offset_a, offset_b = divided.pieces.pairs
    values, measured, spread = divided.pieces.values, divided.pieces.sums, divided.pieces.spread
    for n in numba.prange(chosen.shape[0]):
        starts_a = _starts_within(children, child_starts, block_a[chosen[n]])
        starts_b = _starts_within(children, child_starts, block_b[chosen[n]])
        rows, columns = starts_a.shape[0] - 1, starts_b.shape[0] - 1
        core, vectors = np.empty((rows, columns)), np.empty((columns, columns))
        carried = np.empty(columns, np.bool_)
        for c in range(sums.shape[0]):
            limit = _core(first_pair[chosen[n]], measured[c], spread[c], core)
            _core(first_pair[chosen[n]], sums[c], spread[c], core)
            _decompose(core, vectors)
            over_a, over_b = _over_both_sides(
                values[c], first_pair[chosen[n]], offset_a, offset_b, starts_a, starts_b
            )
            _carried(
                core, vectors, limit, amplified, over_a.sum(axis=0), over_b.sum(axis=0), carried
            )
            terms = 0
            for r in range(columns):
                value = 0.0
                for k in range(rows):
                    value = math.hypot(value, core[k, r])
                if carried[r]:
                    for k in range(rows):
                        left[c, n, k, terms] = core[k, r] / value**1.5
                    for k in range(columns):
                        right[c, n, k, terms] = vectors[k, r] / value**0.5
                    terms += 1
            rank[c, n] = terms


@numba.njit(cache=True, parallel=True)
def combine_pieces(divided, chosen, left, right, first_term, begin, factors):  # type: ignore[no-untyped-def]
    """Write the factors of nodes' terms: ``Y @ right`` and ``Z @ left``.

    `left` and `right` are those of `invert_cores`, 0 where a channel has fewer terms. The terms of
    node ``i`` are ``first_term[i]:first_term[i + 1]``; their factors begin at `begin`, are 0 before
    and added to.
    """
    _, children, child_starts = divided.grid
    block_a, block_b, _, _ = divided.nodes.pairs
    first_pair = divided.first_pair
    _, _, offset_a, offset_b = divided.pieces.pairs
    values = divided.pieces.values
    for n in numba.prange(chosen.shape[0]):
        starts_a = _starts_within(children, child_starts, block_a[chosen[n]])
        starts_b = _starts_within(children, child_starts, block_b[chosen[n]])
        rows, columns = starts_a.shape[0] - 1, starts_b.shape[0] - 1
        whole_a = starts_a[rows] - starts_a[0]
        for term in range(first_term[n], first_term[n + 1]):
            r = term - first_term[n]
            for i in range(rows):
                place_a = begin[term] + starts_a[i] - starts_a[0]
                size_a = starts_a[i + 1] - starts_a[i]
                for j in range(columns):
                    pair = first_pair[chosen[n]] + i * columns + j
                    place_b = begin[term] + whole_a + starts_b[j] - starts_b[0]
                    size_b = starts_b[j + 1] - starts_b[j]
                    for c in range(values.shape[0]):
                        weight = np.float32(right[c, n, j, r])
                        for k in range(size_a):
                            factors[c, place_a + k] += values[c, offset_a[pair] + k] * weight
                        weight = np.float32(left[c, n, i, r])
                        for k in range(size_b):
                            factors[c, place_b + k] += values[c, offset_b[pair] + k] * weight
