"""Compiled products with the weights of the near/far fit's pictures."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from rfpipe.array_types import Float, Numbers


class PatchValues(NamedTuple):
    """Means of functions over patches: the arrays of a sparse matrix, row by row."""

    starts: Numbers  # first value of each patch, and the number of all values, (patches + 1,)
    functions: Numbers  # number of each value's function, (values,)
    values: Float  # (values,)


@numba.njit(cache=True, nogil=True, fastmath=True)
def weigh(B: PatchValues, dark_weight: Float, lit_weight: Float, light: Float, out: Float) -> None:
    """Add ``B^T W B light`` to `out`; both are (functions, P + 1), the weights (patches, P).

    W is the matrix of the sum over all patches and patterns p of

        dark_weight a_p^2 + lit_weight (a_p - a_full)^2

    for the light ``a = B light`` of a patch, whose last column is a_full.
    """
    a = np.empty(light.shape[1], np.float32)
    full = dark_weight.shape[1]
    for patch in range(len(B.starts) - 1):
        entries = range(B.starts[patch], B.starts[patch + 1])
        a[:] = 0
        for entry in entries:
            function, value = B.functions[entry], B.values[entry]
            for p in range(len(a)):
                a[p] += value * light[function, p]
        total = np.float32(0)
        for p in range(full):
            lit = lit_weight[patch, p] * (a[p] - a[full])
            a[p] = dark_weight[patch, p] * a[p] + lit
            total += lit
        a[full] = -total
        for entry in entries:
            function, value = B.functions[entry], B.values[entry]
            for p in range(len(a)):
                out[function, p] += value * a[p]
