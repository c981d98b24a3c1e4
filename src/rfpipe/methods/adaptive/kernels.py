"""A kernel over patches of pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

from rfpipe.methods.base import Float


@njit(cache=True, nogil=True, fastmath=True)
def weigh(arriving: Float, dark: Float, lit: Float, out: Float) -> None:
    """Weigh the light that arrives under each pattern and, last, full light, as pictures show it.

    Dark pixels see a pattern's light, lit ones how it differs from full light. `out` may be
    `arriving`.
    """
    last = dark.shape[1]
    for patch in range(len(arriving)):
        full, back = arriving[patch, last], np.float32(0)
        for pattern in range(last):
            under = arriving[patch, pattern]
            lacking = lit[patch, pattern] * (under - full)
            out[patch, pattern] = dark[patch, pattern] * under + lacking
            back -= lacking
        out[patch, last] = back
