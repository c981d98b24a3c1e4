"""Products of leaves with patterns that partition the blocks of a level."""

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.property.test_hierarchical import random_transport, shapes

from rfpipe.transport.hierarchical import apply
from rfpipe.transport.hierarchical.apply import predict


@settings(max_examples=40, deadline=None)
@given(
    shape=shapes,
    channels=st.sampled_from([1, 3]),
    n_patterns=st.integers(1, 5),
    tile=st.integers(1, 20),
    seed=st.integers(0, 2**32 - 1),
)
def test_products_equal_dense_products_for_any_batch(shape, channels, n_patterns, tile, seed):
    transport, matrices = random_transport(shape, channels, seed)
    tree, rng = transport.tree, np.random.default_rng(seed)
    level = int(rng.integers(tree.n_levels))
    pattern_of_block = rng.integers(-1, n_patterns, tree.n_blocks(level)).astype(np.int32)
    pattern_of_block[0] = n_patterns - 1
    leaf_sets = list(transport.leaf_sets)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(apply, "_TILE_RAYS", tile)
        images = predict(tree, leaf_sets, level, pattern_of_block, 0, n_patterns, channels)
    pattern_of_ray = pattern_of_block[tree.labels(level).ravel()]
    lit = np.arange(n_patterns)[:, None] == pattern_of_ray
    expected = np.einsum("crs,ps->pcr", matrices, lit.astype(np.float64))[:, :, tree.order]
    np.testing.assert_allclose(
        images, expected, atol=1e-5 * max(1.0, np.abs(matrices).sum(axis=2).max())
    )
    middle = int(rng.integers(n_patterns))
    for first, last in ((0, middle), (middle, n_patterns)):
        part = predict(tree, leaf_sets, level, pattern_of_block, first, last, channels)
        np.testing.assert_array_equal(part, images[first:last])


def test_products_do_not_depend_on_threads_or_batches():
    transport, _ = random_transport((40, 37), 3, 5)
    tree, threads = transport.tree, numba.get_num_threads()
    pattern_of_block = np.arange(tree.n_blocks(4), dtype=np.int32) % 11
    leaf_sets = list(transport.leaf_sets)
    images = predict(tree, leaf_sets, 4, pattern_of_block, 0, 11, 3)
    try:
        numba.set_num_threads(1)
        for first, last in ((0, 11), (0, 1), (3, 9), (10, 11)):
            single = predict(tree, leaf_sets, 4, pattern_of_block, first, last, 3)
            np.testing.assert_array_equal(single, images[first:last])
    finally:
        numba.set_num_threads(threads)
