"""Compiled kernels of the compressed form factors: filling blocks, and applying them.

Points stand in the order of the cluster trees. A block of n_1 x n_2 points is stored row-major as
its n_1 n_2 entries (rank 0), or as two factors of n_1 x k and n_2 x k (rank k). Each kernel works
alone on what it is given and holds no lock, so that several may run in threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.visibility import END_TOLERANCE

_PANEL = 64  # terms that are added up in float32
_MAX_RANK = 128  # a block that needs more is stored with all its entries
# Relative error (Frobenius) of a smooth block; about what storing factors as float32 costs.
_TOLERANCE = 3e-7


class Sides(NamedTuple):
    """Points p and q of two surfaces, n_1 and n_2, float64.

    Attributes
    ----------
    p, q
        (n_1, 3), (n_2, 3): positions, scene units.
    lobes
        (n_1, 4): (1, 0, 0, 0) for points of a plane, (0, normal) for points of a sphere.
    spheres
        (spheres, 4): centre and radius of spheres that may stand between them.
    shadow_p, shadow_q
        (occluders, n_1, 3), (occluders, n_2, 3): affine coordinates in each occluder.
    height_p, height_q
        (n_1,), (n_2,): heights over the other plane, 1 on a side that faces the sphere.
    least
        Lower clamp of squared distances.
    """

    p: NDArray[np.float64]
    q: NDArray[np.float64]
    lobes: NDArray[np.float64]
    spheres: NDArray[np.float64]
    shadow_p: NDArray[np.float64]
    shadow_q: NDArray[np.float64]
    height_p: NDArray[np.float64]
    height_q: NDArray[np.float64]
    least: float


@numba.njit(cache=True, nogil=True, inline="always")
def _kernel(p, lobe, q, least):  # type: ignore[no-untyped-def]
    """Return f / (pi d^4) between two points, d^2 at least `least`.

    f is what p's side adds: 1 of a plane, lobe (1, 0, 0, 0); the height of q over the tangent
    plane of p on a sphere with normal n, lobe (0, n), at least 0.
    """
    x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    squared = max(x * x + y * y + z * z, least)
    above = max(lobe[0] - (lobe[1] * x + lobe[2] * y + lobe[3] * z), 0.0)
    return above / (np.pi * squared * squared)


@numba.njit(cache=True, nogil=True, inline="always")
def _behind_sphere(p, q, sphere):  # type: ignore[no-untyped-def]
    """As Sphere.hides, for one segment and a sphere (x, y, z, radius)."""
    length, along = 0.0, 0.0
    for axis in range(3):
        way = q[axis] - p[axis]
        length += way * way
        along -= (p[axis] - sphere[axis]) * way
    place = min(max(along / max(length, 1e-300), 0.0), 1.0)
    squared = 0.0
    for axis in range(3):
        nearest = p[axis] - sphere[axis] + place * (q[axis] - p[axis])
        squared += nearest * nearest
    return squared < sphere[3] * sphere[3]


@numba.njit(cache=True, nogil=True, inline="always")
def _blocked(p, q):  # type: ignore[no-untyped-def]
    """As visibility.blocked, for one segment."""
    span = q[0] - p[0]
    ends = END_TOLERANCE * abs(span)
    return (
        p[0] * q[0] < 0
        and abs(p[0]) > ends
        and abs(q[0]) > ends
        and abs(p[1] * q[0] - q[1] * p[0]) <= abs(span)
        and abs(p[2] * q[0] - q[2] * p[0]) <= abs(span)
    )


@numba.njit(cache=True, nogil=True)
def _entries(sides, i0, i1, j0, j1, out):  # type: ignore[no-untyped-def]
    """All entries of G between points p[i0:i1] and q[j0:j1], row-major."""
    at = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            p, q = sides.p[i], sides.q[j]
            value = sides.height_p[i] * sides.height_q[j]
            value *= _kernel(p, sides.lobes[i], q, sides.least)
            for sphere in range(sides.spheres.shape[0]):
                if _behind_sphere(p, q, sides.spheres[sphere]):
                    value = 0.0
            for occluder in range(sides.shadow_p.shape[0]):
                if _blocked(sides.shadow_p[occluder, i], sides.shadow_q[occluder, j]):
                    value = 0.0
            out[at] = value
            at += 1


@numba.njit(cache=True, nogil=True)
def _cross_approximation(p, q, lobes, least, most, left, right):  # type: ignore[no-untyped-def]
    """Factor the kernel between far points by adaptive cross approximation.

    Partial pivoting (Bebendorf, "Approximation of boundary element matrices", 2000): a residual's
    row is taken at the largest entry of the last column, until the last cross is small beside the
    norm of the sum. `left` (most, n_1) and `right` (most, n_2) receive the factors.

    Returns
    -------
    int
        The rank, or `most` + 1 where that wasn't enough.
    """
    m, n = p.shape[0], q.shape[0]
    free = np.ones(m, dtype=np.bool_)
    squared_norm = 0.0
    i = 0
    for k in range(most):
        free[i] = False
        best, j = 0.0, 0
        for c in range(n):
            value = _kernel(p[i], lobes[i], q[c], least)
            for r in range(k):
                value -= left[r, i] * right[r, c]
            right[k, c] = value
            if abs(value) > best:
                best, j = abs(value), c
        if best == 0.0:  # says nothing of the other rows
            return most + 1
        pivot = right[k, j]
        for c in range(n):
            right[k, c] /= pivot
        i, best = 0, -1.0
        for r in range(m):
            value = _kernel(p[r], lobes[r], q[j], least)
            for s in range(k):
                value -= left[s, r] * right[s, j]
            left[k, r] = value
            if free[r] and abs(value) > best:
                best, i = abs(value), r
        left_norm, right_norm = np.dot(left[k], left[k]), np.dot(right[k], right[k])
        for r in range(k):
            squared_norm += 2 * np.dot(left[r], left[k]) * np.dot(right[r], right[k])
        squared_norm += left_norm * right_norm
        if left_norm * right_norm <= _TOLERANCE * _TOLERANCE * squared_norm or best < 0:
            return k + 1
    return most + 1


@numba.njit(cache=True, nogil=True)
def fill_blocks(ranges, smooth, sides, rank, data):  # type: ignore[no-untyped-def]
    """Store blocks one after the other, smooth ones as factors where that is shorter.

    Parameters
    ----------
    ranges : int64 (blocks, 4)
        First and last + 1 tree position of either side.
    smooth : bool (blocks,)
        Whether to try factors.
    sides : Sides
    rank : int64 (blocks,)
        Receives the ranks; 0 means all entries.
    data : float32
        Receives the entries; as long as all blocks' entries together suffices.

    Returns
    -------
    int
        Length used of `data`.
    """
    used = 0
    for b in range(ranges.shape[0]):
        i0, i1, j0, j1 = ranges[b, 0], ranges[b, 1], ranges[b, 2], ranges[b, 3]
        m, n = i1 - i0, j1 - j0
        most = min(_MAX_RANK, (m * n - 1) // (m + n))
        k = most + 1
        if smooth[b]:
            left, right = np.empty((most, m)), np.empty((most, n))
            p, q = sides.p[i0:i1], sides.q[j0:j1]
            k = _cross_approximation(p, q, sides.lobes[i0:i1], sides.least, most, left, right)
        if k <= most:
            for i in range(m):
                for r in range(k):
                    data[used + i * k + r] = left[r, i] * sides.height_p[i0 + i]
            used += m * k
            for j in range(n):
                for r in range(k):
                    data[used + j * k + r] = right[r, j] * sides.height_q[j0 + j]
            used += n * k
            rank[b] = k
        else:
            _entries(sides, i0, i1, j0, j1, data[used : used + m * n])
            used += m * n
            rank[b] = 0
    return used


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _multiply(data, offset, row_step, column_step, rows, terms, x, y, partial):  # type: ignore[no-untyped-def]
    """Add a stored matrix (rows, terms) times x (terms, K) to y (rows, K).

    Sums of at most `_PANEL` terms run in float32 `partial` (K,), the longer ones over them in y's
    precision. Every column is treated alike, so that none depends on its neighbours.
    """
    columns = x.shape[1]
    for start in range(0, terms, _PANEL):
        stop = min(start + _PANEL, terms)
        for i in range(rows):
            for column in range(columns):
                partial[column] = 0.0
            at = offset + i * row_step
            j = start
            while j + 4 <= stop:  # four at a time: one pass over `partial` serves them all
                a = data[at + j * column_step]
                b = data[at + (j + 1) * column_step]
                c = data[at + (j + 2) * column_step]
                d = data[at + (j + 3) * column_step]
                for column in range(columns):
                    partial[column] += (a * x[j, column] + b * x[j + 1, column]) + (
                        c * x[j + 2, column] + d * x[j + 3, column]
                    )
                j += 4
            while j < stop:
                a = data[at + j * column_step]
                for column in range(columns):
                    partial[column] += a * x[j, column]
                j += 1
            for column in range(columns):
                y[i, column] += partial[column]


@numba.njit(cache=True, nogil=True)
def apply_blocks(chosen, transposed, ranges, rank, offset, data, x, y):  # type: ignore[no-untyped-def]
    """Add blocks times x to y, in the order given.

    Parameters
    ----------
    chosen : int64 (n,)
        The blocks.
    transposed : bool
        Whether x stands on the blocks' first side and y on the second.
    ranges, rank, offset : int64 (blocks, 4), (blocks,), (blocks,)
        What `fill_blocks` stored, and where.
    data : float32
    x : float32 (n_2, K), or n_1 if transposed
    y : float64 (n_1, K), or n_2 if transposed
        Added to in place.
    """
    columns = x.shape[1]
    partial = np.empty(columns, dtype=np.float32)
    inner = np.empty((_MAX_RANK, columns), dtype=np.float64)
    short = np.empty((_MAX_RANK, columns), dtype=np.float32)
    for b in chosen:
        i0, i1, j0, j1 = ranges[b, 0], ranges[b, 1], ranges[b, 2], ranges[b, 3]
        m, n, k = i1 - i0, j1 - j0, rank[b]
        left, right = offset[b], offset[b] + m * k
        row_step, column_step = n, 1
        if transposed:
            i0, i1, j0, j1 = j0, j1, i0, i1
            m, n = n, m
            left, right = right, left
            row_step, column_step = 1, row_step
        if k == 0:
            _multiply(data, offset[b], row_step, column_step, m, n, x[j0:j1], y[i0:i1], partial)
        else:
            for r in range(k):
                for column in range(columns):
                    inner[r, column] = 0.0
            _multiply(data, right, 1, k, k, n, x[j0:j1], inner, partial)
            for r in range(k):
                for column in range(columns):
                    short[r, column] = inner[r, column]
            _multiply(data, left, k, 1, m, k, short, y[i0:i1], partial)
