"""Rounding of single values in stores."""

from __future__ import annotations

import numpy as np

from rfpipe.array_types import Float
from rfpipe.units import NumberFormat

# Bits of the significand that remain, the leading one included.
_SIGNIFICANT_BITS = {"uint8": 12, "uint16": 16}
_FLOAT32_BITS = 24


def rounded(values: Float, number_format: NumberFormat) -> Float:
    """Round values to 12 significant bits for "uint8", to 16 for "uint16".

    They span too many decades for a common scale. The trailing bits are 0, which take no room in a
    compressed store.
    """
    if number_format == "float32":
        return values
    dropped = _FLOAT32_BITS - _SIGNIFICANT_BITS[number_format]
    bits = np.ascontiguousarray(values).view(np.uint32)
    half, mask = np.uint32(1 << (dropped - 1)), np.uint32(2**32 - (1 << dropped))
    nearest = ((bits + half) & mask).view(np.float32)
    result: Float = np.where(np.isfinite(values) & np.isfinite(nearest), nearest, values)
    return result
