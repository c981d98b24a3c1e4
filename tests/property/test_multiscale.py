"""Bases of many scales over domains of any size, and their transports."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.transport.multiscale import (
    MultiscaleBasis,
    cells,
    coarsest_scale,
    functions_over,
)

SHAPES = st.one_of(
    st.tuples(st.integers(1, 23), st.integers(1, 23)),
    st.tuples(st.integers(1, 3), st.integers(1, 9), st.integers(1, 9)),
)
SCALES = st.sampled_from([1, 2, 4, 8, 16])
SEEDS = st.integers(0, 2**32 - 1)


@given(shape=SHAPES, scale=SCALES)
@settings(deadline=None, max_examples=40)
def test_functions_of_a_scale_share_out_every_ray(shape: tuple[int, ...], scale: int) -> None:
    basis = MultiscaleBasis(shape, functions_over(scale, np.ones(cells(shape, scale), np.bool_)))
    np.testing.assert_allclose(basis.weights.sum(axis=1), 1, atol=1e-5)
    assert (basis.weights.data >= 0).all()
    # none that is zero on the whole image, either
    assert (basis.weights.sum(axis=0) > 0).all()


@given(shape=SHAPES)
@settings(deadline=None, max_examples=40)
def test_the_coarsest_scale_is_the_last_that_has_twenty_cells(shape: tuple[int, ...]) -> None:
    scale = coarsest_scale(shape)
    assert scale == 1 or np.prod(cells(shape[-2:], scale)) >= 20
    assert np.prod(cells(shape[-2:], 2 * scale)) < 20
