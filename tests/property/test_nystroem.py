"""Rank-k leaves from the images of a node's children, against dense matrices."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.symmetric.nodes import Frontier, Pairs, Pieces, Subdivided, child_pairs
from rfpipe.methods.symmetric.rank_test import Limits, predictable, rank_k_leaves

SEEDS = st.integers(0, 2**32 - 1)
shapes = st.tuples(st.integers(5, 20), st.integers(5, 20))


def measured(tree, blocks, sigma=0.0, seed=0):
    """Return the off-diagonal node (0, 1) of level 1 and its children's pieces of `blocks`.

    `blocks` is (C, size of block 0, size of block 1), in tree order; `sigma` adds noise.
    """
    zero = np.zeros((len(blocks), 2, 1))
    pair = np.zeros(1, np.int32), np.ones(1, np.int32)
    nodes = Frontier(*pair, np.zeros((len(blocks), 0), np.float32), zero[:, 0], zero)
    _, first, second = child_pairs(tree, 1, nodes)
    starts, middle = tree.starts[2], tree.starts[1][1]
    pairs, size = Pairs.of(starts, first, second)
    values = np.empty((len(blocks), size), np.float32)
    for n, (i, j) in enumerate(zip(first, second, strict=True)):
        rows = slice(starts[i], starts[i + 1])
        columns = slice(starts[j] - middle, starts[j + 1] - middle)
        block = blocks[:, rows, columns]
        values[:, pairs.at_a[n] : pairs.at_a[n] + block.shape[1]] = block.sum(axis=2)
        values[:, pairs.at_b[n] : pairs.at_b[n] + block.shape[2]] = block.sum(axis=1)
    rounding = np.finfo(np.float32).eps * values
    variances = np.float32(sigma) ** 2 + rounding**2
    values += sigma * np.random.default_rng(seed).standard_normal(values.shape, dtype=np.float32)
    sizes = np.diff(starts)
    sides = ((pairs.at_a, sizes[first]), (pairs.at_b, sizes[second]))
    sums, spread = (
        np.stack([[np.sum(v[:, o : o + s], axis=1, dtype=float) for o, s in zip(*side, strict=True)]
                  for side in sides]).transpose(2, 0, 1)
        for v in (values, variances)
    )  # fmt: skip
    unknown = np.zeros(0, np.int64)
    pieces = Pieces(pairs, values, variances, sums.copy(), spread.copy(), spread.copy(), unknown)
    return Subdivided(tree, 1, nodes, np.array([0, len(first)]), pieces)


def outcome(tree, blocks, asked=1e-12, sigma=0.0, seed=0):
    """Return whether the node passes, and the dense matrices of its leaf."""
    divided = measured(tree, blocks, sigma, seed)
    limits = Limits(asked, 3.0, 1)
    passed = predictable(divided, np.ones(1, np.bool_), limits)
    leaves = rank_k_leaves(divided, np.ones(1, np.bool_))
    rows, columns = blocks.shape[1:]
    factors = leaves.values.reshape(len(blocks), -1, rows + columns)
    found = np.einsum("cra,crb->cab", factors[..., :rows], factors[..., rows:], dtype=float)
    return bool(passed[0]), found, len(leaves)


def node_of(shape):
    tree = BlockTree(RayDomain(shape))
    rows, columns = np.diff(tree.starts[1])[:2]
    return tree, rows, columns


@settings(max_examples=50, deadline=None)
@given(shape=shapes, rank=st.integers(1, 3), seed=SEEDS)
def test_a_node_of_rank_3_passes_and_is_found_again(shape, rank, seed):
    tree, rows, columns = node_of(shape)
    rng = np.random.default_rng(seed)
    # one side's children differ enough that the images tell the terms apart
    left = 1 + np.abs(rng.standard_normal((3, rank, rows)))
    right = 1 + np.abs(rng.standard_normal((3, rank, columns)))
    blocks = np.einsum("cra,crb->cab", left, right)
    passed, found, terms = outcome(tree, blocks, asked=1e-9 * np.abs(blocks).max() ** 2)
    scale = np.abs(blocks).max()
    if min(told_apart(tree, block, rank) for block in blocks) > 1e-3:
        assert passed
        assert terms == rank
        np.testing.assert_allclose(found, blocks, atol=2e-2 * scale)


def told_apart(tree, block, rank):
    """Return how well any of the images but one tell the terms apart, as a quotient."""
    starts, middle = tree.starts[2], tree.starts[1][1]
    first = [starts[i] for i in range(*tree.child_starts[1][:2])]
    second = [starts[j] - middle for j in range(*tree.child_starts[1][1:3])]
    core = np.add.reduceat(np.add.reduceat(block, first, axis=0), second, axis=1)
    without = [np.delete(core, k, axis) for axis in (0, 1) for k in range(core.shape[axis])]
    values = [np.linalg.svd(part, compute_uv=False) for part in without]
    return min(v[rank - 1] / v[0] if len(v) >= rank else 0.0 for v in values)


def test_images_that_have_nothing_to_do_with_each_other_do_not_pass():
    tree, rows, columns = node_of((16, 16))
    rng = np.random.default_rng(0)
    permutation = np.eye(rows)[rng.permutation(rows)][None]
    for blocks in (permutation, rng.random((1, rows, columns)) ** 8):
        assert not outcome(tree, blocks, asked=1e-3 * np.square(blocks).mean())[0]


def test_terms_within_noise_are_left_out():
    """A second term below the camera's noise would be noise divided by noise."""
    tree, rows, columns = node_of((32, 32))
    rng = np.random.default_rng(0)
    first, second = 1 + rng.random((2, 1, rows))
    dim = (np.arange(rows)[:, None] * np.arange(columns) / (rows * columns))[None]
    blocks = first[:, :, None] * second[:, None] + 1e-4 * dim
    passed, found, terms = outcome(tree, blocks, asked=0.0, sigma=0.05)
    assert passed
    assert terms == 1
    assert np.linalg.norm(found - blocks) < 0.01 * np.linalg.norm(blocks)
    assert outcome(tree, blocks, asked=0.0, sigma=0.0)[2] > 1


def test_a_node_without_light_has_no_leaf():
    tree, rows, columns = node_of((8, 8))
    passed, found, terms = outcome(tree, np.zeros((3, rows, columns)), sigma=0.1)
    assert passed
    assert terms == 0
    assert not found.any()


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS, part=st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_what_is_not_smooth_is_not_multiplied(seed, part):
    """Sums of what is not smooth nearly cancel: W's last singular values are of it alone."""
    tree, rows, columns = node_of((32, 32))
    places = np.stack(np.divmod(tree.order, 32), axis=1)
    a, b = places[:rows], places[rows : rows + columns] + np.array([0, 16])
    smooth = 1 / (np.square(a[:, None] - b[None]).sum(axis=2) + 1000.0)
    random = np.random.default_rng(seed)
    # an edge of a shadow: a few pixels of a see nothing of a few of b
    edge = random.random((rows, 1)) * random.random((1, columns)) < 0.02
    blocks = (smooth * (1 - part * edge) * (1 + part * random.standard_normal(smooth.shape)))[None]
    _, found, _ = outcome(tree, blocks)
    rank_1 = np.outer(blocks[0].sum(axis=1), blocks[0].sum(axis=0)) / blocks[0].sum()
    rest = np.linalg.norm(blocks[0] - smooth)
    assert np.linalg.norm(found - blocks) < 0.2 * np.linalg.norm(rank_1 - blocks) + 2 * rest


def test_a_node_whose_terms_are_all_within_noise_keeps_its_rank_1_leaf():
    """It had light a level above: without a term it would vanish."""
    tree, rows, columns = node_of((16, 16))
    blocks = np.full((2, rows, columns), 1e-3)
    divided = measured(tree, blocks, sigma=1.0)
    energy = blocks.sum(axis=(1, 2))[:, None]
    factors = np.concatenate([blocks.sum(axis=2), blocks.sum(axis=1)], axis=1).astype(np.float32)
    pair = np.zeros(1, np.int32), np.ones(1, np.int32)
    nodes = Frontier(*pair, factors, energy, np.zeros((2, 2, 1)))
    leaves = rank_k_leaves(replace(divided, nodes=nodes), np.ones(1, np.bool_))
    assert len(leaves) == 1
    np.testing.assert_allclose(leaves.values, factors / np.sqrt(energy), rtol=1e-6)
