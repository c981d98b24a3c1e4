"""Symmetric systems in compiled code, against NumPy in double precision."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rfpipe.methods.multiplexed.lapack_kernels import add_products, whiten

CALLED_BY_FAST_CODE = """
import numba
import numpy as np
from rfpipe.methods.multiplexed.lapack_kernels import whiten

@numba.njit(fastmath=True)
def whiten_fast(S, columns):
    whiten(S, columns)

S = np.eye(4, dtype=np.float32)
S[3, 3] = np.nan
whiten_fast(S, np.ones((4, 2), np.float32))
"""


@pytest.mark.parametrize(("size", "columns"), [(1, 1), (1, 5), (7, 3), (40, 60)])
def test_products_and_whitened_columns_agree_with_numpy(size: int, columns: int) -> None:
    random = np.random.default_rng(size)
    rows = random.normal(size=(size, columns)).astype(np.float32)
    S = np.eye(size, dtype=np.float32)
    add_products(S, rows)
    expected = np.eye(size) + rows.astype(np.float64) @ rows.T
    np.testing.assert_allclose(np.tril(S), np.tril(expected), rtol=1e-4, atol=1e-4)
    whitened = rows.copy()
    whiten(S, whitened)
    np.testing.assert_allclose(
        whitened, np.linalg.solve(np.linalg.cholesky(expected), rows), rtol=1e-3, atol=1e-4
    )


@pytest.mark.parametrize("light", [1e3, 1e6, 1e12])
def test_a_matrix_that_rounding_makes_indefinite_is_whitened(light: float) -> None:
    """All rows have the same products; the rest of the matrix is below their rounding."""
    rows = np.full((50, 3), np.sqrt(light), np.float32)
    S, whitened = np.eye(50, dtype=np.float32), rows.copy()
    add_products(S, rows)
    whiten(S, whitened)
    assert np.isfinite(whitened).all()
    explained = np.square(whitened, dtype=np.float64).sum(axis=0)
    assert (explained < 1.01).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize(("row", "column"), [(0, 0), (2, 1), (3, 0), (3, 3)])
def test_a_matrix_that_is_not_finite_is_rejected(row: int, column: int, value: float) -> None:
    S = np.eye(4, dtype=np.float32)
    S[row, column] = value
    with pytest.raises(ValueError, match="finite"):
        whiten(S, np.ones((4, 2), np.float32))


def test_code_with_fast_math_that_compiles_it_first_doesn_t_change_it(tmp_path: Path) -> None:
    """Numba keeps the first compiled version, whose fast math would ignore NaN, on the disk."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", CALLED_BY_FAST_CODE],
        env=environment, check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert "ValueError: the matrix isn't finite" in done.stderr
