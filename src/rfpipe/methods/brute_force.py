"""Brute force: one pattern a projector pixel, the yardstick of the other methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods.base import MEMORY_BYTES, Float, LevelImages, Pack, Settings
from rfpipe.patterns import Schedule
from rfpipe.transport.dense import DenseTransport

# A scan is for small scenes: what it would cost for large ones is computed, never run.
LARGEST_MATRIX_BYTES = 8 * 2**30

# Images read at a time.
_BATCH_BYTES = 32 * 2**20


@dataclass(frozen=True)
class BruteForceState:
    """The state of a scan.

    Attributes
    ----------
    camera, projector : RayDomain
    matrix : ndarray of float32, shape (C, camera rays, projector rays)
        Zeros before the scan.
    level : int
        0 before the scan, 1 after it.
    rows : tuple of dict
        The table of levels so far.
    """

    camera: RayDomain
    projector: RayDomain
    matrix: Float
    level: int = 0
    rows: tuple[dict[str, int], ...] = ()


class BruteForce:
    """A scan of the projector's pixels as a `Method`."""

    name = "brute_force"

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:  # noqa: ARG002
        """Return 1: all patterns are known beforehand."""
        return 1

    def start(
        self,
        camera: RayDomain,
        projector: RayDomain,
        channels: int,
        settings: Settings,  # noqa: ARG002
    ) -> BruteForceState:
        """Return the state before the scan.

        Raises
        ------
        InputError
            If the matrix would be larger than `LARGEST_MATRIX_BYTES`.
        """
        shape = (channels, camera.size, projector.size)
        size = int(np.prod(shape)) * np.dtype(np.float32).itemsize
        if size > LARGEST_MATRIX_BYTES:
            raise InputError(
                f"a brute-force scan of {projector.size} projector rays and {camera.size} camera "
                f"rays in {channels} channels gives a matrix of {size / 2**30:.1f} GiB, more than "
                f"{LARGEST_MATRIX_BYTES / 2**30:.0f}; use dual or symmetric photography"
            )
        return BruteForceState(camera, projector, np.zeros(shape, np.float32))

    def schedule(self, state: BruteForceState) -> Schedule:
        """Light one ray after the other, in the order of the image."""
        rays = np.arange(state.projector.size, dtype=np.int32).reshape(state.projector.shape)
        return Schedule(0, state.projector.shape, rays.size, pattern_of_ray=rays, complete=True)

    def refine(
        self,
        state: BruteForceState,
        images: LevelImages,
        memory_bytes: int = MEMORY_BYTES,  # noqa: ARG002 - reads a few images at a time
    ) -> BruteForceState:
        """Take each image as a column of the matrix."""
        channels, pixels, rays = state.matrix.shape
        matrix = np.empty_like(state.matrix)
        step = max(1, _BATCH_BYTES // (channels * pixels * matrix.itemsize))
        for first in range(0, rays, step):
            last = min(first + step, rays)
            radiance, _ = images.read(first, last)
            columns = radiance.reshape(last - first, pixels, channels)
            matrix[..., first:last] = np.moveaxis(columns, (0, 1), (2, 1))
        lit = int(np.count_nonzero(matrix.any(axis=0)))
        row = {
            "level": 0,
            "patterns": rays,
            "nodes": pixels * rays,
            "empty": pixels * rays - lit,
            "rank1": 0,
            "scalar": lit,
            "subdivided": 0,
        }
        return replace(state, matrix=matrix, level=1, rows=(row,))

    def transport(self, state: BruteForceState) -> DenseTransport:
        """Return the dense matrix."""
        return DenseTransport(
            state.camera.shape,
            state.projector.shape,
            len(state.matrix),
            list(state.rows),
            {"matrix": state.matrix},
        )

    def pack(self, state: BruteForceState) -> Pack:
        """Return the matrix."""
        return Pack({"matrix": state.matrix}, {"rows": list(state.rows)})

    def restore(self, start: BruteForceState, packs: Sequence[Pack]) -> BruteForceState:
        """Return the state after the scan, or before it if there are no packs."""
        if not packs:
            return start
        rows = tuple(packs[-1].attributes["rows"])
        return replace(start, matrix=packs[-1].arrays["matrix"], level=1, rows=rows)
