"""Types of arrays, by their numbers."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.int64]
