"""Types of arrays, by the type of their elements, and the smallest divisor."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.int64]

Blocks = NDArray[np.int32]
"""Numbers of blocks of a `rfpipe.blocks.BlockTree`, or of single rays."""

Counts = NDArray[np.uint16]
"""Counts of a camera's frames."""

Codes = NDArray[np.uint8]
"""Codes of a projector's frame buffer."""

Numbers = NDArray[np.int32]
"""Numbers of basis functions or of wavelets, such as the first of each pair."""

FunctionTable = NDArray[np.int32]
"""Table of basis functions, (n, 4), see `rfpipe.transport.multiscale.MultiscaleBasis`."""

TINY = float(np.finfo(np.float32).tiny)
"""Smallest normal float32: the least value of divisors that could be 0."""
