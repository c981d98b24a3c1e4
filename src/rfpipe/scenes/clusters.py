"""Form factors of large scenes as hierarchical matrices with low-rank blocks.

Between distant, mutually visible clusters of points, the kernel is smooth and its block is factored
by adaptive cross approximation; near edges between planes and shadow boundaries, small blocks store
all entries (Hackbusch 1999; Bebendorf 2000).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from rfpipe.array_types import Double, Index
from rfpipe.scenes.formfactors import FacingPair
from rfpipe.scenes.surfaces import OCCLUDED, VISIBLE, Obstruction, Sphere

Test = Callable[..., NDArray[np.int8]]  # visibility between clusters of two trees
Entries = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]
Members = tuple[Index, NDArray[np.bool_]]
Sparse: TypeAlias = Any  # scipy's sparse array of float32

_LEAF_SIZE = 16  # points; smaller leaves need fewer entries along shadow boundaries
_SEPARATION = 0.5  # distance of smooth clusters, relative to the larger diameter
_PAIRS_AT_A_TIME = 2**16  # pairs of clusters in a batch of visibility tests
_ENTRIES_AT_A_TIME = 2**18  # entries of blocks or of their factors in a batch
_MAX_RANK = 64  # blocks of higher rank store all entries
# Relative Frobenius norm of the last cross of a smooth block; similar to rounding to float32.
_TOLERANCE = 1e-7


class ClusterTree:
    """A binary tree of clusters of points (n, 3), split at the median of the longest side.

    Cluster c has the children 2 c + 1 and 2 c + 2. Numbers of points within a level differ by at
    most one.

    Attributes
    ----------
    order
        int64 (n,): point at each tree position; a cluster is a contiguous range.
    start, stop
        int64 (clusters,): range of each cluster.
    corners
        float64 (clusters, k, 3): corners of the bounding rectangle (k = 4) or box (k = 8).
    centre, radius
        float64 (clusters, 3) and (clusters,): bounding ball.
    """

    def __init__(self, positions: Double) -> None:
        middle = positions.mean(0)
        _, sizes, axes = np.linalg.svd(positions - middle, full_matrices=False)
        axes = axes[sizes >= 1e-9 * sizes.max()]
        coordinates, count = (positions - middle) @ axes.T, len(positions)
        self.order = np.arange(count)
        self.levels = 1 + max(0, int(np.ceil(np.log2(count / _LEAF_SIZE))))
        ranges, bounds = [], []
        for level in range(self.levels):
            cuts = count * np.arange(2**level + 1) // 2**level
            ordered = coordinates[self.order]
            low, high = (f.reduceat(ordered, cuts[:-1]) for f in (np.minimum, np.maximum))
            ranges.append((cuts[:-1], cuts[1:]))
            bounds.append((low, high))
            cluster = np.repeat(np.arange(2**level), np.diff(cuts))
            along = ordered[np.arange(count), np.argmax(high - low, axis=1)[cluster]]
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
        """Test which clusters have no children."""
        return np.asarray(clusters >= 2 ** (self.levels - 1) - 1)

    def members(self, clusters: Index) -> tuple[Index, NDArray[np.bool_]]:
        """Points (n, m) of clusters of a level, padded by repetition, and a mask of valid ones."""
        start, stop = self.start[clusters, None], self.stop[clusters, None]
        positions = start + np.arange((stop - start).max())
        return self.order[np.minimum(positions, stop - 1)], positions < stop


def cluster_pairs(pair: FacingPair, tree_a: ClusterTree, tree_b: ClusterTree) -> tuple[Index, ...]:
    """Subdivide pairs of clusters until each is smooth, occluded, or a pair of leaves.

    Returns
    -------
    first, second, smooth
        (n,): clusters of both trees, which partition all pairs of points except occluded ones;
        `smooth` is True if they are fully visible and so distant that G is smooth.
    """
    tests = _visibility_tests(pair, tree_a, tree_b)
    a = b = np.zeros(1, np.int64)
    done = []
    while len(a):
        visibility = _visibility(a, b, tests)
        larger = np.maximum(tree_a.radius[a], tree_b.radius[b])
        gap = (
            np.linalg.norm(tree_a.centre[a] - tree_b.centre[b], axis=1)
            - tree_a.radius[a]
            - tree_b.radius[b]
        )
        least = np.maximum(2 * _SEPARATION * larger, np.sqrt(pair.min_squared_distance))
        smooth = (visibility == VISIBLE) & (gap >= least)
        leaf_a, leaf_b = tree_a.is_leaf(a), tree_b.is_leaf(b)
        final = (smooth | (leaf_a & leaf_b)) & (visibility != OCCLUDED)
        done.append((a[final], b[final], smooth[final]))
        split = ~final & (visibility != OCCLUDED)
        splits_a = (~leaf_a & (leaf_b | (tree_a.radius[a] >= tree_b.radius[b])))[split]
        a, b = a[split], b[split]
        a, b = (
            np.stack(
                [np.where(splits, 2 * cluster + child, cluster) for child in (1, 2)], axis=1
            ).ravel()
            for cluster, splits in ((a, splits_a), (b, ~splits_a))
        )
    return tuple(np.concatenate(part) for part in zip(*done, strict=True))


def _visibility_tests(pair: FacingPair, tree_a: ClusterTree, tree_b: ClusterTree) -> list[Test]:
    """List the visibility tests between clusters (n,) of two trees."""

    def test_of(obstruction: Obstruction, classify: Any, side: int = 0) -> Test:
        corners = [obstruction.coordinates(tree.corners) for tree in (tree_a, tree_b)]
        return lambda *clusters: classify(*(corners[k][clusters[k]] for k in (side, 1 - side)))

    tests = [test_of(obstruction, obstruction.classify) for obstruction in pair.obstructions]
    for side, surface in enumerate(pair.surfaces):
        if isinstance(surface, Sphere):
            tests.append(test_of(surface, surface.facing, side))
    return tests


def _visibility(a: Index, b: Index, tests: Sequence[Test]) -> NDArray[np.int8]:
    """Combine all visibility tests of pairs of clusters; occlusion by one obstruction suffices."""
    verdict = np.full(len(a), VISIBLE)
    for start in range(0, len(a), _PAIRS_AT_A_TIME):
        part = slice(start, start + _PAIRS_AT_A_TIME)
        for test in tests:
            current, result = verdict[part], test(a[part], b[part])
            occluded = (current == OCCLUDED) | (result == OCCLUDED)
            verdict[part] = np.where(occluded, OCCLUDED, np.maximum(current, result))
    return verdict


@dataclass(frozen=True)
class Compressed:
    """A block of G, ``near + left.T @ right``, float32.

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
    def T(self) -> Compressed:  # noqa: N802 - as in NumPy
        """The transpose."""
        return Compressed(self.near.T, self.right, self.left)

    def __matmul__(self, columns: Double) -> NDArray[np.float32]:
        x = columns.astype(np.float32)
        return np.asarray(self.near @ x + self.left.T @ (self.right @ x))


def compress_block(pair: FacingPair) -> Compressed:
    """Compress the block of G of a pair of surfaces."""
    tree_a, tree_b = ClusterTree(pair.positions[0]), ClusterTree(pair.positions[1])
    counts = len(tree_a.order), len(tree_b.order)
    a, b, smooth = cluster_pairs(pair, tree_a, tree_b)
    full, near, left, right, ranks = [(a[~smooth], b[~smooth])], [], [], [], 0
    for batch_a, batch_b in _batches(tree_a, tree_b, a[smooth], b[smooth], np.add):
        (i, is_row), (j, is_column) = tree_a.members(batch_a), tree_b.members(batch_b)
        u, v, rank = _cross_approximation(pair, i, is_row, j)
        left.append(_stacked(u * pair.heights[0][i], rank, i, is_row, ranks))
        right.append(_stacked(v * pair.heights[1][j], rank, j, is_column, ranks))
        full.append((batch_a[rank == 0], batch_b[rank == 0]))
        ranks += int(rank.sum())
    for blocks in full:
        for batch_a, batch_b in _batches(tree_a, tree_b, *blocks, np.multiply):
            near.append(_entries(pair, tree_a.members(batch_a), tree_b.members(batch_b)))
    shapes = counts, (ranks, counts[0]), (ranks, counts[1])
    return Compressed(*map(_sparse, (near, left, right), shapes))


def _sparse(parts: Sequence[Entries], shape: tuple[int, int]) -> Sparse:
    """Build a sparse matrix of parts, each with values, rows and columns."""
    empty = np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)
    values, *indices = (np.concatenate(arrays) for arrays in zip(empty, *parts, strict=True))
    return csr_array((values, tuple(indices)), shape=shape)


def _batches(
    tree_a: ClusterTree, tree_b: ClusterTree, a: Index, b: Index, work: Callable[[int, int], int]
) -> Iterator[tuple[Index, Index]]:
    """Divide pairs of clusters into batches of the same two levels and of limited work."""
    level = np.stack([np.frexp(clusters + 1)[1] - 1 for clusters in (a, b)])
    for levels in np.unique(level, axis=1).T:
        sizes = (
            -(-len(tree.order) // 2**k) for tree, k in zip((tree_a, tree_b), levels, strict=True)
        )
        step = max(1, _ENTRIES_AT_A_TIME // work(*sizes))
        same = np.flatnonzero((level == levels[:, None]).all(0))
        for start in range(0, len(same), step):
            batch = same[start : start + step]
            yield a[batch], b[batch]


def _entries(pair: FacingPair, rows: Members, columns: Members) -> Entries:
    """Compute the nonzero entries of blocks."""
    (i, is_row), (j, is_column) = rows, columns
    values = pair.entries(i[:, :, None], j[:, None])
    values *= is_row[:, :, None] & is_column[:, None]
    block, row, column = np.nonzero(values)
    indices = i[block, row].astype(np.int32), j[block, column].astype(np.int32)
    return values[block, row, column].astype(np.float32), *indices


def _cross_approximation(
    pair: FacingPair, i: Index, is_row: NDArray[np.bool_], j: Index
) -> tuple[Double, Double, Index]:
    """Factor blocks of rows i (n, m_1) and columns j (n, m_2) by adaptive cross approximation.

    Partial pivoting (Bebendorf, "Approximation of boundary element matrices", 2000): the next row
    of the residual is that of the largest entry in the last column, until the norm of the last
    cross is small relative to that of the sum.

    Returns
    -------
    left, right, rank
        (k, n, m_1) and (k, n, m_2): factors of the blocks, of which the first `rank` (n,) are
        used; 0 where `_MAX_RANK` doesn't suffice.
    """
    left, right = (np.zeros((_MAX_RANK, *points.shape)) for points in (i, j))
    n = np.arange(len(i))  # blocks in progress
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
        mixed = np.einsum("knm,nm->kn", u, post) * np.einsum("knm,nm->kn", v, line)
        squared[n] += size + 2 * mixed.sum(0)
        done = (size <= _TOLERANCE**2 * squared[n]) & (pivot != 0)
        rank[n[done]] = k + 1
        free[n, row] = False
        row = np.argmax(np.where(free[n], np.abs(post), -1), axis=1)
        continues = ~done & (pivot != 0)  # a row of zeros doesn't imply a zero residual
        n, row = n[continues], row[continues]
        if not len(n):
            break
    return left, right, rank


def _stacked(
    factors: Double, rank: Index, points: Index, is_point: NDArray[np.bool_], first: int
) -> Entries:
    """Stack the factors (k, n, m) of blocks at points (n, m) as rows, from row `first` on."""
    is_used = np.arange(len(factors))[:, None] < rank
    k, block, member = np.nonzero(is_used[..., None] & is_point)
    row = (first + np.cumsum(rank) - rank)[block] + k
    indices = row.astype(np.int32), points[block, member].astype(np.int32)
    return factors[k, block, member].astype(np.float32), *indices
