"""Brute force: one pattern a projector pixel, the yardstick of the other methods."""

from __future__ import annotations

import numpy as np

from rfpipe.methods.base import MEMORY_BYTES, LevelImages
from rfpipe.methods.scan import Scan, ScanState, read_columns
from rfpipe.methods.states import level_row
from rfpipe.patterns import Schedule


class BruteForce(Scan):
    """A scan of the projector's pixels as a `Method`."""

    name = "brute_force"
    title = "Brute force"
    colour = "#5c5c5c"
    marker = ""
    line = "--"

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
