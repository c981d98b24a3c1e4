"""Multiplexing codes of any size."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.methods.hadamard import decode, s_matrix_order, s_matrix_row

SEEDS = st.integers(0, 2**32 - 1)


@given(rays=st.integers(1, 300), seed=SEEDS)
@settings(deadline=None, max_examples=30)
def test_what_an_s_matrix_codes_is_decoded(rays: int, seed: int) -> None:
    order = s_matrix_order(rays)
    assert rays <= order < rays + 40
    code = s_matrix_row(order)
    unknown = np.random.default_rng(seed).random((3, rays))
    shown = np.stack([np.roll(code, -shift)[:rays] for shift in range(order)])
    np.testing.assert_allclose(decode(unknown @ shown.T, rays), unknown, atol=1e-6)
