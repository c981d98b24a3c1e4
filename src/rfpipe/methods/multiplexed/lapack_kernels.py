"""Symmetric matrices in compiled code, by the float32 BLAS and LAPACK that SciPy brings.

Numba has neither products of a matrix with its transpose nor triangular solutions; general products
and solutions take three times as long. The routines are found by name, since Numba caches no code
with their addresses. They read arrays by columns: what is a lower triangle here is an upper one
there.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import binding
from numba import types
from numba.extending import get_cython_function_address

from rfpipe.array_types import Codes, Float, Numbers

_LETTER, _NUMBER, _VALUES = map(types.CPointer, (types.uint8, types.int32, types.float32))


def _routine(name: str, *arguments: Any) -> Any:
    """Return a routine of BLAS or LAPACK for compiled code."""
    module = "cython_lapack" if name == "spotrf" else "cython_blas"
    address = get_cython_function_address(f"scipy.linalg.{module}", name)
    symbol = f"rfpipe_{name}"
    binding.add_symbol(symbol, address)
    return types.ExternalFunction(symbol, types.void(*arguments))


_EPSILON = float(np.finfo(np.float32).eps)
# Increase of the diagonal with which any matrix of products is positive definite.
_LARGEST_INCREASE = 1e6

# fmt: off
_add_products = _routine(
    "ssyrk", _LETTER, _LETTER, _NUMBER, _NUMBER, _VALUES, _VALUES, _NUMBER, _VALUES, _VALUES,
    _NUMBER,
)
_factorize = _routine("spotrf", _LETTER, _NUMBER, _VALUES, _NUMBER, _NUMBER)
_solve_triangle = _routine(
    "strsm", _LETTER, _LETTER, _LETTER, _LETTER, _NUMBER, _NUMBER, _VALUES, _VALUES, _NUMBER,
    _VALUES, _NUMBER,
)
# fmt: on
_UPPER, _TRANSPOSED, _NOT, _RIGHT = (ord(letter) for letter in "UTNR")


@numba.njit(cache=True, nogil=True)
def add_products(S: Float, rows: Float) -> None:
    """Add the products of rows (n, k) with each other to the lower triangle of S, (n, n)."""
    n, k = _number(rows.shape[0]), _number(rows.shape[1])
    one = np.ones(1, np.float32)
    _add_products(
        _letter(_UPPER).ctypes, _letter(_TRANSPOSED).ctypes, n.ctypes, k.ctypes,
        one.ctypes, rows.ctypes, k.ctypes, one.ctypes, S.ctypes, n.ctypes,
    )  # fmt: skip


# Otherwise fast math, which takes NaN for impossible, is inherited from a caller that has it.
@numba.njit(cache=True, nogil=True, fastmath=False)
def whiten(S: Float, columns: Float) -> None:
    """Replace columns (n, m) by ``L^-1 columns``, where ``S = L L^T``.

    S is positive definite and given by its lower triangle. Its diagonal is increased by n times the
    precision of float32, which usually keeps it positive definite in spite of rounding, otherwise
    by ten times as much [Higham, *Accuracy and stability of numerical algorithms*, 2002, theorem
    10.7].

    Raises
    ------
    ValueError
        If S isn't finite.
    """
    n, m = _number(len(S)), _number(columns.shape[1])
    no, upper, one = _letter(_NOT), _letter(_UPPER), np.ones(1, np.float32)
    increase, failed, L = len(S) * _EPSILON, _number(1), S
    while failed[0] != 0:
        if increase > _LARGEST_INCREASE:
            raise ValueError("the matrix isn't finite")
        L = S.copy()
        for i in range(len(S)):
            L[i, i] *= 1 + increase
        _factorize(upper.ctypes, n.ctypes, L.ctypes, n.ctypes, failed.ctypes)
        # not every LAPACK reports NaN, and not every BLAS carries it on to the last row
        failed[0] = failed[0] != 0 or not np.isfinite(np.diag(L)).all()
        increase *= 10
    _solve_triangle(
        _letter(_RIGHT).ctypes, upper.ctypes, no.ctypes, no.ctypes, m.ctypes, n.ctypes,
        one.ctypes, L.ctypes, n.ctypes, columns.ctypes, m.ctypes,
    )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _number(value: int) -> Numbers:
    return np.full(1, value, np.int32)


@numba.njit(cache=True, nogil=True)
def _letter(value: int) -> Codes:
    return np.full(1, value, np.uint8)
