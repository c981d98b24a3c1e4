"""The scheduling lemmas for any conflict graph."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.conflicts import colour_square, conflict_graph, square


@st.composite
def unknown_pairs(draw: st.DrawFn) -> tuple[int, np.ndarray]:
    """Draw the symmetric matrix of block pairs with unknown transport."""
    n_blocks = draw(st.integers(1, 24))
    block = st.integers(0, n_blocks - 1)
    pairs = draw(st.lists(st.tuples(block, block), max_size=60))
    unknown = np.zeros((n_blocks, n_blocks), np.bool_)
    for a, b in pairs:
        unknown[a, b] = unknown[b, a] = True
    return n_blocks, unknown


def colours_of_square(n_blocks: int, unknown: np.ndarray) -> np.ndarray:
    return colour_square(conflict_graph(n_blocks, *np.nonzero(unknown)))


@settings(max_examples=200)
@given(unknown_pairs())
def test_no_block_receives_two_unknown_blocks_of_a_pattern(case: tuple[int, np.ndarray]) -> None:
    """Lemma 1, with each block's transport to itself also unknown."""
    n_blocks, unknown = case
    unknown = unknown | np.eye(n_blocks, dtype=np.bool_)
    colours = colours_of_square(n_blocks, unknown)
    for pattern in range(colours.max() + 1):
        lit = colours == pattern
        # number of lit blocks with unknown transport to each block of the camera
        assert (unknown[:, lit].sum(axis=1) <= 1).all()


@settings(max_examples=100)
@given(unknown_pairs())
def test_blocks_outside_the_square_can_share_a_pattern(case: tuple[int, np.ndarray]) -> None:
    """Lemma 2: the square excludes no pair that Lemma 1 allows."""
    n_blocks, unknown = case
    unknown = unknown | np.eye(n_blocks, dtype=np.bool_)
    joined = square(conflict_graph(n_blocks, *np.nonzero(unknown))).toarray()
    seen_by_one = (unknown.astype(int).T @ unknown.astype(int)) > 0
    np.testing.assert_array_equal(joined > 0, seen_by_one & ~np.eye(n_blocks, dtype=np.bool_))
