"""Multiplexing codes and low-rank transports of any size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.helpers import dense

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods.hadamard import decode, s_matrix_order, s_matrix_row
from rfpipe.testing import dot_test
from rfpipe.transport.low_rank import LowRankTransport

SHAPES = st.one_of(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 4)),
)
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


@given(shape=SHAPES, rank=st.integers(0, 4), diagonal=st.booleans(), seed=SEEDS)
@settings(deadline=None, max_examples=30)
def test_low_rank_transports_are_what_their_arrays_say(
    shape: tuple[int, ...], rank: int, diagonal: bool, seed: int
) -> None:
    random, rays = np.random.default_rng(seed), RayDomain(shape).size
    left, strengths = random.random((3, rank, rays)), random.random((3, rank))
    arrays = {"left": left, "strengths": strengths}
    arrays = {name: array.astype(np.float32) for name, array in arrays.items()}
    if diagonal:
        arrays["diagonal"] = random.random((3, rays)).astype(np.float32)
    transport = LowRankTransport(shape, shape, 3, [], arrays)
    dot_test(transport)
    expected = np.einsum("cr,crm,crn->cmn", strengths, left, left)
    if diagonal:
        expected += np.stack([np.diag(one) for one in arrays["diagonal"]])
    np.testing.assert_allclose(dense(transport), expected, atol=1e-5)


def test_terms_of_two_domains() -> None:
    random = np.random.default_rng(4)
    left, right = random.random((3, 2, 6)), random.random((3, 2, 20))
    strengths = random.random((3, 2)) - 0.5
    arrays = {
        "left": left.astype(np.float32),
        "right": right.astype(np.float32),
        "strengths": strengths.astype(np.float32),
    }
    transport = LowRankTransport((2, 3), (4, 5), 3, [], arrays)
    expected = np.einsum("cr,crm,crn->cmn", strengths, left, right)
    np.testing.assert_allclose(dense(transport), expected, atol=1e-6)
    dot_test(transport)
    del arrays["right"]
    with pytest.raises(InputError, match="it needs one domain"):
        LowRankTransport((2, 3), (4, 5), 3, [], arrays)
