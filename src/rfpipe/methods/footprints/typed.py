"""Names of the arrays' types that footprint acquisition uses, and what it does with keys."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]


def distinct(keys: Int64) -> Int64:
    """Return the distinct keys, ascending: of many, much faster than a table of hashes."""
    ordered = np.sort(keys)
    is_new = np.ones(len(ordered), np.bool_)
    np.not_equal(ordered[1:], ordered[:-1], out=is_new[1:])
    return ordered[is_new]
