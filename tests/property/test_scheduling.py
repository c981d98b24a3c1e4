"""Block trees over any shape, and the scheduling lemmas over any conflict graph."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.conflicts import colour, conflict_graph, square

images = st.tuples(st.integers(1, 40), st.integers(1, 40))
stacks = st.tuples(st.integers(1, 6), st.integers(1, 12), st.integers(1, 12))
lines = st.one_of(
    st.tuples(st.just(1), st.integers(1, 130)), st.tuples(st.integers(1, 130), st.just(1))
)
primes = st.tuples(*2 * [st.sampled_from([2, 3, 5, 7, 13, 29, 31])])
shapes = st.one_of(images, stacks, lines, primes)


@given(shapes)
def test_block_tree_partitions_its_domain(shape: tuple[int, ...]) -> None:
    domain = RayDomain(shape)
    tree = BlockTree(domain)
    rays = np.arange(domain.size)
    np.testing.assert_array_equal(np.sort(tree.order), rays)
    np.testing.assert_array_equal(tree.order[tree.inverse], rays)
    assert tree.n_blocks(0) == 1
    assert tree.n_blocks(tree.n_levels - 1) == domain.size
    for level in range(tree.n_levels):
        starts = tree.starts[level]
        assert starts[0] == 0
        assert starts[-1] == domain.size
        assert (np.diff(starts) > 0).all()
        # Contiguous in tree order: the labels, read in that order, count up.
        in_order = tree.labels(level).ravel()[tree.order]
        np.testing.assert_array_equal(in_order, tree.block_of_position(level))


@given(shapes)
def test_children_make_up_their_block(shape: tuple[int, ...]) -> None:
    tree = BlockTree(RayDomain(shape))
    for level in range(tree.n_levels - 1):
        children = tree.child_starts[level]
        np.testing.assert_array_equal(tree.starts[level + 1][children], tree.starts[level])
        most = shape[0] if len(shape) == 3 and level == 0 else 4
        assert np.diff(children).min() >= 1
        assert np.diff(children).max() <= most
        parents = tree.ancestors(level + 1, level)
        np.testing.assert_array_equal(
            parents, np.repeat(np.arange(len(children) - 1), np.diff(children))
        )
        np.testing.assert_array_equal(parents[tree.labels(level + 1)], tree.labels(level))


@given(shapes)
def test_blocks_are_near_square_rectangles_of_one_view(shape: tuple[int, ...]) -> None:
    tree = BlockTree(RayDomain(shape))
    first_view_level = 1 if len(shape) == 3 else 0
    for level in range(first_view_level, tree.n_levels):
        labels = tree.labels(level).ravel()
        bounds = []
        for axis in np.indices(shape).reshape(len(shape), -1):
            low = np.full(tree.n_blocks(level), max(shape))
            high = np.full(tree.n_blocks(level), -1)
            np.minimum.at(low, labels, axis)
            np.maximum.at(high, labels, axis)
            bounds.append(high - low + 1)
        np.testing.assert_array_equal(np.prod(bounds, axis=0), np.diff(tree.starts[level]))
        for lengths in bounds[-2:]:  # halved as evenly as can be
            assert lengths.max() - lengths.min() <= 1
        if len(shape) == 3:
            assert (bounds[0] == 1).all()


@st.composite
def unknown_pairs(draw: st.DrawFn) -> tuple[int, np.ndarray]:
    """Blocks, and which pairs of them have unknown transport between them (symmetric)."""
    n_blocks = draw(st.integers(1, 24))
    block = st.integers(0, n_blocks - 1)
    pairs = draw(st.lists(st.tuples(block, block), max_size=60))
    unknown = np.zeros((n_blocks, n_blocks), np.bool_)
    for a, b in pairs:
        unknown[a, b] = unknown[b, a] = True
    return n_blocks, unknown


def colours_of_square(n_blocks: int, unknown: np.ndarray) -> np.ndarray:
    return colour(conflict_graph(n_blocks, *np.nonzero(unknown)), apart=2)


@settings(max_examples=200)
@given(unknown_pairs())
def test_no_block_receives_two_unknown_blocks_of_a_pattern(case: tuple[int, np.ndarray]) -> None:
    """Lemma 1: with every block's own transport unknown too, whichever block looks on."""
    n_blocks, unknown = case
    unknown = unknown | np.eye(n_blocks, dtype=np.bool_)
    colours = colours_of_square(n_blocks, unknown)
    for pattern in range(colours.max() + 1):
        lit = colours == pattern
        # How many lit blocks with unknown transport does each block of the camera see?
        assert (unknown[:, lit].sum(axis=1) <= 1).all()


@settings(max_examples=100)
@given(unknown_pairs())
def test_blocks_outside_the_square_can_share_a_pattern(case: tuple[int, np.ndarray]) -> None:
    """Lemma 2: the square forbids no pair that Lemma 1 allows."""
    n_blocks, unknown = case
    unknown = unknown | np.eye(n_blocks, dtype=np.bool_)
    joined = square(conflict_graph(n_blocks, *np.nonzero(unknown))).toarray()
    seen_by_one = (unknown.astype(int).T @ unknown.astype(int)) > 0
    np.testing.assert_array_equal(joined > 0, seen_by_one & ~np.eye(n_blocks, dtype=np.bool_))
