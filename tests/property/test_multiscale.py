"""Bases of many scales over domains of any size, and their transports."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.helpers import dense

from rfpipe.testing import dot_test
from rfpipe.transport.multiscale import (
    MultiscaleBasis,
    MultiscaleTransport,
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


def random_basis(shape: tuple[int, ...], scales: set[int], seed: int) -> MultiscaleBasis:
    """All functions of the coarsest scale, some of the others."""
    random = np.random.default_rng(seed)
    parts = []
    for scale in scales:
        wanted = random.random(cells(shape, scale)) < 0.2
        parts.append(functions_over(scale, wanted | (scale == max(scales))))
    return MultiscaleBasis(shape, np.concatenate(parts))


@given(shape=SHAPES, scale=SCALES)
@settings(deadline=None, max_examples=40)
def test_functions_of_a_scale_share_out_every_ray(shape: tuple[int, ...], scale: int) -> None:
    basis = MultiscaleBasis(shape, functions_over(scale, np.ones(cells(shape, scale), np.bool_)))
    np.testing.assert_allclose(basis.weights.sum(axis=1), 1, atol=1e-5)
    assert (basis.weights.data >= 0).all()
    # none that is zero on the whole image, either
    assert (basis.weights.sum(axis=0) > 0).all()


@given(shape=SHAPES, scales=st.sets(SCALES, min_size=1), seed=SEEDS)
@settings(deadline=None, max_examples=40)
def test_pairs_are_each_there_once(shape: tuple[int, ...], scales: set[int], seed: int) -> None:
    basis = random_basis(shape, scales, seed)
    assert (basis.first <= basis.second).all()
    assert len(set(zip(basis.first.tolist(), basis.second.tolist(), strict=True))) == len(
        basis.first
    )
    # each with itself, and the coarsest with all of theirs
    own = basis.first[basis.first == basis.second]
    np.testing.assert_array_equal(np.sort(own), np.arange(len(basis)))
    coarsest = int((basis.scales == basis.scales.max()).sum())
    both = (basis.scales[basis.first] == basis.scales.max()) & (
        basis.scales[basis.second] == basis.scales.max()
    )
    assert int(both.sum()) == coarsest * (coarsest + 1) // 2


@given(shape=SHAPES)
@settings(deadline=None, max_examples=40)
def test_the_coarsest_scale_is_the_last_that_has_twenty_cells(shape: tuple[int, ...]) -> None:
    scale = coarsest_scale(shape)
    assert scale == 1 or np.prod(cells(shape[-2:], scale)) >= 20
    assert np.prod(cells(shape[-2:], 2 * scale)) < 20


@given(
    shape=st.one_of(
        st.tuples(st.integers(1, 9), st.integers(1, 9)),
        st.tuples(st.integers(1, 3), st.integers(1, 5), st.integers(1, 5)),
    ),
    scales=st.sets(st.sampled_from([1, 2, 4]), min_size=1),
    seed=SEEDS,
)
@settings(deadline=None, max_examples=25)
def test_relighting_is_the_dense_product(
    shape: tuple[int, ...], scales: set[int], seed: int
) -> None:
    random = np.random.default_rng(seed)
    basis = random_basis(shape, scales, seed)
    factor = random.random((3, int(np.prod(shape)))).astype(np.float32)
    cores = random.standard_normal((3, len(basis.first))).astype(np.float32)
    arrays = {"factor": factor, "functions": basis.functions, "cores": cores}
    transport = MultiscaleTransport(shape, 3, [], arrays)
    core = np.zeros((3, len(basis), len(basis)))
    core[:, basis.first, basis.second] = core[:, basis.second, basis.first] = cores
    weighted = factor[:, :, None] * basis.weights.toarray()
    expected = weighted @ core @ weighted.transpose(0, 2, 1)
    found = dense(transport)
    np.testing.assert_allclose(found, expected, atol=1e-5 * max(1.0, float(np.abs(expected).max())))
    dot_test(transport)
    picture = random.random(shape)
    np.testing.assert_array_equal(transport.T.relight(picture), transport.relight(picture))
    assert transport.relight(picture).sum() == pytest.approx(
        float((expected @ picture.ravel()).sum()), rel=1e-3, abs=1e-3 * np.abs(expected).max()
    )
