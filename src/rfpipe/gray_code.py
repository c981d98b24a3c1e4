"""Gray code of integers: neighbours differ in one bit.

The code of a coordinate x is ``x ^ (x >> 1)``, its bits from the most significant one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def gray_bits(count: int) -> int:
    """Number of bits, ceil(log2(count)), of a code of `count` coordinates."""
    return (count - 1).bit_length()


def gray_code(coordinates: ArrayLike, bits: int) -> NDArray[np.bool_]:
    """Return the Gray code of coordinates.

    Parameters
    ----------
    coordinates : array_like of int, shape (...)
        At least 0. Higher bits are dropped.
    bits : int
        Number of bits.

    Returns
    -------
    ndarray of bool, shape (bits, ...)
        From the most significant bit to the least.
    """
    number = np.asarray(coordinates)
    shifts = np.arange(bits)[::-1].reshape(-1, *(1,) * number.ndim)
    code: NDArray[np.bool_] = ((number ^ (number >> 1)) >> shifts & 1).astype(np.bool_)
    return code


def gray_number(code: NDArray[Any]) -> NDArray[np.int64]:
    """Return the coordinates (...) of a Gray code (bits, ...), most significant bit first."""
    binary = np.logical_xor.accumulate(code, axis=0)
    number: NDArray[np.int64] = np.tensordot(1 << np.arange(len(code))[::-1], binary, 1)
    return number
