"""Single values rounded to fewer bits, for the number formats of stored transports."""

from __future__ import annotations

import numpy as np

from rfpipe.transport.base import Float
from rfpipe.units import NumberFormat

# Bits that are kept of single values, the leading one included.
_SIGNIFICANT = {"uint8": 12, "uint16": 16}
_FLOAT32_BITS = 24


def rounded(values: Float, number_format: NumberFormat) -> Float:
    """Round single values to 12 significant bits under "uint8", to 16 under "uint16".

    They span too many decades for a common scale. The trailing bits, all 0, take no room in a
    compressed store.
    """
    if number_format == "float32":
        return values
    dropped = _FLOAT32_BITS - _SIGNIFICANT[number_format]
    bits = np.ascontiguousarray(values).view(np.uint32)
    half = np.uint32(1 << (dropped - 1))
    mask = np.uint32(2**32 - (1 << dropped))
    found = ((bits + half) & mask).view(np.float32)
    result: Float = np.where(np.isfinite(values) & np.isfinite(found), found, values)
    return result
