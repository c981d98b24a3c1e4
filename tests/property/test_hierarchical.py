"""The hierarchical tensor as a linear operator, whatever its leaves hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.errors import InputError
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.hierarchical import HierarchicalTransport
from rfpipe.transport.leaves import LeafSet, factor_offsets

shapes = st.one_of(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.tuples(st.integers(1, 3), st.integers(1, 5), st.integers(1, 5)),
)


def random_transport(shape, channels, seed):
    """Return a transport with random leaves at random levels, and its dense matrices."""
    rng = np.random.default_rng(seed)
    tree = BlockTree(RayDomain(shape))
    rays = tree.domain.size
    matrices = np.zeros((channels, rays, rays))
    leaf_sets = []
    for level in range(tree.n_levels):
        count = tree.n_blocks(level)
        pairs = np.stack(np.triu_indices(count))[:, rng.permutation(count * (count + 1) // 2)[:5]]
        block_a, block_b = pairs[:, np.lexsort(pairs[::-1])].astype(np.int32)
        starts = tree.starts[level]
        offset_a, offset_b, n_values = factor_offsets(starts, block_a, block_b)
        is_last = level == tree.n_levels - 1
        values = rng.random((channels, len(block_a) if is_last else n_values), dtype=np.float32)
        leaf_sets.append(LeafSet(level, block_a, block_b, values))
        for n, (a, b) in enumerate(zip(block_a, block_b, strict=True)):
            rows = tree.order[starts[a] : starts[a + 1]]
            columns = tree.order[starts[b] : starts[b + 1]]
            for c in range(channels):
                if is_last:
                    block = np.full((1, 1), values[c, n], np.float64)
                else:
                    factor_a = values[c, offset_a[n] : offset_a[n] + len(rows)]
                    factor_b = values[c, offset_b[n] : offset_b[n] + len(columns)]
                    block = np.outer(factor_a, factor_b).astype(np.float64)
                matrices[c][np.ix_(rows, columns)] += block
                if a != b:
                    matrices[c][np.ix_(columns, rows)] += block.T
    rows = [{"level": level, "patterns": 1} for level in range(tree.n_levels)]
    return HierarchicalTransport.from_leaf_sets(tree, channels, rows, leaf_sets), matrices


@settings(max_examples=25, deadline=None)
@given(shape=shapes, channels=st.sampled_from([1, 3]), seed=st.integers(0, 2**32 - 1))
def test_it_is_the_linear_operator_of_its_dense_matrix(shape, channels, seed):
    transport, matrices = random_transport(shape, channels, seed)
    rng = np.random.default_rng(seed + 1)
    rays = matrices.shape[1]
    scale = np.abs(matrices).max() * rays
    for c in range(channels):
        operator = transport.channel(c)
        assert operator.shape == (rays, rays)
        x, y = rng.standard_normal((2, rays))
        np.testing.assert_allclose(operator @ x, matrices[c] @ x, atol=1e-5 * scale)
        np.testing.assert_allclose(operator.T @ y, matrices[c].T @ y, atol=1e-5 * scale)
        dot, transposed = y @ (operator @ x), x @ (operator.T @ y)
        assert dot == pytest.approx(transposed, abs=1e-5 * scale * np.linalg.norm(x))
        np.testing.assert_allclose(
            operator @ (2 * x - 3 * y), 2 * (operator @ x) - 3 * (operator @ y), atol=1e-4 * scale
        )


@settings(max_examples=25, deadline=None)
@given(shape=shapes, channels=st.sampled_from([1, 3]), seed=st.integers(0, 2**32 - 1))
def test_it_relights_images_of_one_or_all_channels(shape, channels, seed):
    transport, matrices = random_transport(shape, channels, seed)
    rng = np.random.default_rng(seed + 1)
    scale = np.abs(matrices).max() * matrices.shape[1]
    white = rng.random(shape)
    coloured = rng.random((*shape, channels))
    for pattern, planes in (
        (white, np.broadcast_to(white.reshape(1, -1), (channels, white.size))),
        (coloured, np.moveaxis(coloured.reshape(-1, channels), -1, 0)),
    ):
        expected = np.einsum("crk,ck->rc", matrices, planes).reshape(*shape, channels)
        image = transport.relight(pattern)
        assert image.dtype == np.float32
        np.testing.assert_allclose(image, expected, atol=1e-5 * scale)
        np.testing.assert_allclose(transport.T.relight(pattern), expected, atol=1e-5 * scale)
    batch = transport.relight_batch(np.stack([white] * 20))
    np.testing.assert_array_equal(batch[0], batch[-1])


@settings(max_examples=25, deadline=None)
@given(shape=shapes, channels=st.sampled_from([1, 3]), seed=st.integers(0, 2**32 - 1))
def test_truncation_keeps_every_row_and_column_sum(shape, channels, seed):
    transport, matrices = random_transport(shape, channels, seed)
    on = np.ones(shape)
    scale = np.abs(matrices).max() * matrices.shape[1]
    for level in range(transport.tree.n_levels):
        truncated = transport.truncate(level)
        assert max(leaves.level for leaves in truncated.leaf_sets) <= level
        np.testing.assert_allclose(truncated.relight(on), transport.relight(on), atol=1e-5 * scale)


def test_the_whole_tensor_is_kept_by_the_store(tmp_path):
    transport, _ = random_transport((5, 7), 3, 11)
    pattern = np.random.default_rng(0).random((5, 7))
    digest = save_transport(transport, tmp_path / "a.zarr", scene="test")
    again = save_transport(transport, tmp_path / "b.zarr", scene="test")
    assert digest == again
    opened = open_transport(tmp_path / "a.zarr")
    assert (opened.camera_shape, opened.projector_shape, opened.channels) == ((5, 7), (5, 7), 3)
    assert opened.nbytes == sum(
        file.stat().st_size for file in (tmp_path / "a.zarr").rglob("*") if file.is_file()
    )
    np.testing.assert_array_equal(opened.relight(pattern), transport.relight(pattern))
    assert opened.levels.equals(transport.levels)


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        (np.ones((5, 6)), "shape"),
        (np.ones((5, 7, 2)), "shape"),
        (np.full((5, 7), np.nan), "finite"),
    ],
)
def test_a_pattern_that_does_not_fit_is_refused(pattern, message):
    transport, _ = random_transport((5, 7), 3, 12)
    with pytest.raises(InputError, match=message):
        transport.relight(pattern)


def test_a_level_or_channel_that_is_not_there_is_refused():
    transport, _ = random_transport((5, 7), 3, 13)
    with pytest.raises(InputError, match="level"):
        transport.truncate(9)
    with pytest.raises(InputError, match="channel"):
        transport.channel(3)
