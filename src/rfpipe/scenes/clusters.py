"""Form factors of large scenes, stored as low-rank factors wherever they are smooth.

A hierarchical matrix (Hackbusch 1999; Bebendorf 2000): clusters of points far from each other and
wholly visible see each other through a smooth kernel, which adaptive cross approximation factors;
next to the edge between planes and along the borders of shadows, small blocks keep every entry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from rfpipe.scenes.formfactors import FacingPair
from rfpipe.scenes.surfaces import HIDDEN, VISIBLE, Hider, Sphere

Double = NDArray[np.float64]
Index = NDArray[np.int64]
Test = Callable[..., NDArray[np.int8]]  # of clusters of two trees
Entries = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]
Members = tuple[Index, NDArray[np.bool_]]
Sparse: TypeAlias = Any  # scipy's sparse array of float32

_LEAF_SIZE = 16  # points; the smaller, the fewer entries along a shadow's border
_SEPARATION = 0.5  # distance of smooth clusters over the larger one's diameter
_PAIRS_AT_A_TIME = 2**16  # cluster pairs tested against the occluders at once
_ENTRIES_AT_A_TIME = 2**18  # of blocks, or of the rows and columns of their factors
_MAX_RANK = 64  # a block that needs more is stored with all its entries
# Of the last cross of a smooth block, relative (Frobenius); what storing it as float32 costs.
_TOLERANCE = 1e-7


class ClusterTree:
    """A binary tree over points (n, 3) of a surface, cut at the median of the longest side.

    Cluster c has the children 2 c + 1 and 2 c + 2; those of a level have as many points, or one
    more.

    Attributes
    ----------
    order
        int64 (n,): point at each tree position; every cluster is a contiguous range of it.
    start, stop
        int64 (clusters,): each cluster's range.
    corners
        float64 (clusters, k, 3): corners of what bounds the points, a rectangle (k = 4) or a box
        (k = 8).
    centre, radius
        float64 (clusters, 3) and (clusters,): of a ball about it.
    """

    def __init__(self, positions: Double) -> None:
        middle = positions.mean(0)
        _, sizes, axes = np.linalg.svd(positions - middle, full_matrices=False)
        axes = axes[sizes >= 1e-9 * sizes.max()]
        places, count = (positions - middle) @ axes.T, len(positions)
        self.order = np.arange(count)
        self.levels = 1 + max(0, int(np.ceil(np.log2(count / _LEAF_SIZE))))
        ranges, bounds = [], []
        for level in range(self.levels):
            cuts = count * np.arange(2**level + 1) // 2**level
            here = places[self.order]
            low, high = (f.reduceat(here, cuts[:-1]) for f in (np.minimum, np.maximum))
            ranges.append((cuts[:-1], cuts[1:]))
            bounds.append((low, high))
            cluster = np.repeat(np.arange(2**level), np.diff(cuts))
            along = here[np.arange(count), np.argmax(high - low, axis=1)[cluster]]
            self.order = self.order[np.lexsort((along, cluster))]
        self.start, self.stop = np.concatenate(ranges, axis=1)
        ends: Double = np.concatenate(bounds, axis=1)
        corners = [
            np.stack([ends[end, :, axis] for axis, end in enumerate(corner)], axis=1) @ axes
            for corner in product((0, 1), repeat=len(axes))
        ]
        self.corners = np.stack(corners, axis=1) + middle
        self.centre = self.corners.mean(1)
        self.radius = np.linalg.norm(self.corners - self.centre[:, None], axis=2).max(1)

    def is_leaf(self, clusters: Index) -> NDArray[np.bool_]:
        """Whether clusters have no children."""
        return np.asarray(clusters >= 2 ** (self.levels - 1) - 1)

    def members(self, clusters: Index) -> tuple[Index, NDArray[np.bool_]]:
        """Points of clusters of one level, (n, m), and which of them aren't the last repeated."""
        start, stop = self.start[clusters, None], self.stop[clusters, None]
        places = start + np.arange((stop - start).max())
        return self.order[np.minimum(places, stop - 1)], places < stop


def cluster_pairs(pair: FacingPair, one: ClusterTree, two: ClusterTree) -> tuple[Index, ...]:
    """Subdivide pairs of clusters until each is smooth, hidden, or a pair of leaves.

    Returns
    -------
    first, second, smooth
        (n,): clusters of either tree, which partition all pairs of points less those known to be
        hidden, and whether they are so far apart, and wholly visible, that G is smooth there.
    """
    tests = _visibility_tests(pair, one, two)
    a = b = np.zeros(1, np.int64)
    done = []
    while len(a):
        visibility = _visibility(a, b, tests)
        larger = np.maximum(one.radius[a], two.radius[b])
        gap = np.linalg.norm(one.centre[a] - two.centre[b], axis=1) - one.radius[a] - two.radius[b]
        least = np.maximum(2 * _SEPARATION * larger, np.sqrt(pair.least_squared_distance))
        smooth = (visibility == VISIBLE) & (gap >= least)
        leaf_a, leaf_b = one.is_leaf(a), two.is_leaf(b)
        kept = (smooth | (leaf_a & leaf_b)) & (visibility != HIDDEN)
        done.append((a[kept], b[kept], smooth[kept]))
        cut = ~kept & (visibility != HIDDEN)
        of_a = (~leaf_a & (leaf_b | (one.radius[a] >= two.radius[b])))[cut]
        a, b = a[cut], b[cut]
        a, b = (
            np.stack([np.where(chosen, 2 * each + side, each) for side in (1, 2)], axis=1).ravel()
            for each, chosen in ((a, of_a), (b, ~of_a))
        )
    return tuple(np.concatenate(part) for part in zip(*done, strict=True))


def _visibility_tests(pair: FacingPair, one: ClusterTree, two: ClusterTree) -> list[Test]:
    """List what may hide clusters (n,) of two trees from each other, as tests of them."""

    def behind(hider: Hider, classify: Any, side: int = 0) -> Test:
        corners = [hider.coordinates(tree.corners) for tree in (one, two)]
        return lambda *clusters: classify(*(corners[k][clusters[k]] for k in (side, 1 - side)))

    tests = [behind(hider, hider.classify) for hider in pair.hiders]
    for side, surface in enumerate(pair.surfaces):
        if isinstance(surface, Sphere):
            tests.append(behind(surface, surface.facing, side))
    return tests


def _visibility(a: Index, b: Index, tests: Sequence[Test]) -> NDArray[np.int8]:
    """What clusters are to each other behind all that may hide them: hidden by one is hidden."""
    verdict = np.full(len(a), VISIBLE)
    for start in range(0, len(a), _PAIRS_AT_A_TIME):
        part = slice(start, start + _PAIRS_AT_A_TIME)
        for test in tests:
            now, here = verdict[part], test(a[part], b[part])
            hidden = (now == HIDDEN) | (here == HIDDEN)
            verdict[part] = np.where(hidden, HIDDEN, np.maximum(now, here))
    return verdict


@dataclass(frozen=True)
class Compressed:
    """A block of G: ``near + left.T @ right``, float32; a column's product is its own.

    Parameters
    ----------
    near
        Sparse (n_1, n_2): entries of small blocks.
    left, right
        Sparse (r, n_1) and (r, n_2): factors of the smooth blocks.
    """

    near: Sparse
    left: Sparse
    right: Sparse

    @property
    def T(self) -> Compressed:  # noqa: N802 - as NumPy has it
        """The transpose."""
        return Compressed(self.near.T, self.right, self.left)

    def __matmul__(self, columns: Double) -> NDArray[np.float32]:
        x = columns.astype(np.float32)
        return np.asarray(self.near @ x + self.left.T @ (self.right @ x))


def compressed(pair: FacingPair) -> Compressed:
    """Compress a pair's block of G."""
    one, two = ClusterTree(pair.positions[0]), ClusterTree(pair.positions[1])
    counts = len(one.order), len(two.order)
    a, b, smooth = cluster_pairs(pair, one, two)
    full, near, left, right, ranks = [(a[~smooth], b[~smooth])], [], [], [], 0
    for some, others in _batches(one, two, a[smooth], b[smooth], np.add):
        (i, is_row), (j, is_column) = one.members(some), two.members(others)
        u, v, rank = _cross_approximation(pair, i, is_row, j)
        left.append(_stacked(u * pair.heights[0][i], rank, i, is_row, ranks))
        right.append(_stacked(v * pair.heights[1][j], rank, j, is_column, ranks))
        full.append((some[rank == 0], others[rank == 0]))
        ranks += int(rank.sum())
    for blocks in full:
        for some, others in _batches(one, two, *blocks, np.multiply):
            near.append(_entries(pair, one.members(some), two.members(others)))
    shapes = counts, (ranks, counts[0]), (ranks, counts[1])
    return Compressed(*map(_sparse, (near, left, right), shapes))


def _sparse(parts: Sequence[Entries], shape: tuple[int, int]) -> Sparse:
    """Return values at rows and columns, in parts, as a sparse matrix."""
    nothing = np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)
    values, *places = (np.concatenate(each) for each in zip(nothing, *parts, strict=True))
    return csr_array((values, tuple(places)), shape=shape)


def _batches(
    one: ClusterTree, two: ClusterTree, a: Index, b: Index, work: Callable[[int, int], int]
) -> Iterator[tuple[Index, Index]]:
    """Cut pairs of clusters into batches, each of two levels and about as much work."""
    level = np.stack([np.frexp(each + 1)[1] - 1 for each in (a, b)])
    for levels in np.unique(level, axis=1).T:
        sizes = (-(-len(tree.order) // 2**k) for tree, k in zip((one, two), levels, strict=True))
        step = max(1, _ENTRIES_AT_A_TIME // work(*sizes))
        same = np.flatnonzero((level == levels[:, None]).all(0))
        for start in range(0, len(same), step):
            some = same[start : start + step]
            yield a[some], b[some]


def _entries(pair: FacingPair, rows: Members, columns: Members) -> Entries:
    """Return blocks' entries that aren't zero."""
    (i, is_row), (j, is_column) = rows, columns
    values = pair.entries(i[:, :, None], j[:, None])
    values *= is_row[:, :, None] & is_column[:, None]
    block, row, column = np.nonzero(values)
    places = i[block, row].astype(np.int32), j[block, column].astype(np.int32)
    return values[block, row, column].astype(np.float32), *places


def _cross_approximation(
    pair: FacingPair, i: Index, is_row: NDArray[np.bool_], j: Index
) -> tuple[Double, Double, Index]:
    """Factor blocks of rows i (n, m_1) and columns j (n, m_2) by adaptive cross approximation.

    Partial pivoting (Bebendorf, "Approximation of boundary element matrices", 2000): a residual's
    row is taken at the largest entry of the last column, until the last cross is small beside the
    norm of the sum.

    Returns
    -------
    left, right, rank
        (k, n, m_1) and (k, n, m_2), the first `rank` (n,) of which make a block; 0 where
        `_MAX_RANK` isn't enough.
    """
    left, right = (np.zeros((_MAX_RANK, *each.shape)) for each in (i, j))
    n = np.arange(len(i))  # the blocks that aren't done
    free, squared = is_row.copy(), np.zeros(len(i))
    rank, row = np.zeros((2, len(i)), np.int64)
    for k in range(_MAX_RANK):
        u, v = left[:k, n], right[:k, n]
        at = np.arange(len(n))
        line = pair.smooth(i[n, row][:, None], j[n])
        line -= np.einsum("kn,knm->nm", u[:, at, row], v)
        column = np.argmax(np.abs(line), axis=1)
        pivot = line[at, column]
        line /= np.where(pivot == 0, 1, pivot)[:, None]
        post = pair.smooth(i[n], j[n, column][:, None])
        post -= np.einsum("knm,kn->nm", u, v[:, at, column])
        left[k, n], right[k, n] = post, line
        size = (post**2).sum(1) * (line**2).sum(1)
        both = np.einsum("knm,nm->kn", u, post) * np.einsum("knm,nm->kn", v, line)
        squared[n] += size + 2 * both.sum(0)
        done = (size <= _TOLERANCE**2 * squared[n]) & (pivot != 0)
        rank[n[done]] = k + 1
        free[n, row] = False
        row = np.argmax(np.where(free[n], np.abs(post), -1), axis=1)
        goes_on = ~done & (pivot != 0)  # a row of zeros says nothing of the others
        n, row = n[goes_on], row[goes_on]
        if not len(n):
            break
    return left, right, rank


def _stacked(
    factors: Double, rank: Index, points: Index, is_point: NDArray[np.bool_], first: int
) -> Entries:
    """Return blocks' factors (k, n, m) at points (n, m), stacked in rows from a first one on."""
    has = np.arange(len(factors))[:, None] < rank
    k, block, member = np.nonzero(has[..., None] & is_point)
    row = (first + np.cumsum(rank) - rank)[block] + k
    places = row.astype(np.int32), points[block, member].astype(np.int32)
    return factors[k, block, member].astype(np.float32), *places
