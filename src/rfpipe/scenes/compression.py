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
from rfpipe.scenes.facing import FacingPair
from rfpipe.scenes.geometry import Sphere
from rfpipe.scenes.kernels import apply_blocks, fill_blocks
from rfpipe.scenes.occluders import END_TOLERANCE
from rfpipe.scenes.spheres import GRAZING

__all__ = ["TOLERANCE", "CompressedBlock"]

# Relative error (Frobenius) of a smooth block; about what storing factors as float32 costs.
TOLERANCE = 3e-7
_LEAF_SIZE = 16  # points; the smaller, the fewer entries along a shadow's border
_SEPARATION = 0.5  # distance of smooth clusters over the larger one's diameter
_SHARE_DEPTH = 4  # depth of the trees at which the work is shared out: 16 shares
_CHUNK_ENTRIES = 2**24  # entries that blocks filled together may have


class CompressedBlock:
    """G between two surfaces as a hierarchical matrix.

    Sums run in the same order whatever the number of threads, to about float32's precision.
    """

    def __init__(self, pair: FacingPair) -> None:
        one, two = (
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
        self.ranges = np.stack(
            [
                one.start[clusters.first],
                one.stop[clusters.first],
                two.start[clusters.second],
                two.stop[clusters.second],
            ],
            axis=1,
        )
        # Blocks of a share write to rows of their own.
        self.shares = (
            one.shares(clusters.first, _SHARE_DEPTH),
            two.shares(clusters.second, _SHARE_DEPTH),
        )
        self._fill(pair, (one.order, two.order), clusters.smooth)

    @property
    def nbytes(self) -> int:
        """Bytes of the stored factors and entries."""
        return self.data.nbytes

    def _fill(
        self,
        pair: FacingPair,
        orders: tuple[NDArray[np.int64], NDArray[np.int64]],
        smooth: NDArray[np.bool_],
    ) -> None:
        """Compute the blocks' factors and entries."""
        positions = [points[order] for points, order in zip(pair.positions, orders, strict=True)]
        shadows = [
            np.array([occluder.coordinates(points) for occluder in pair.occluders]).reshape(
                -1, len(points), 3
            )
            for points in positions
        ]
        lobes = np.zeros((len(positions[0]), 4))
        if pair.normals is None:
            lobes[:, 0] = 1
        else:
            lobes[:, 1:] = pair.normals[orders[0]]
        spheres = np.zeros((0, 4))
        if pair.between is not None:
            spheres = np.array([[*pair.between.centre, (1 - GRAZING) * pair.between.radius]])
        heights = [height[order] for height, order in zip(pair.heights, orders, strict=True)]
        entries = (self.ranges[:, 1] - self.ranges[:, 0]) * (self.ranges[:, 3] - self.ranges[:, 2])
        self.rank = np.zeros(len(entries), dtype=np.int64)
        chunk = np.cumsum(entries) // _CHUNK_ENTRIES
        bounds = np.flatnonzero(np.diff(chunk, prepend=-1, append=-1)) if len(chunk) else [0]

        def fill(start: int, stop: int) -> NDArray[np.float32]:
            data = np.empty(int(entries[start:stop].sum()), dtype=np.float32)
            used = fill_blocks(
                self.ranges[start:stop],
                smooth[start:stop],
                positions[0],
                positions[1],
                lobes,
                spheres,
                shadows[0],
                shadows[1],
                heights[0],
                heights[1],
                pair.least_squared_distance,
                END_TOLERANCE,
                TOLERANCE,
                self.rank[start:stop],
                data,
            )
            return data[:used].copy()

        with ThreadPoolExecutor(_threads()) as pool:
            parts = list(pool.map(fill, bounds[:-1], bounds[1:]))
        self.data = np.concatenate(parts) if parts else np.empty(0, dtype=np.float32)
        sides = (self.ranges[:, 1] - self.ranges[:, 0]) + (self.ranges[:, 3] - self.ranges[:, 2])
        lengths = np.where(self.rank == 0, entries, sides * self.rank)
        self.offset = np.cumsum(lengths) - lengths

    def add_to(self, out: NDArray[np.float64], columns: NDArray[np.float64]) -> None:
        """Add this block of G, and its transpose, times columns (N, K) to out (N, K)."""
        for transposed in (False, True):
            self._add_side(out, columns, transposed)

    def _add_side(
        self, out: NDArray[np.float64], columns: NDArray[np.float64], transposed: bool
    ) -> None:
        here, there = self.pixels[::-1] if transposed else self.pixels
        x = columns[there].astype(np.float32)
        y = np.zeros((len(here), columns.shape[1]))

        def multiply(chosen: NDArray[np.int64]) -> None:
            apply_blocks(chosen, transposed, self.ranges, self.rank, self.offset, self.data, x, y)

        with ThreadPoolExecutor(_threads()) as pool:
            list(pool.map(multiply, self.shares[transposed]))
        out[here] += y


def _threads() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
