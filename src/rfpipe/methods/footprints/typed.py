"""Names of the arrays' types that footprint acquisition uses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
