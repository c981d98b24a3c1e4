"""A piece of a transport matrix under construction."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

__all__ = ["Sums"]


class Sums:
    """Sums of light for some rows, or columns, of a transport matrix.

    In double precision, so that the order in which threads add hardly matters.

    Parameters
    ----------
    first, count
        The pixels whose rows, or columns, they are, in the order of their ray domain.
    others
        Number of pixels on the other side.
    """

    def __init__(self, first: int, count: int, others: int) -> None:
        self.first, self.count, self.others = first, count, others
        self._values = dr.zeros(mi.Float64, count * others * 3)

    def add(self, own: Any, other: Any, colour: Any, active: Any) -> None:
        """Add colours for `own` pixels, counted from the first, and `other` ones."""
        at = (own * self.others + other) * 3
        for channel in range(3):
            value = mi.Float64(colour[channel])
            dr.scatter_reduce(dr.ReduceOp.Add, self._values, value, at + channel, active)

    def flush(self) -> None:
        """Let what was added take place."""
        dr.eval(self._values)

    def to_numpy(self) -> NDArray[np.float64]:
        """Return the sums, float64 (count, others, 3)."""
        values: NDArray[np.float64] = self._values.numpy()
        return values.reshape(self.count, self.others, 3)
