"""What scans share: as many patterns as rays, known beforehand, and a dense matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods.base import Float, LevelImages, Options
from rfpipe.methods.images import batches
from rfpipe.methods.states import MethodState, Packing, PackingMethod
from rfpipe.transport.dense import DenseTransport

__all__ = ["DenseMethod", "Scan", "ScanState", "read_columns"]

# A scan is for small scenes: what it would cost for large ones is computed, never run.
LARGEST_MATRIX_BYTES = 8 * 2**30


@dataclass(frozen=True)
class ScanState(MethodState):
    """The state of a scan, beside what all states have.

    Attributes
    ----------
    matrix : ndarray of float32, shape (C, camera rays, projector rays)
        Zeros before the scan.
    """

    matrix: Float


Dense = TypeVar("Dense", bound=ScanState)


class DenseMethod(PackingMethod[Dense]):
    """A method that finds the whole matrix."""

    def transport(self, state: Dense) -> DenseTransport:
        """Return the dense matrix."""
        shapes = state.camera.shape, state.projector.shape
        return DenseTransport(*shapes, state.channels, list(state.rows), {"matrix": state.matrix})


class Scan(DenseMethod[ScanState]):
    """The part of a `Method` that all scans share."""

    packing = Packing(("level", "rows"), ("matrix",))

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return 1: all patterns are known beforehand."""
        return 1

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Options
    ) -> ScanState:
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
                f"{self.title}: a scan of {projector.size} projector rays and {camera.size} camera "
                f"rays in {channels} channels gives a matrix of {size / 2**30:.1f} GiB, more than "
                f"{LARGEST_MATRIX_BYTES / 2**30:.0f}; use dual or symmetric photography"
            )
        return ScanState(camera, projector, channels, options, np.zeros(shape, np.float32))


def read_columns(images: LevelImages, channels: int, pixels: int) -> Float:
    """Read a level's images as columns, float32 (channels, pixels, patterns)."""
    count = images.schedule.count
    columns = np.empty((channels, pixels, count), np.float32)
    for first, last in batches(count, channels * pixels):
        radiance, _ = images.read(first, last)
        seen = radiance.reshape(last - first, pixels, channels)
        columns[..., first:last] = np.moveaxis(seen, (0, 1), (2, 1))
    return columns
