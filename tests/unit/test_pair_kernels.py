"""Products of symmetric cores against a dense matrix."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe.transport.pair_kernels import correlate, couple


@pytest.mark.parametrize("columns", [1, 5, 16])
@pytest.mark.parametrize("is_ordered", [True, False])
def test_products_of_pairs_are_those_of_a_dense_symmetric_matrix(
    columns: int, is_ordered: bool
) -> None:
    random = np.random.default_rng(columns)
    first, second = np.triu_indices(9)  # runs of 1 to 9 pairs, each begins with a function's own
    chosen = np.flatnonzero(random.random(len(first)) < 0.8)
    if not is_ordered:
        random.shuffle(chosen)
    first, second = first[chosen].astype(np.int32), second[chosen].astype(np.int32)
    cores = random.normal(size=len(first)).astype(np.float32)
    light, received = random.normal(size=(2, 9, columns)).astype(np.float32)
    S = np.zeros((9, 9))
    S[first, second] = S[second, first] = cores

    out = received.copy()
    couple(first, second, cores, light, out)
    np.testing.assert_allclose(out, received + S @ light, rtol=1e-4, atol=1e-5)

    adjoint = np.full(len(first), np.nan, np.float32)
    correlate(first, second, received, light, adjoint)
    product = received @ light.T
    expected = product + np.where(np.eye(9) == 1, 0, product.T)
    np.testing.assert_allclose(adjoint, expected[first, second], rtol=1e-4, atol=1e-5)
