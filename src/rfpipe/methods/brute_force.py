"""Brute force: one pattern per projector pixel, the yardstick of the other methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods.base import MEMORY_BYTES, LevelImages, Method, Options, StateArrays
from rfpipe.methods.images import batches
from rfpipe.methods.states import MethodState, level_row
from rfpipe.patterns import Schedule
from rfpipe.transport.dense import DenseTransport

# Scans are for small scenes; the cost of larger ones is forecast from their number of rays.
_LARGEST_MATRIX_BYTES = 8 * 2**30


@dataclass(frozen=True)
class ScanState(MethodState):
    """State of a scan.

    Attributes
    ----------
    matrix : ndarray of float32, shape (C, camera rays, projector rays)
        The transport; zero before the scan.
    """

    matrix: Float

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the matrix and the table of levels."""
        return StateArrays({"matrix": self.matrix}, {"rows": list(self.rows)})

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state after the last of the levels."""
        if not levels:
            return start
        last = levels[-1]
        return replace(start, rows=tuple(last.attributes["rows"]), matrix=last.arrays["matrix"])


class BruteForce(Method[ScanState]):
    """A scan of the projector's rays: one level, a dense matrix."""

    name = "brute_force"
    title = "Brute force"
    colour = "#5c5c5c"
    marker = ""
    line = "--"

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Options
    ) -> ScanState:
        """Return the state before the scan; InputError for a matrix of more than 8 GiB."""
        shape = (channels, camera.size, projector.size)
        size = int(np.prod(shape)) * np.dtype(np.float32).itemsize
        if size > _LARGEST_MATRIX_BYTES:
            raise InputError(
                f"{self.title}: a scan of {projector.size} projector rays and {camera.size} camera "
                f"rays in {channels} channels gives a matrix of {size / 2**30:.1f} GiB, more than "
                f"{_LARGEST_MATRIX_BYTES / 2**30:.0f}; use dual or symmetric photography"
            )
        return ScanState(camera, projector, channels, options, np.zeros(shape, np.float32))

    def next_schedule(self, state: ScanState) -> Schedule | None:
        """Light one ray after the other, in the order of the image."""
        if state.rows:
            return None
        rays = np.arange(state.projector.size, dtype=np.int32).reshape(state.projector.shape)
        return Schedule(0, state.projector.shape, rays.size, pattern_of_ray=rays, complete=True)

    def refine(
        self, state: ScanState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> ScanState:
        """Take each image as a column of the matrix."""
        channels, pixels, rays = state.matrix.shape
        matrix = read_columns(images, channels, pixels)
        lit = int(np.count_nonzero(matrix.any(axis=0)))
        nodes = pixels * rays
        row = level_row(0, rays, nodes=nodes, empty=nodes - lit, scalar=lit)
        return replace(state, matrix=matrix, rows=(row,))

    def transport(self, state: ScanState) -> DenseTransport:
        """Return the dense matrix."""
        shapes = state.camera.shape, state.projector.shape
        return DenseTransport(*shapes, state.channels, list(state.rows), {"matrix": state.matrix})


def read_columns(images: LevelImages, channels: int, pixels: int) -> Float:
    """Read a level's images as columns, float32 (channels, pixels, patterns)."""
    count = images.schedule.count
    columns = np.empty((channels, pixels, count), np.float32)
    for first, last in batches(count, channels * pixels):
        radiance, _ = images.read(first, last)
        observed = radiance.reshape(last - first, pixels, channels)
        columns[..., first:last] = np.moveaxis(observed, (0, 1), (2, 1))
    return columns
