"""Types of arrays, by their numbers."""

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

Functions = NDArray[np.int32]
"""Numbers of basis functions of a `rfpipe.transport.multiscale` transport."""
