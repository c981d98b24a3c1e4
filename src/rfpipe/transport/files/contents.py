"""What a file of a matrix holds, whatever its format."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.transport.algebra import Float, Index, MatrixAlgebra

__all__ = ["ABOUT", "Contents"]

ABOUT = (
    "Light transport T by rfpipe: T[channel, row, column] is the radiance that a camera ray (row) "
    "receives when the projector ray (column) has the weight 1. c = T p. Rays are numbered row by "
    "row of their images, from 0: camera_shape and projector_shape are (height, width), views "
    "before them. 'rows' and 'columns' are the rays that are kept."
)
"""What a file says of itself."""


@dataclass(frozen=True)
class Contents:
    """The part of a matrix that is written.

    Attributes
    ----------
    matrix : MatrixAlgebra
    rows, columns : ndarray of int64
        Rays.
    progress : bool
        Whether to show on stderr how far it is, if that is a terminal.
    """

    matrix: MatrixAlgebra
    rows: Index
    columns: Index
    progress: bool = False

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, rows, columns."""
        return self.matrix.channels, len(self.rows), len(self.columns)

    @property
    def nbytes(self) -> int:
        """Bytes of the float32 entries, before compression."""
        return prod(self.shape) * np.dtype(np.float32).itemsize

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the small arrays that stand beside T."""
        return {
            "camera_shape": np.array(self.matrix.camera_shape, np.int64),
            "projector_shape": np.array(self.matrix.projector_shape, np.int64),
            "rows": self.rows,
            "columns": self.columns,
        }

    def blocks(
        self, *, by_rows: bool | None = None, channels: Sequence[int] | None = None
    ) -> Iterator[tuple[slice, slice, Float]]:
        """Yield T in parts; see `rfpipe.transport.algebra.MatrixAlgebra.blocks`."""
        from tqdm import tqdm

        with tqdm(
            total=len(self.rows) * len(self.columns),
            desc="matrix" if channels is None else f"channels {list(channels)}",
            unit="entry",
            unit_scale=True,
            disable=None if self.progress else True,
        ) as bar:
            parts = self.matrix.blocks(self.rows, self.columns, by_rows=by_rows, channels=channels)
            for rows, columns, block in parts:
                yield rows, columns, block
                bar.update(block.shape[1] * block.shape[2])
