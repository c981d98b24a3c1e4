"""Brute force: one pattern a projector pixel, the yardstick of the other methods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods.base import MEMORY_BYTES, Float, LevelImages, Options
from rfpipe.methods.images import batches
from rfpipe.methods.states import MethodState, PackingMethod, level_row
from rfpipe.patterns import Schedule
from rfpipe.transport.dense import DenseTransport

# A scan is for small scenes: what it would cost for large ones is computed, never run.
_LARGEST_MATRIX_BYTES = 8 * 2**30


@dataclass(frozen=True)
class ScanState(MethodState):
    """The state of a scan: a matrix (C, camera rays, projector rays), zeros before it."""

    matrix: Float


class BruteForce(PackingMethod[ScanState]):
    """A scan of the projector's rays: one level, a dense matrix."""

    name = "brute_force"
    title = "Brute force"
    colour = "#5c5c5c"
    marker = ""
    line = "--"

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return 1: all patterns are known beforehand."""
        return 1

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Options
    ) -> ScanState:
        """Return the state before the scan; InputError for a matrix that takes too much memory."""
        shape = (channels, camera.size, projector.size)
        size = int(np.prod(shape)) * np.dtype(np.float32).itemsize
        if size > _LARGEST_MATRIX_BYTES:
            raise InputError(
                f"{self.title}: a scan of {projector.size} projector rays and {camera.size} camera "
                f"rays in {channels} channels gives a matrix of {size / 2**30:.1f} GiB, more than "
                f"{_LARGEST_MATRIX_BYTES / 2**30:.0f}; use dual or symmetric photography"
            )
        return ScanState(camera, projector, channels, options, np.zeros(shape, np.float32))

    def schedule(self, state: ScanState) -> Schedule:
        """Light one ray after the other, in the order of the image."""
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
        return state.after(row, matrix=matrix)

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
