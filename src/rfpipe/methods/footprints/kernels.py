"""Compiled loops over camera pixels and candidates: weights of footprints.

The loops evaluate the equations of `rfpipe.methods.footprints.weights` for all camera pixels, and
have their symbols.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float, Index

Int32 = NDArray[np.int32]

# A weight at 0 is freed if the slope of the objective exceeds this fraction of the largest target.
_SLOPE_TOLERANCE = 1e-8
# Exchanges of many weights without fewer wrong ones, before they are exchanged one at a time; and
# largest number of exchanges for each weight.
_TRIALS, _MOST_EXCHANGES = 3, 10


class CandidateRows(NamedTuple):
    """Candidates of all camera pixels, and the patterns p.

    Those of camera pixel i are ``projector_pixels[starts[i] : starts[i + 1]]``; their rows of
    `patterns` are ``A^T``, (k, P).
    """

    starts: Index  # (M + 1,)
    projector_pixels: Int32  # (K,)
    patterns: Float  # (N, P)


class PixelPictures(NamedTuple):
    """Direct light d in the pictures of each camera pixel, and the diagonal of W."""

    radiance: Float  # (M, P)
    inverse_variance: Float  # (M, P)


class WeightPrior(NamedTuple):
    """Normal distribution of the weights before any picture: diagonal of ``G^-1``, and e."""

    inverse_variance: Float  # (K,)
    mean: Float  # (K,)


@njit(cache=True, nogil=True, fastmath=True)
def _gram(pixels: Int32, patterns: Float, inverse_variance: Float) -> Double:
    """Compute ``A^T W A`` of a camera pixel, (k, k)."""
    count = len(pixels)
    gram, weighted = np.empty((count, count)), np.empty(patterns.shape[1])
    for row in range(count):
        for q in range(len(weighted)):
            weighted[q] = inverse_variance[q] * patterns[pixels[row], q]
        for column in range(row + 1):
            total, second = 0.0, patterns[pixels[column]]
            for q in range(len(weighted)):
                total += weighted[q] * second[q]
            gram[row, column] = gram[column, row] = total
    return gram


@njit(cache=True, nogil=True)
def _projected(pixels: Int32, patterns: Float, values: Float) -> Double:
    """Compute ``A^T values`` of a camera pixel, (k,)."""
    result = np.zeros(len(pixels))
    for candidate in range(len(pixels)):
        for q in range(len(values)):
            result[candidate] += patterns[pixels[candidate], q] * values[q]
    return result


@njit(cache=True, nogil=True)
def solve_weights(
    rows: CandidateRows,
    pictures: PixelPictures,
    prior: WeightPrior,
    start: Float,
    least_evidence: float,
) -> Float:
    """Minimise ``(d - A x)^T W (d - A x) + (x - e)^T G^-1 (x - e)`` over x >= 0 for each pixel.

    The weights x are 0 where they explain less than `least_evidence` squared standard deviations of
    d, ``d^T W d - (d - A x)^T W (d - A x)``. `start`, (K,), is the first estimate; a good one saves
    time. Returns the weights of all pixels, (K,).
    """
    weights = np.zeros(len(rows.projector_pixels), np.float32)
    for i in range(len(rows.starts) - 1):
        first, last = rows.starts[i], rows.starts[i + 1]
        if first == last:
            continue
        pixels, W = rows.projector_pixels[first:last], pictures.inverse_variance[i]
        gram = _gram(pixels, rows.patterns, W)
        projected = _projected(pixels, rows.patterns, W * pictures.radiance[i])
        matrix, target = gram.copy(), projected.copy()
        for index in range(last - first):
            precision = prior.inverse_variance[first + index]
            matrix[index, index] += precision
            target[index] += precision * prior.mean[first + index]
        x = _non_negative(matrix, target, start[first:last])
        if x @ (2 * projected - gram @ x) >= least_evidence:
            weights[first:last] = x
    return weights


@njit(cache=True, nogil=True)
def _non_negative(matrix: Double, target: Double, start: Float) -> Double:
    """Minimise ``x^T matrix x / 2 - target^T x`` over x >= 0.

    Block principal pivoting, which frees and fixes many weights at a time: J. Kim and H. Park,
    *Fast nonnegative matrix factorization: an active-set-like method and comparisons*, SIAM J. Sci.
    Comput. 33 (2011), section 3. The weights above 0 in `start` are free at first. Coordinate
    descent would give all light to the first of several projector pixels with the same patterns.
    """
    count = len(target)
    x, free, wrong = np.zeros(count), start > 0, np.zeros(count, np.bool_)
    factor, solution = np.empty((count, count)), np.empty(count)
    tolerance = _SLOPE_TOLERANCE * max(target.max(), 0.0)
    fewest, trials = count + 1, _TRIALS
    for _ in range(_MOST_EXCHANGES * count):
        index = np.flatnonzero(free)
        _solve_part(matrix, target, index, factor, solution)
        x[:] = 0
        x[index] = solution[: len(index)]
        wrong_count = 0
        for row in range(count):
            if free[row]:
                wrong[row] = x[row] < 0
            else:
                slope = target[row]
                for element in range(len(index)):
                    slope -= matrix[row, index[element]] * solution[element]
                wrong[row] = slope > tolerance
            wrong_count += wrong[row]
        if wrong_count == 0:
            break
        trials = _TRIALS if wrong_count < fewest else trials - 1
        fewest = min(fewest, wrong_count)
        if trials >= 0:
            free ^= wrong
        else:  # one at a time, which always ends
            last = np.flatnonzero(wrong)[-1]
            free[last] = not free[last]
    return np.maximum(x, 0)


@njit(cache=True, nogil=True)
def _solve_part(
    matrix: Double, target: Double, index: Index, factor: Double, solution: Double
) -> None:
    """Solve the equations of the elements `index`, by Cholesky factorisation.

    Writes the lower triangle to `factor`, and the solution to the first elements of `solution`.
    """
    count = len(index)
    for row in range(count):
        for column in range(row + 1):
            total = matrix[index[row], index[column]]
            for inner in range(column):
                total -= factor[row, inner] * factor[column, inner]
            is_diagonal = row == column
            factor[row, column] = np.sqrt(total) if is_diagonal else total / factor[column, column]
        total = target[index[row]]
        for inner in range(row):
            total -= factor[row, inner] * solution[inner]
        solution[row] = total / factor[row, row]
    for row in range(count - 1, -1, -1):
        for below in range(row + 1, count):
            solution[row] -= factor[below, row] * solution[below]
        solution[row] /= factor[row, row]


@njit(cache=True, nogil=True)
def marginal_factors(
    rows: CandidateRows, variance: Float, inverse_variance: Float
) -> tuple[Double, Float]:
    """Factor each camera pixel's precision when the weights of its candidates are unknown.

    With weights of mean 0 and variance G the covariance of the pictures is ``W^-1 + A G A^T``. Its
    inverse, the precision, is

        Lambda = W - U^T U,    U = Y^-1 A^T W,    Y Y^T = G^-1 + A^T W A

    with the Cholesky factor Y.

    Parameters
    ----------
    rows : CandidateRows
    variance : ndarray of float32, shape (K,)
        Diagonal of G.
    inverse_variance : ndarray of float32, shape (M, P)
        Diagonal of W.

    Returns
    -------
    factors : ndarray of float64, shape (K, P)
        U of all pixels. In float32 the precision would not be positive for exact pictures.
    trace : ndarray of float32, shape (M,)
        Trace of each precision.
    """
    factors = np.empty((len(rows.projector_pixels), rows.patterns.shape[1]))
    trace = np.empty(len(rows.starts) - 1, np.float32)
    for i in range(len(trace)):
        first, last = rows.starts[i], rows.starts[i + 1]
        _factor(rows, i, variance[first:last], inverse_variance[i], factors[first:last])
        total = inverse_variance[i].astype(np.float64).sum()
        for value in factors[first:last].ravel():
            total -= value * value
        trace[i] = max(total, 0.0)
    return factors, trace


@njit(cache=True, nogil=True)
def _factor(
    rows: CandidateRows, i: int, variance: Float, inverse_variance: Float, U: Double
) -> None:
    """Compute U of camera pixel i, (k, P), from its diagonals of G, (k,), and W, (P,)."""
    if not len(U):
        return
    pixels = rows.projector_pixels[rows.starts[i] : rows.starts[i + 1]]
    inner = _gram(pixels, rows.patterns, inverse_variance)
    for row in range(len(U)):
        inner[row, row] += 1 / variance[row]
        U[row] = rows.patterns[pixels[row]].astype(np.float64) * inverse_variance
    _substitute(np.linalg.cholesky(inner), U)


@njit(cache=True, nogil=True)
def marginal_triangles(
    rows: CandidateRows, variance: Float, inverse_variance: Float
) -> tuple[Float, Float]:
    """Compute the Cholesky factors of the precisions of `marginal_factors`, ``Lambda = C C^T``.

    Unlike U they may be rounded to float32: the product stays positive. Pixels that are unknown
    have the factor 0.

    Returns
    -------
    triangles : ndarray of float32, shape (M, P (P + 1) / 2)
        Rows of the lower triangle of each C.
    trace : ndarray of float32, shape (M,)
        Trace of each precision.
    """
    count, pixels = inverse_variance.shape[1], len(rows.starts) - 1
    triangles = np.zeros((pixels, count * (count + 1) // 2), np.float32)
    trace = np.zeros(pixels, np.float32)
    U = np.empty((np.diff(rows.starts).max(), count))
    for i in range(pixels):
        if not inverse_variance[i].any():
            continue
        first, last = rows.starts[i], rows.starts[i + 1]
        factors = U[: last - first]
        _factor(rows, i, variance[first:last], inverse_variance[i], factors)
        # the smallest eigenvalues would be lost to rounding only if pictures were exact
        precision = np.diag((1 + 1e-12) * inverse_variance[i].astype(np.float64))
        precision -= factors.T @ factors
        C, place = np.linalg.cholesky(precision), 0
        for q in range(count):
            triangles[i, place : place + q + 1] = C[q, : q + 1]
            place += q + 1
        trace[i] = np.trace(precision)
    return triangles, trace


@njit(cache=True, nogil=True)
def _substitute(Y: NDArray[np.floating], U: Double) -> None:
    """Overwrite U, (k, P), with ``Y^-1 U``; Y, (k, k), is lower triangular."""
    for row in range(len(U)):
        for column in range(row):
            for q in range(U.shape[1]):
                U[row, q] -= Y[row, column] * U[column, q]
        for q in range(U.shape[1]):
            U[row, q] /= Y[row, row]


@njit(cache=True, nogil=True, fastmath=True)
def apply_precision(
    starts: Index, factors: Double, inverse_variance: Float, pictures: Float
) -> Float:
    """Multiply each camera pixel's pictures by its precision ``W - U^T U``, float32 (M, P).

    `factors` are U as in `marginal_factors`, (K, P), `inverse_variance` the diagonals of W, (M, P);
    `pictures` are (M, P).
    """
    result = np.empty_like(pictures)
    count = pictures.shape[1]
    explained = np.empty(count)
    for i in range(len(starts) - 1):
        explained[:] = 0
        for candidate in range(starts[i], starts[i + 1]):
            total = 0.0
            for q in range(count):
                total += factors[candidate, q] * pictures[i, q]
            for q in range(count):
                explained[q] += total * factors[candidate, q]
        for q in range(count):
            result[i, q] = np.float64(inverse_variance[i, q]) * pictures[i, q] - explained[q]
    return result


@njit(cache=True, nogil=True, fastmath=True)
def apply_triangles(triangles: Float, pictures: Float) -> Float:
    """Multiply each camera pixel's pictures by ``C C^T``, float32 (M, P).

    `triangles` are C as in `marginal_triangles`; `pictures` are (M, P).
    """
    result = np.empty_like(pictures)
    count = pictures.shape[1]
    inner = np.empty(count, np.float32)
    for i in range(len(triangles)):
        inner[:] = 0
        place = 0
        for q in range(count):
            row, value = triangles[i, place : place + q + 1], pictures[i, q]
            for r in range(q + 1):
                inner[r] += row[r] * value
            place += q + 1
        place = 0
        for q in range(count):
            row, total = triangles[i, place : place + q + 1], np.float32(0)
            for r in range(q + 1):
                total += row[r] * inner[r]
            result[i, q] = total
            place += q + 1
    return result


class TransposedCandidates(NamedTuple):
    """Candidates of D and of ``D^T``: keys, variances, and the weights of both matrices."""

    keys: Index
    variance: Float
    weights: Float
    transposed: Float


class CandidateEntries(NamedTuple):
    """Keys, variances and weights of candidates."""

    keys: Index
    variance: Float
    weights: Float


@njit(cache=True, nogil=True)
def with_transposed_candidates(
    direct: CandidateEntries, mirrored: CandidateEntries, size: int
) -> TransposedCandidates:
    """Merge the candidates of a block of D with the transposed ones of another that have light.

    Both blocks are (size, size). The variance is the larger one of an entry and of its transposed
    one with light.
    """
    by_column = _entries_by_column(mirrored.keys, mirrored.weights, size)
    keys = mirrored.keys[by_column]
    keys = keys % size * size + keys // size  # i N + j becomes j N + i
    a = b = count = 0
    while a < len(direct.keys) or b < len(keys):
        _, in_direct, in_mirrored = _next_key(direct.keys, keys, size, a, b)
        a, b, count = a + in_direct, b + in_mirrored, count + 1
    merged = TransposedCandidates(
        np.empty(count, np.int64),
        np.zeros(count, np.float32),
        np.zeros(count, np.float32),
        np.zeros(count, np.float32),
    )
    a = b = 0
    for n in range(count):
        merged.keys[n], in_direct, in_mirrored = _next_key(direct.keys, keys, size, a, b)
        if in_direct:
            merged.weights[n], merged.variance[n] = direct.weights[a], direct.variance[a]
        if in_mirrored:
            entry = by_column[b]
            merged.transposed[n] = mirrored.weights[entry]
            merged.variance[n] = max(merged.variance[n], mirrored.variance[entry])
        a, b = a + in_direct, b + in_mirrored
    return merged


@njit(cache=True, nogil=True)
def _entries_by_column(keys: Index, weights: Float, size: int) -> Int32:
    """Return the numbers of the candidates with light, by column and then by row."""
    starts = np.zeros(size + 1, np.int64)
    for k in range(len(keys)):
        if weights[k] > 0:
            starts[keys[k] % size + 1] += 1
    starts = np.cumsum(starts)
    entries = np.empty(starts[-1], np.int32)
    for k in range(len(keys)):
        if weights[k] > 0:
            column = keys[k] % size
            entries[starts[column]] = k
            starts[column] += 1
    return entries


@njit(cache=True, nogil=True)
def _next_key(direct: Index, mirrored: Index, size: int, a: int, b: int) -> tuple[int, bool, bool]:
    """Return the smaller one of the keys a and b of two blocks, and in which of them it is."""
    first = direct[a] if a < len(direct) else size * size
    second = mirrored[b] if b < len(mirrored) else size * size
    return min(first, second), first <= second, second <= first
