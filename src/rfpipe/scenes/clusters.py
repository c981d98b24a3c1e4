"""Clusters of neighbouring points, and pairs of them that see each other simply."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.geometry import Plane, Surface
from rfpipe.scenes.visibility import HIDDEN, VISIBLE, Occluder, Sphere, classify

_PAIRS_AT_A_TIME = 2**16  # cluster pairs tested against the occluders at once


@dataclass(frozen=True)
class ClusterTree:
    """A binary tree over points of a surface, cut at the median of the longest side.

    Parameters
    ----------
    order
        int64 (n,): point at each tree position; every cluster is a contiguous range of it.
    start, stop
        int64 (clusters,): each cluster's range.
    child
        int64 (clusters,): first of the two children, which are neighbours; -1 for a leaf.
    depth
        int64 (clusters,): 0 is the root.
    corners
        float64 (clusters, k, 3): corners of what bounds the points, a rectangle in their plane
        (k = 4) or a box (k = 8); the first and the last are opposite.
    """

    order: NDArray[np.int64]
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    child: NDArray[np.int64]
    depth: NDArray[np.int64]
    corners: NDArray[np.float64]

    @cached_property
    def radius(self) -> NDArray[np.float64]:
        """Half the diagonal of what bounds each cluster, float64 (clusters,)."""
        return np.asarray(np.linalg.norm(self.corners[:, -1] - self.corners[:, 0], axis=1) / 2)

    @cached_property
    def centre(self) -> NDArray[np.float64]:
        """Centre of what bounds each cluster, float64 (clusters, 3)."""
        return np.asarray(self.corners.mean(1))

    def roots(self, depth: int) -> NDArray[np.int64]:
        """Clusters of one depth, and the leaves above it: together they hold every point."""
        chosen = (self.depth == depth) | ((self.depth < depth) & (self.child < 0))
        return np.flatnonzero(chosen)

    def shares(self, clusters: NDArray[np.int64], depth: int) -> list[NDArray[np.int64]]:
        """Where clusters (n,) stand that are under the same root of a depth, for each of these."""
        roots = np.sort(self.start[self.roots(depth)])
        number = np.searchsorted(roots, self.start[clusters], "right")
        return [np.flatnonzero(number == each) for each in np.unique(number)]

    @classmethod
    def of_surface(
        cls, surface: Surface, positions: NDArray[np.float64], leaf_size: int
    ) -> ClusterTree:
        """Build the tree of points (n, 3) of a surface, with at most `leaf_size` a leaf."""
        if isinstance(surface, Plane):
            axes, origin = surface.axes(), np.asarray(surface.point)
        else:
            axes, origin = np.eye(3), np.asarray(surface.centre)
        flat = (positions - origin) @ axes.T
        order = np.arange(len(flat))
        start, stop, child, depth = [0], [len(flat)], [-1], [0]
        low, high = [], []
        node = 0
        while node < len(start):
            a, b = start[node], stop[node]
            members = order[a:b]
            here = flat[members]
            low.append(here.min(0))
            high.append(here.max(0))
            if b - a > leaf_size:
                longest = int(np.argmax(high[-1] - low[-1]))
                half = (b - a) // 2
                order[a:b] = members[np.argsort(here[:, longest], kind="stable")]
                child[node] = len(start)
                start += [a, a + half]
                stop += [a + half, b]
                child += [-1, -1]
                depth += [depth[node] + 1] * 2
            node += 1
        bounds = np.stack([low, high])  # (2, clusters, axes)
        ends = product((0, 1), repeat=len(axes))
        corners = [
            np.stack([bounds[end, :, axis] for axis, end in enumerate(corner)], axis=1) @ axes
            for corner in ends
        ]
        bound = np.stack(corners, axis=1) + origin
        first, last, below = np.array(start), np.array(stop), np.array(child)
        return cls(order, first, last, below, np.array(depth), bound)


@dataclass(frozen=True)
class ClusterPairs:
    """A partition of all pairs of points of two surfaces, less those known to be hidden.

    Parameters
    ----------
    first, second
        int64 (n,): cluster of either tree.
    smooth
        bool (n,): far apart and wholly visible, so that G is smooth there; the others are small.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    smooth: NDArray[np.bool_]


def cluster_pairs(
    trees: tuple[ClusterTree, ClusterTree],
    occluders: Sequence[Occluder],
    *,
    separation: float,
    least_distance: float,
    depth: int,
    between: Sphere | None = None,
    facing: Sphere | None = None,
) -> ClusterPairs:
    """Subdivide pairs of clusters until each is smooth, hidden, or a pair of leaves.

    Parameters
    ----------
    trees
        Clusters of either surface.
    occluders
        What may hide them from each other. A pair counts as visible or hidden only where that
        is proved for all its points.
    separation
        A pair is far apart if the distance between the clusters is at least `separation` times
        the larger one's diameter.
    least_distance
        ... and at least this, the clamp of the distances, scene units.
    depth
        Depth of both trees at which to start.
    between
        A sphere that may hide two planes from each other.
    facing
        The sphere on which the first tree's points lie.

    Returns
    -------
    ClusterPairs
        In a fixed order.
    """
    one, two = trees
    tests = _visibility_tests(one, two, occluders, between, facing)
    roots = np.meshgrid(one.roots(depth), two.roots(depth), indexing="ij")
    a, b = (grid.ravel() for grid in roots)
    done: list[tuple[NDArray[Any], ...]] = []
    while len(a):
        visibility = _visibility(a, b, tests)
        gap = np.linalg.norm(one.centre[a] - two.centre[b], axis=1) - one.radius[a] - two.radius[b]
        larger = np.maximum(one.radius[a], two.radius[b])
        smooth = (visibility == VISIBLE) & (
            gap >= np.maximum(separation * 2 * larger, least_distance)
        )
        leaf_a, leaf_b = one.child[a] < 0, two.child[b] < 0
        kept = (smooth | (leaf_a & leaf_b)) & (visibility != HIDDEN)
        done.append((a[kept], b[kept], smooth[kept]))

        open_ = ~kept & (visibility != HIDDEN)
        a, b = a[open_], b[open_]
        cut_a = ~leaf_a[open_] & (leaf_b[open_] | (one.radius[a] >= two.radius[b]))
        a = np.stack([np.where(cut_a, one.child[a] + side, a) for side in (0, 1)], 1).ravel()
        b = np.stack([np.where(cut_a, b, two.child[b] + side) for side in (0, 1)], 1).ravel()
    return ClusterPairs(*(np.concatenate(part) for part in zip(*done, strict=True)))


_Test = Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.int8]]


def _visibility_tests(
    one: ClusterTree,
    two: ClusterTree,
    occluders: Sequence[Occluder],
    between: Sphere | None,
    facing: Sphere | None,
) -> list[_Test]:
    """List what may hide clusters (n,) of two trees from each other, as tests of them."""

    def behind(occluder: Occluder) -> _Test:
        first, second = occluder.coordinates(one.corners), occluder.coordinates(two.corners)
        return lambda a, b: classify(first[a], second[b])

    tests = [behind(occluder) for occluder in occluders]
    if between is not None:
        tests.append(
            lambda a, b: between.classify_between(
                one.centre[a], two.centre[b], np.maximum(one.radius[a], two.radius[b])
            )
        )
    if facing is not None:
        tests.append(
            lambda a, b: facing.classify_facing(one.centre[a], one.radius[a], two.corners[b])
        )
    return tests


def _visibility(
    a: NDArray[np.int64], b: NDArray[np.int64], tests: Sequence[_Test]
) -> NDArray[np.int8]:
    """What clusters are to each other behind all that may hide them: hidden by one is hidden."""
    verdict = np.full(len(a), VISIBLE)
    for start in range(0, len(a), _PAIRS_AT_A_TIME):
        part = slice(start, start + _PAIRS_AT_A_TIME)
        for test in tests:
            now, here = verdict[part], test(a[part], b[part])
            hidden = (now == HIDDEN) | (here == HIDDEN)
            verdict[part] = np.where(hidden, HIDDEN, np.maximum(now, here))
    return verdict
