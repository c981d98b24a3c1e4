"""The hierarchical tensor as a linear operator, for arbitrary leaves."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.transport.hierarchical.leaves import LeafSet, factor_offsets
from rfpipe.transport.hierarchical.transport import HierarchicalTransport

shapes = st.one_of(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.tuples(st.integers(1, 3), st.integers(1, 5), st.integers(1, 5)),
)


def random_leaves(tree, level, channels, rng):
    """Return random leaves over some pairs of a level, in two sets."""
    count = tree.n_blocks(level)
    pairs = np.stack(np.triu_indices(count))[:, rng.permutation(count * (count + 1) // 2)[:8]]
    sets = []
    for block_a, block_b in np.split(pairs.astype(np.int32), [5], axis=1):
        is_last = level == tree.n_levels - 1
        n_values = factor_offsets(tree.starts[level], block_a, block_b)[2]
        shape = (channels, len(block_a) if is_last else n_values)
        sets.append(LeafSet(level, block_a, block_b, rng.random(shape, dtype=np.float32)))
    return sets


def add_dense(tree, leaves, matrices):
    """Add leaves to dense matrices, in image order."""
    starts = tree.starts[leaves.level]
    offset_a, offset_b, _ = factor_offsets(starts, leaves.block_a, leaves.block_b)
    for n, (a, b) in enumerate(zip(leaves.block_a, leaves.block_b, strict=True)):
        rows = tree.order[starts[a] : starts[a + 1]]
        columns = tree.order[starts[b] : starts[b + 1]]
        for c, values in enumerate(leaves.values):
            if leaves.level == tree.n_levels - 1:
                block = np.full((1, 1), values[n], np.float64)
            else:
                factor_a = values[offset_a[n] : offset_a[n] + len(rows)]
                factor_b = values[offset_b[n] : offset_b[n] + len(columns)]
                block = np.outer(factor_a, factor_b).astype(np.float64)
            matrices[c][np.ix_(rows, columns)] += block
            if a != b:
                matrices[c][np.ix_(columns, rows)] += block.T


def random_transport(shape, channels, seed):
    """Return a transport with random leaves at random levels, and its dense matrices."""
    rng = np.random.default_rng(seed)
    tree = BlockTree(RayDomain(shape))
    matrices = np.zeros((channels, tree.domain.size, tree.domain.size))
    leaf_sets = [
        leaves
        for level in range(tree.n_levels)
        for leaves in random_leaves(tree, level, channels, rng)
    ]
    for leaves in leaf_sets:
        add_dense(tree, leaves, matrices)
    rows = [{"level": level, "patterns": 1} for level in range(tree.n_levels)]
    return HierarchicalTransport.from_leaf_sets(tree, channels, rows, leaf_sets), matrices


@settings(max_examples=25, deadline=None)
@given(shape=shapes, channels=st.sampled_from([1, 3]), seed=st.integers(0, 2**32 - 1))
def test_products_equal_those_of_the_dense_matrix(shape, channels, seed):
    transport, matrices = random_transport(shape, channels, seed)
    rays = matrices.shape[1]
    atol = 1e-5 * np.abs(matrices).max() * rays
    for c in range(channels):
        operator, every = transport.channel(c), np.eye(rays)
        np.testing.assert_allclose(operator @ every, matrices[c], atol=atol)
        np.testing.assert_allclose(operator.T @ every, matrices[c].T, atol=atol)
    batch = transport.relight_batch(np.ones((20, *shape)))
    white = matrices.sum(axis=2).T.reshape(*shape, channels)
    np.testing.assert_allclose(batch[0], white, atol=atol)
    np.testing.assert_array_equal(batch[0], batch[-1])


def collapsed(tree, matrix, level):
    """Return one channel's rank-1 nodes of `level`, from row and column sums of `matrix`."""
    starts, within = tree.starts[level], matrix[np.ix_(tree.order, tree.order)]
    result = np.zeros_like(within)
    for a in range(tree.n_blocks(level)):
        for b in range(tree.n_blocks(level)):
            node = slice(starts[a], starts[a + 1]), slice(starts[b], starts[b + 1])
            by_row, by_column = within[node].sum(axis=1), within[node].sum(axis=0)
            if total := by_row.sum():
                result[node] = np.outer(by_row, by_column) / total
    return result[np.ix_(tree.inverse, tree.inverse)]


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 2**32 - 1))
def test_truncation_makes_rank_1_leaves_of_subdivided_nodes(shape, seed):
    transport, _ = random_transport(shape, 3, seed)
    tree, rays = transport.tree, transport.tree.domain.size
    for level in range(tree.n_levels - 1):
        expected, below = np.zeros((2, 3, rays, rays))
        for leaves in transport.leaf_sets:
            add_dense(tree, leaves, below if leaves.level > level else expected)
        expected += [collapsed(tree, matrix, level) for matrix in below]
        truncated = transport.truncate(level)
        result = [truncated.channel(c) @ np.eye(rays) for c in range(3)]
        np.testing.assert_allclose(result, expected, rtol=1e-5, atol=1e-5)
