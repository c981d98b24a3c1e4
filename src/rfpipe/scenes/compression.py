"""Form factors of large scenes, stored as low-rank factors wherever they are smooth.

A hierarchical matrix (Hackbusch 1999; Bebendorf 2000): clusters of points far from each other and
wholly visible see each other through a smooth kernel, which adaptive cross approximation factors;
next to the edge between planes and along the borders of shadows, small blocks keep every entry.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.clusters import ClusterTree, cluster_pairs
from rfpipe.scenes.formfactors import FacingPair
from rfpipe.scenes.kernels import Sides, apply_blocks, fill_blocks
from rfpipe.scenes.visibility import GRAZING, Sphere

_LEAF_SIZE = 16  # points; the smaller, the fewer entries along a shadow's border
_SEPARATION = 0.5  # distance of smooth clusters over the larger one's diameter
_SHARE_DEPTH = 4  # depth of the trees at which the work is shared out: 16 shares
_CHUNK_ENTRIES = 2**24  # entries that blocks filled together may have


class CompressedBlock:
    """G between two surfaces as a hierarchical matrix.

    Sums run in the same order whatever the number of threads, to about float32's precision.
    """

    def __init__(self, pair: FacingPair) -> None:
        one, two = trees = tuple(
            ClusterTree.of_surface(surface, positions, _LEAF_SIZE)
            for surface, positions in zip(pair.surfaces, pair.positions, strict=True)
        )
        self.pixels = (pair.indices[0][one.order], pair.indices[1][two.order])
        clusters = cluster_pairs(
            (one, two),
            pair.occluders,
            separation=_SEPARATION,
            least_distance=np.sqrt(pair.least_squared_distance),
            depth=_SHARE_DEPTH,
            between=pair.between,
            facing=first if isinstance(first := pair.surfaces[0], Sphere) else None,
        )
        chosen = clusters.first, clusters.second
        ends = [(tree.start[c], tree.stop[c]) for tree, c in zip(trees, chosen, strict=True)]
        self.ranges = np.stack([*ends[0], *ends[1]], axis=1)
        # Blocks of a share write to rows of their own.
        self.shares = [tree.shares(c, _SHARE_DEPTH) for tree, c in zip(trees, chosen, strict=True)]
        self._fill(_sides(pair, (one.order, two.order)), clusters.smooth)

    @property
    def nbytes(self) -> int:
        """Bytes of the stored factors and entries."""
        return self.data.nbytes

    def _fill(self, sides: Sides, smooth: NDArray[np.bool_]) -> None:
        """Compute the blocks' factors and entries."""
        lengths = self.ranges[:, 1::2] - self.ranges[:, ::2]
        entries = lengths.prod(axis=1)
        self.rank = np.zeros(len(entries), dtype=np.int64)
        chunk = np.cumsum(entries) // _CHUNK_ENTRIES
        bounds = np.flatnonzero(np.diff(chunk, prepend=-1, append=-1)) if len(chunk) else [0]

        def fill(start: int, stop: int) -> NDArray[np.float32]:
            some = slice(start, stop)
            data = np.empty(int(entries[some].sum()), dtype=np.float32)
            used = fill_blocks(self.ranges[some], smooth[some], sides, self.rank[some], data)
            return data[:used].copy()

        with ThreadPoolExecutor(_threads()) as pool:
            parts = list(pool.map(fill, bounds[:-1], bounds[1:]))
        self.data = np.concatenate(parts) if parts else np.empty(0, dtype=np.float32)
        stored = np.where(self.rank == 0, entries, lengths.sum(axis=1) * self.rank)
        self.offset = np.cumsum(stored) - stored

    def add_to(self, out: NDArray[np.float64], columns: NDArray[np.float64]) -> None:
        """Add this block of G, and its transpose, times columns (N, K) to out (N, K)."""
        for transposed, shares in enumerate(self.shares):
            here, there = self.pixels[transposed], self.pixels[1 - transposed]
            x = columns[there].astype(np.float32)
            y = np.zeros((len(here), columns.shape[1]))
            stored = bool(transposed), self.ranges, self.rank, self.offset, self.data, x, y
            with ThreadPoolExecutor(_threads()) as pool:
                list(pool.map(lambda chosen, stored=stored: apply_blocks(chosen, *stored), shares))
            out[here] += y


def _sides(pair: FacingPair, orders: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Sides:
    """Return what the kernels need to know of the points of either surface, in some order."""
    p, q = (points[order] for points, order in zip(pair.positions, orders, strict=True))
    height_p, height_q = (each[order] for each, order in zip(pair.heights, orders, strict=True))
    shadow_p, shadow_q = (
        np.array([each.coordinates(points) for each in pair.occluders]).reshape(-1, len(points), 3)
        for points in (p, q)
    )
    lobes = np.zeros((len(p), 4))
    if pair.normals is None:
        lobes[:, 0] = 1
    else:
        lobes[:, 1:] = pair.normals[orders[0]]
    spheres = np.zeros((0, 4))
    if pair.between is not None:
        spheres = np.array([[*pair.between.centre, (1 - GRAZING) * pair.between.radius]])
    least = pair.least_squared_distance
    return Sides(p, q, lobes, spheres, shadow_p, shadow_q, height_p, height_q, least)


def _threads() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
