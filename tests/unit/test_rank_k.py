"""Rank-k leaves on physically based light that is smooth but for a little."""

from functools import cache

import numpy as np
import pytest
from benchmarks import rooms

import rfpipe
from rfpipe.transport.hierarchical.leaves import leaf_offsets

SHAPE = (32, 32)
NAMES = ("grain", "translucent")
LIT = (
    np.random.default_rng(5).random((6, *SHAPE))
    < np.array([0.5, 0.3, 0.1, 0.5, 0.3, 0.1])[:, None, None]
)


@cache
def room(name):
    described = {
        "grain": rooms.Room((rooms.Box((-0.45, 0.6, 3.2), (0.35, 0.5, 0.35), 25),), grain=0.01),
        "translucent": rooms.Room((rooms.Ball((0.2, 0.3, 3.0), 0.6, "translucent"),), scatter=0.3),
    }
    return rooms.transport(described[name], SHAPE)


def acquire(matrix, tolerance):
    rig = rfpipe.OperatorRig(matrix, SHAPE, SHAPE)
    return rfpipe.acquire(rig, tolerance=tolerance, progress=False)


def mean_error(found, matrix):
    """Mean error of relit pictures, relative to their norm."""
    patterns = np.concatenate([LIT, np.tril(np.ones(SHAPE))[None], np.eye(*SHAPE)[None]])
    truth = patterns.reshape(len(patterns), -1) @ matrix
    error = found.relight_batch(patterns).reshape(truth.shape) - truth
    return float(np.mean(np.linalg.norm(error, axis=1) / np.linalg.norm(truth, axis=1)))


def rank_k_leaves(found, matrix):
    """Yield each rank-k leaf's error and the norm of its block."""
    tree = found.tree
    ordered = matrix[np.ix_(tree.order, tree.order)]
    for leaves in found.leaf_sets:
        if leaves.level == tree.n_levels - 1:
            continue
        offsets, starts = leaf_offsets(tree, leaves), tree.starts[leaves.level]
        pairs = np.stack([leaves.block_a, leaves.block_b])
        first = np.flatnonzero(np.append(True, (np.diff(pairs) != 0).any(axis=0)))
        for begin, end in zip(first, np.append(first[1:], len(leaves)), strict=True):
            a, b = pairs[:, begin]
            if end - begin < 2:
                continue
            block = ordered[starts[a] : starts[a + 1], starts[b] : starts[b + 1]]
            values = leaves.values[0, offsets[begin] : offsets[end]].reshape(end - begin, -1)
            terms = values[:, : len(block)].T.astype(float) @ values[:, len(block) :]
            yield np.linalg.norm(terms - block), np.linalg.norm(block)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_errors_fall_with_the_tolerance_and_no_leaf_blows_up(name):
    matrix = room(name)
    before = np.inf
    for tolerance in (3e-3, 1e-3, 3e-4):
        found = acquire(matrix, tolerance).transport
        error = mean_error(found, matrix)
        assert error < min(0.6 * before, 4 * tolerance)
        before = error
        leaves = np.array(list(rank_k_leaves(found, matrix)))
        assert len(leaves) > 10
        harm = leaves[:, 0] > 1e-4 * np.linalg.norm(matrix)
        assert (leaves[harm, 0] < leaves[harm, 1]).all()
        assert np.linalg.norm(leaves[:, 0]) < 4e-3 * np.linalg.norm(matrix)
