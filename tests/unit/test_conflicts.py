"""Conflict graphs, their squares and their colouring."""

import numpy as np
import pytest

from rfpipe.conflicts import colour, conflict_graph, square


def graph_of(n_blocks: int, *edges: tuple[int, int]):
    first, second = np.array(edges, np.int64).reshape(-1, 2).T
    return conflict_graph(n_blocks, first, second)


def test_repeats_and_self_conflicts_drop_out() -> None:
    graph = graph_of(4, (0, 1), (1, 0), (0, 1), (2, 2))
    expected = np.zeros((4, 4), np.int32)
    expected[0, 1] = expected[1, 0] = 1
    np.testing.assert_array_equal(graph.toarray(), expected)


def test_square_of_a_path_joins_next_neighbours_but_one() -> None:
    squared = square(graph_of(5, (0, 1), (1, 2), (2, 3), (3, 4))).toarray()
    distance = np.abs(np.subtract.outer(np.arange(5), np.arange(5)))
    np.testing.assert_array_equal(squared, ((distance > 0) & (distance <= 2)).astype(np.int32))


def test_a_complete_graph_takes_as_many_colours_as_blocks() -> None:
    edges = [(i, j) for i in range(7) for j in range(i)]
    assert sorted(colour(graph_of(7, *edges)).tolist()) == list(range(7))


@pytest.mark.parametrize(("n_blocks", "colours"), [(0, []), (1, [0]), (3, [0, 0, 0])])
def test_blocks_without_conflicts_share_one_colour(n_blocks: int, colours: list[int]) -> None:
    assert colour(graph_of(n_blocks)).tolist() == colours


def test_an_even_ring_takes_two_colours_and_an_odd_one_three() -> None:
    for length, expected in ((8, 2), (9, 3)):
        ring = [(block, (block + 1) % length) for block in range(length)]
        assert colour(graph_of(length, *ring)).max() + 1 == expected


def test_colouring_is_the_same_every_time() -> None:
    random = np.random.default_rng(0)
    edges = random.integers(0, 60, (400, 2))
    first = colour(conflict_graph(60, *edges.T))
    np.testing.assert_array_equal(first, colour(conflict_graph(60, *edges.T)))
    np.testing.assert_array_equal(first, colour(conflict_graph(60, *edges[::-1].T)))
