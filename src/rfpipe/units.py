"""Dtypes, names of units and limits of counts, shared by stores, manifests and reports."""

from typing import Literal

import numpy as np

__all__ = [
    "COUNTS",
    "COUNT_UNIT",
    "RADIANCE",
    "RADIANCE_UNIT",
    "SATURATION_FRACTION",
    "SYMMETRY_FRAMES",
    "NumberFormat",
]

NumberFormat = Literal["float32", "uint16", "uint8"]
"""How a stored transport keeps its numbers: as they are, or rounded to 16 or 8 bits."""

RADIANCE = np.float32
"""Dtype of stored radiance, and of its variance (radiance squared)."""

COUNTS = np.uint16
"""Dtype of raw frames, in analogue-to-digital counts."""

RADIANCE_UNIT = "radiance"
"""Scene-referred linear light, in units of the coaxial transport matrix."""

COUNT_UNIT = "count"
"""One step of the camera's analogue-to-digital converter."""

SATURATION_FRACTION = 0.98
"""Fraction of full scale from which on a count is saturated, where nothing else is set."""

SYMMETRY_FRAMES = 6  # four say the same within 20 %, eight within 10 %
"""Random patterns that tell whether a rig is coaxial."""
