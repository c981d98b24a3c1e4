"""Number formats of stored transports: bounds of the rounding errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.transport.hierarchical.leaves import (
    LeafSet,
    decoded,
    factor_offsets,
    pack_leaves,
    unpack_leaves,
)
from rfpipe.transport.rounding import rounded

FORMATS = {"uint16": 65535, "uint8": 255}
TREE = BlockTree(RayDomain((5, 6)))
NEGLIGIBLE = 1e-22  # the product of two such factors underflows in float32

numbers = st.one_of(
    st.just(0.0),
    st.floats(0, 1, width=32),
    st.floats(0, 2.0**127, width=32),
    st.floats(0, float(np.finfo(np.float32).smallest_normal), width=32),
)


@st.composite
def leaf_sets(draw: st.DrawFn) -> LeafSet:
    """Draw leaves of one level, possibly none, with factors of very different magnitudes."""
    level = draw(st.integers(0, TREE.n_levels - 2))
    count = TREE.n_blocks(level)
    pairs = draw(st.lists(st.tuples(*[st.integers(0, count - 1)] * 2), max_size=4))
    block_a, block_b = np.sort(np.array(pairs, np.int32).reshape(-1, 2), axis=1).T.copy()
    size = factor_offsets(TREE.starts[level], block_a, block_b)[2]
    channels = draw(st.sampled_from([1, 3]))
    drawn = st.lists(numbers, min_size=channels * size, max_size=channels * size)
    values = np.array(draw(drawn), np.float32).reshape(channels, size)
    return LeafSet(level, block_a, block_b, values)


def factors_of(leaves: LeafSet) -> list[list[np.ndarray]]:
    """The two factors of each leaf, channels first."""
    starts = TREE.starts[leaves.level]
    offset_a, offset_b, _ = factor_offsets(starts, leaves.block_a, leaves.block_b)
    sizes = np.diff(starts)
    return [
        [leaves.values[:, at : at + sizes[block]].astype(np.float64) for at, block in sides]
        for sides in zip(
            zip(offset_a, leaves.block_a, strict=True),
            zip(offset_b, leaves.block_b, strict=True),
            strict=True,
        )
    ]


@pytest.mark.parametrize("number_format", FORMATS)
@settings(max_examples=100, deadline=None)
@given(leaves=leaf_sets())
def test_the_square_root_of_a_factor_is_rounded_to_the_nearest_step(number_format, leaves):
    packed = pack_leaves(TREE, leaves, number_format)
    if "codes" not in packed:  # rounding would not save bytes
        assert packed["values"] is leaves.values
        return
    result = decoded(TREE, unpack_leaves(leaves.level, packed))
    half_a_step = 0.5 / FORMATS[number_format] + 1e-6
    for before, after in zip(factors_of(leaves), factors_of(result), strict=True):
        top = [side.max(axis=1, keepdims=True) for side in before]
        is_zero = (top[0] == 0) | (top[1] == 0)
        scale = np.sqrt(top[0]) * np.sqrt(top[1])
        for side, maximum, stored in zip(before, top, after, strict=True):
            with np.errstate(invalid="ignore", divide="ignore"):
                expected = np.where(is_zero, 0.0, side / maximum)
                shown = np.where(is_zero, stored, stored / scale)
            precise = np.broadcast_to(scale > NEGLIGIBLE, side.shape)
            moved = np.abs(np.sqrt(shown) - np.sqrt(expected))
            assert (moved <= half_a_step)[precise].all()
            assert (stored[side == 0] == 0).all()
            brightest = stored.max(axis=1, keepdims=True)[scale > NEGLIGIBLE]
            np.testing.assert_allclose(brightest, scale[scale > NEGLIGIBLE], rtol=3e-7)
    assert np.isfinite(result.values).all()


@pytest.mark.parametrize("number_format", FORMATS)
@settings(max_examples=50, deadline=None)
@given(leaves=leaf_sets())
def test_rounding_is_idempotent(number_format, leaves):
    packed = pack_leaves(TREE, leaves, number_format)
    opened = unpack_leaves(leaves.level, packed)
    repeated = pack_leaves(TREE, opened, number_format)
    assert set(repeated) == set(packed)
    for part, array in packed.items():
        np.testing.assert_array_equal(repeated[part], array)
    exact = pack_leaves(TREE, opened, "float32")
    np.testing.assert_array_equal(exact["values"], decoded(TREE, opened).values)


@pytest.mark.parametrize("number_format", FORMATS)
@pytest.mark.parametrize("factor", [-1e-3, np.nan, np.inf])
def test_factors_that_are_not_light_are_not_rounded(number_format, factor):
    values = np.random.default_rng(0).random((3, 30), dtype=np.float32)
    leaves = LeafSet(0, np.zeros(1, np.int32), np.zeros(1, np.int32), values)
    assert "codes" in pack_leaves(TREE, leaves, number_format)
    values[1, 7] = factor
    assert pack_leaves(TREE, leaves, number_format)["values"] is values


@pytest.mark.parametrize(("number_format", "bits"), [("uint8", 12), ("uint16", 16)])
@settings(max_examples=200)
@given(value=numbers, sign=st.sampled_from([1, -1]))
def test_single_values_keep_their_leading_bits(number_format, bits, value, sign):
    values = np.array([sign * value], np.float32)
    result = rounded(values, number_format)
    error = abs(float(result[0]) - float(values[0]))
    # subnormal numbers have fewer bits
    least = float(np.finfo(np.float32).smallest_normal)
    assert error <= 2.0**-bits * max(abs(float(values[0])), least)
    np.testing.assert_array_equal(rounded(result, number_format), result)
